"""The compiled loops over all observations of a sensor and all intervals of a process.

Compiled once for all models: a kernel comes as an address. A kernel that leaves an entry
unfilled, or writes past its arrays, is found out here.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import (
    GUARD,
    INDICES,
    MARK,
    MATRIX,
    STACK,
    VECTOR,
    dynamics_at,
    jit,
    jit_as,
    sensor_at,
)
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


@jit
def _guarded(n: int) -> Array:
    """A buffer for n numbers with guards on both sides."""
    return np.full(n + 2 * GUARD, MARK)


@jit
def _reset(buffer: Array) -> None:
    for i in range(GUARD, buffer.shape[0] - GUARD):
        buffer[i] = np.nan


@jit
def _verdict(buffer: Array) -> int:
    """0, or what a kernel did wrong with a guarded buffer."""
    n = buffer.shape[0]
    for i in range(GUARD):
        if buffer[i] != MARK or buffer[n - 1 - i] != MARK:
            return OUTSIDE
    for i in range(GUARD, n - GUARD):
        if not np.isfinite(buffer[i]):
            return UNFILLED
    return 0


@jit
def _gather(x: Array, k: int, places: Indices) -> Array:
    """The stored values of some blocks at epoch k."""
    out = np.empty(places.shape[0])
    for i in range(places.shape[0]):
        out[i] = x[k, places[i]]
    return out


@jit_as(
    types.int64,
    *(VECTOR, MATRIX, MATRIX, INDICES, INDICES),
    *(MATRIX, INDICES, INDICES, STACK, VECTOR),
    *(VECTOR, MATRIX, INDICES),
)
def measure(
    address: int,
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
    """Fill the rows r, H, which come as zeros, of all observations of one sensor; those
    whose status is not 0 stay zero."""
    kernel = sensor_at(address)
    rows, n = whiten.shape[1], columns.shape[0]
    r_buffer, h_buffer = _guarded(rows), _guarded(rows * n)
    r_one = r_buffer[GUARD : GUARD + rows]
    h_one = h_buffer[GUARD : GUARD + rows * n].reshape(rows, n)
    for i in range(z.shape[0]):
        start = row[i]
        status[i] = 0
        if weight[i] == 0.0:
            continue
        _reset(r_buffer)
        _reset(h_buffer)
        status[i] = kernel(p, q[i], z[i], _gather(x, epoch[i], gather), r_one, h_one)
        wrong = min(_verdict(r_buffer), _verdict(h_buffer))
        if wrong == OUTSIDE or (wrong == UNFILLED and status[i] == 0):
            status[i] = wrong
        if status[i] != 0:
            continue
        for a in range(rows):
            for b in range(a + 1):
                w = weight[i] * whiten[i, a, b]
                r[start + a] += w * r_one[b]
                for j in range(n):
                    H[start + a, columns[j]] += w * h_one[b, j]


@jit_as(
    types.int64,
    *(VECTOR, VECTOR, MATRIX, INDICES),
    *(MATRIX, INDICES, INDICES, INDICES, INDICES),
    *(MATRIX, STACK, STACK, INDICES),
)
def transition(
    address: int,
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
    kernel = dynamics_at(address)
    m, n, size = rows.shape[0], columns.shape[0], scatter.shape[0]
    x_buffer, f_buffer, q_buffer = _guarded(size), _guarded(m * n), _guarded(m * m)
    x_one = x_buffer[GUARD : GUARD + size]
    f_one = f_buffer[GUARD : GUARD + m * n].reshape(m, n)
    q_one = q_buffer[GUARD : GUARD + m * m].reshape(m, m)
    for k in range(t.shape[0]):
        _reset(x_buffer)
        _reset(f_buffer)
        _reset(q_buffer)
        inputs = u[offset[k] : offset[k + 1]]
        status[k] = kernel(p, t[k], inputs, _gather(x, k, gather), x_one, f_one, q_one)
        wrong = min(_verdict(x_buffer), _verdict(f_buffer), _verdict(q_buffer))
        if wrong == OUTSIDE or (wrong == UNFILLED and status[k] == 0):
            status[k] = wrong
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
    count, n, columns = x1.shape[0], F.shape[1], F.shape[2]
    e, a, b = np.zeros((count, n)), np.empty(F.shape), np.empty((count, n, n))
    minus = np.empty(n)
    for k in range(count):
        error = local(x0_next[k], x1[k], kinds, n)
        for i in range(n):
            minus[i] = -error[i]
            for j in range(n):
                e[k, i] += whiten[k, i, j] * error[j]
        left = so3.multiply(whiten[k], block_jacobian(minus, kinds, True))
        toward = so3.multiply(left, F[k])
        right = so3.multiply(whiten[k], block_jacobian(error, kinds, True))
        for i in range(n):
            for j in range(columns):
                a[k, i, j] = -toward[i, j]
            for j in range(n):
                b[k, i, j] = right[i, j]
    return e, a, b
