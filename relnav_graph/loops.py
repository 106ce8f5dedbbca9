"""The compiled loops over all observations of a sensor and all intervals of a process.

Compiled once for all models: a kernel is an argument. A kernel that leaves an entry
unfilled, or writes past its arrays, is found out here.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numpy.typing import NDArray

from relnav_graph.compiled import (
    DYNAMICS_KERNEL,
    INDICES,
    MATRIX,
    SENSOR_KERNEL,
    STACK,
    VECTOR,
    jit,
    jit_as,
)
from relnav_graph.models import Kernel
from relnav_graph.state import block_jacobian, local

__all__ = ["BROKEN", "interval_rows", "measure", "transition"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Statuses that the loops add to those of the kernels, and what they mean.
UNFILLED, OUTSIDE = -1, -2
BROKEN = {
    UNFILLED: "left an entry unfilled or not finite",
    OUTSIDE: "wrote past its arrays",
}
_GUARD = 64  # numbers before and after each array that a kernel fills
_MARK = 1.2345678901234567e300


@jit
def _guarded(n: int) -> Array:
    """A buffer for n numbers with guards on both sides: a kernel that writes past its
    arrays is found out, before it can spoil anybody else's memory."""
    return np.full(n + 2 * _GUARD, _MARK)


@jit
def _intact(buffer: Array) -> bool:
    for i in range(_GUARD):
        if buffer[i] != _MARK or buffer[buffer.shape[0] - 1 - i] != _MARK:
            return False
    return True


@jit
def _finite(a: Array) -> bool:
    for value in a.flat:  # noqa: SIM110 (numba knows no all() over a generator)
        if not np.isfinite(value):
            return False
    return True


@jit_as(
    types.FunctionType(SENSOR_KERNEL),
    *(VECTOR, MATRIX, MATRIX, INDICES, INDICES),
    *(MATRIX, INDICES, INDICES, STACK, VECTOR),
    *(VECTOR, MATRIX, INDICES),
)
def measure(
    kernel: Kernel,
    p: Array,
    q: Array,
    z: Array,
    epoch: Indices,
    row: Indices,
    x: Array,
    gather: Indices,
    columns: Indices,
    whiten: Array,
    weight: Array,
    r: Array,
    H: Array,
    status: Indices,
) -> None:
    """Fill the rows r, H of all observations of one sensor; zero where status != 0."""
    rows, n = whiten.shape[1], columns.shape[0]
    r_buffer, h_buffer = _guarded(rows), _guarded(rows * n)
    r_one = r_buffer[_GUARD : _GUARD + rows]
    h_one = h_buffer[_GUARD : _GUARD + rows * n].reshape(rows, n)
    for i in range(z.shape[0]):
        start = row[i]
        r[start : start + rows] = 0.0
        H[start : start + rows] = 0.0
        if weight[i] == 0.0:
            status[i] = 0
            continue
        r_one[:] = np.nan
        h_one[:, :] = np.nan
        status[i] = kernel(p, q[i], z[i], x[epoch[i]][gather], r_one, h_one)
        if not (_intact(r_buffer) and _intact(h_buffer)):
            status[i] = OUTSIDE
        elif status[i] == 0 and not (_finite(r_one) and _finite(h_one)):
            status[i] = UNFILLED
        if status[i] != 0:
            continue
        for a in range(rows):
            for b in range(a + 1):
                w = weight[i] * whiten[i, a, b]
                r[start + a] += w * r_one[b]
                for j in range(n):
                    H[start + a, columns[j]] += w * h_one[b, j]


@jit_as(
    types.FunctionType(DYNAMICS_KERNEL),
    *(VECTOR, VECTOR, MATRIX, INDICES),
    *(MATRIX, INDICES, INDICES, INDICES, INDICES),
    *(MATRIX, STACK, STACK, INDICES),
)
def transition(
    kernel: Kernel,
    p: Array,
    t: Array,
    u: Array,
    offset: Indices,
    x: Array,
    gather: Indices,
    scatter: Indices,
    columns: Indices,
    rows: Indices,
    x_next: Array,
    F: Array,
    Q: Array,
    status: Indices,
) -> None:
    """Propagate the blocks of one process over all intervals, into x_next, F, Q."""
    m, n, size = rows.shape[0], columns.shape[0], scatter.shape[0]
    x_buffer, f_buffer, q_buffer = _guarded(size), _guarded(m * n), _guarded(m * m)
    x_one = x_buffer[_GUARD : _GUARD + size]
    f_one = f_buffer[_GUARD : _GUARD + m * n].reshape(m, n)
    q_one = q_buffer[_GUARD : _GUARD + m * m].reshape(m, m)
    for k in range(t.shape[0]):
        x_one[:] = np.nan
        f_one[:, :] = np.nan
        q_one[:, :] = np.nan
        inputs = u[offset[k] : offset[k + 1]]
        status[k] = kernel(p, t[k], inputs, x[k][gather], x_one, f_one, q_one)
        if not (_intact(x_buffer) and _intact(f_buffer) and _intact(q_buffer)):
            status[k] = OUTSIDE
        elif not (_finite(x_one) and _finite(f_one) and _finite(q_one)):
            status[k] = UNFILLED if status[k] == 0 else status[k]
        if status[k] != 0:
            return
        for i in range(size):
            x_next[k, scatter[i]] = x_one[i]
        for i in range(m):
            for j in range(n):
                F[k, rows[i], columns[j]] = f_one[i, j]
            for j in range(m):
                Q[k, rows[i], rows[j]] = q_one[i, j]


@jit
def interval_rows(
    x0_next: Array, x1: Array, F: Array, whiten: Array, kinds: Indices
) -> tuple[Array, Array, Array]:
    """e = local(propagate(x_k), x_k+1), whitened, with its exact Jacobians to both ends.

    On SO(3): e = Log(A^T B), de/db = J_r^-1(e), de/da = -J_r^-1(-e), the left inverse.
    """
    count, n = x1.shape[0], F.shape[1]
    e, a, b = np.empty((count, n)), np.empty_like(F), np.empty((count, n, n))
    for k in range(count):
        error = local(x0_next[k], x1[k], kinds, n)
        w = whiten[k]
        e[k] = w @ error
        a[k] = -(w @ block_jacobian(-error, kinds, True)) @ F[k]
        b[k] = w @ block_jacobian(error, kinds, True)
    return e, a, b
