"""The backward pass of the Rauch-Tung-Striebel smoother, compiled."""

from __future__ import annotations

import numpy as np
from numba import types

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit_loop
from relnav_graph.compiled.contracts import INDEX_MATRIX, INDICES, MATRIX, STACK
from relnav_graph.linear.filter import NOT_POSITIVE
from relnav_graph.linear.partial_update import to_tangent
from relnav_graph.maths import dense
from relnav_graph.maths.dense import (
    copy,
    matmul_into,
    sandwich,
    scaled_cholesky,
    solve_lower,
    solve_lower_transposed,
)
from relnav_graph.maths.manifold import local, retract

__all__ = ["backward"]


@jit_loop(INDEX_MATRIX, MATRIX, STACK, MATRIX, STACK, STACK, types.int64, MATRIX, STACK, INDICES)
def backward(
    kinds: Indices,
    x: Array,
    P: Array,
    x_predicted: Array,
    P_predicted: Array,
    F: Array,
    covariances: int,
    xs: Array,
    Ps: Array,
    failure: Indices,
) -> None:
    """Smoothed states and, where wanted, covariances from those of a filter, backwards in time.

        G = P_k F_k+1^T (P-_k+1)^-1
        xs_k = x_k (+) G d,  d = local(x-_k+1, xs_k+1)
        Ps_k = P_k + G (Ps_k+1 - P-_k+1) G^T

    kinds (blocks, 4); x (N, size), P (N, n, n): filtered; x_predicted (N, size), P_predicted
    (N, n, n): x-, P-; F (N, n, n): F[k] leads to epoch k. Fills xs (N, size) and, where
    `covariances` is not 0, Ps (N, n, n). failure (4,): as of
    `relnav_graph.linear.filter.filter_epochs`.

    Rauch, Tung, Striebel 1965. Ps_k+1 is first moved to the tangent of x-_k+1, and Ps_k last
    to the tangent of xs_k, by the right Jacobian.
    """
    count, n = P.shape[0], P.shape[1]
    scale, L, gain_T = np.empty(n), np.empty((n, n)), np.empty((n, n))
    gain, change, moved = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for i in range(xs.shape[1]):
        xs[count - 1, i] = x[count - 1, i]
    if covariances:
        copy(P[count - 1], Ps[count - 1])
    for k in range(count - 2, -1, -1):
        give_way(0)
        if not scaled_cholesky(P_predicted[k + 1], scale, L):
            failure[0], failure[3] = NOT_POSITIVE, k + 1
            return
        matmul_into(F[k + 1], P[k], gain_T)
        for i in range(n):
            for j in range(n):
                gain_T[i, j] /= scale[i]
        solve_lower(L, gain_T)
        solve_lower_transposed(L, gain_T)
        for i in range(n):
            for j in range(n):
                gain[j, i] = gain_T[i, j] / scale[i]
        d = local(x_predicted[k + 1], xs[k + 1], kinds, n)
        move = dense.matvec(gain, d)
        smoothed = retract(x[k], move, kinds)
        for i in range(xs.shape[1]):
            xs[k, i] = smoothed[i]
        if covariances:
            copy(Ps[k + 1], change)
            to_tangent(change, d, kinds, True)
            for i in range(n):
                for j in range(n):
                    change[i, j] -= P_predicted[k + 1, i, j]
            sandwich(gain, change, moved)
            for i in range(n):
                for j in range(n):
                    Ps[k, i, j] = P[k, i, j] + moved[i, j]
            to_tangent(Ps[k], move, kinds, False)
