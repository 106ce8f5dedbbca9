"""The whitened rows of intervals: what the process noise says of the states at both ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import INDEX_MATRIX, MATRIX, STACK
from relnav_graph.core.state import Layout
from relnav_graph.maths.dense import matmul_into
from relnav_graph.maths.manifold import local, times_jacobian, times_transposed_jacobian

__all__ = ["ProcessRows", "interval_row", "interval_rows", "process_rows"]


@jit
def interval_row(
    x_next: Array, x1: Array, F: Array, whiten: Array, kinds: Indices, e: Array, A: Array, B: Array
) -> None:
    """:func:`interval_rows` of one interval.

    x_next, x1: (size,); F: (n, columns); whiten: (n, n). Fills e (n,), A (n, columns), B (n, n).
    """
    n = e.shape[0]
    error, left = local(x_next, x1, kinds, n), np.empty((n, n))
    for i in range(n):
        e[i] = 0.0
        for j in range(n):
            e[i] += whiten[i, j] * error[j]
            left[i, j] = -whiten[i, j]
            B[i, j] = whiten[i, j]
    times_transposed_jacobian(left, error, kinds, True)
    times_jacobian(B, error, kinds, True)
    matmul_into(left, F, A)


@jit_loop(MATRIX, MATRIX, STACK, STACK, INDEX_MATRIX, MATRIX, STACK, STACK)
def interval_rows(
    x_next: Array, x1: Array, F: Array, whiten: Array, kinds: Indices, e: Array, A: Array, B: Array
) -> None:
    """Whitened rows ``e + A d_k + B d_k+1`` of intervals, with exact Jacobians to both ends.

        e = W v,  A = -W J_r^-1(-v) F,  B = W J_r^-1(v),  v = local(x_next, x1)

    x_next (M, size): states propagated to the ends of the intervals; x1 (M, size): states
    there; F (M, n, columns): sensitivity of x_next; whiten (M, n, n): W. Fills e (M, n),
    A (M, n, columns), B (M, n, n). J_r is the right Jacobian on attitudes and the identity
    elsewhere.
    """
    for k in range(x1.shape[0]):
        give_way(k)
        interval_row(x_next[k], x1[k], F[k], whiten[k], kinds, e[k], A[k], B[k])


@dataclass(frozen=True, eq=False)
class ProcessRows:
    """Whitened rows e + A d_k + B d_k+1 of all intervals, d tangent: e (M, n); A, B (M, n, n)."""

    e: Array
    A: Array
    B: Array


def process_rows(layout: Layout, x_next: Array, x1: Array, F: Array, whiten: Array) -> ProcessRows:
    """Rows of intervals that lead to x1 (M, size), predicted as x_next (M, size).

    F (M, n, columns): sensitivity of x_next; whiten (M, n, n): of the process noise. For the
    equations see `interval_rows`.
    """
    out = ProcessRows(np.empty(F.shape[:2]), np.empty(F.shape), np.empty(whiten.shape))
    arrays = [np.ascontiguousarray(a) for a in (x_next, x1, F, whiten)]
    interval_rows(*arrays, layout.kinds, out.e, out.A, out.B)
    return out
