"""Compiled updates of some blocks of a state, and what they make of the others.

A measurement reads a few blocks: of a map, the points that are in view. Its update of these is that
of the whole state, and the others follow linearly from what is known of both beforehand.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.linear.rows import observe
from relnav_graph.linear.tables import Tables
from relnav_graph.maths import dense
from relnav_graph.maths.dense import (
    matmul_into,
    scaled_cholesky,
    solve_lower,
    solve_lower_transposed,
    symmetrize,
    transpose_in_place,
)
from relnav_graph.maths.manifold import retract, times_transposed_jacobian

__all__ = ["observe_own", "to_tangent", "update_others"]


@jit
def to_tangent(P: Array, d: Array, kinds: Indices, inverse: bool) -> None:
    """``P = J P J^T``: the covariance P (n, n) moved to the tangent of another state, in place.

    J is the right Jacobian at d (n,), which moves P from the tangent at x to that at x (+) d;
    with `inverse` J^-1, which moves it back. The result is exactly symmetric.
    """
    times_transposed_jacobian(P, d, kinds, inverse)
    transpose_in_place(P)
    times_transposed_jacobian(P, d, kinds, inverse)
    symmetrize(P)


@jit
def observe_own(
    tables: Tables,
    first: int,
    last: int,
    epoch: int,
    x: Array,
    weight: Array,
    own: Indices,
    whole: int,
    r: Array,
    H: Array,
    status: Indices,
) -> None:
    """:func:`observe` with H (rows, n) to some blocks alone, which hold all that is read: the
    columns own (n,) of the tangent of all blocks, of dimension `whole`."""
    if own.shape[0] == whole:
        observe(tables, first, last, epoch, x, weight, r, H, status)
        return
    every = np.empty((r.shape[0], whole))
    observe(tables, first, last, epoch, x, weight, r, every, status)
    for i in range(r.shape[0]):
        for j in range(own.shape[0]):
            H[i, j] = every[i, own[j]]


@jit
def update_others(
    own: Indices, d: Array, kinds_own: Indices, after: Array, kinds: Indices, x: Array, P: Array
) -> bool:
    """What an update of some blocks makes of the others, which follow linearly, in place.

        K = P_oc P_cc^-1,  d_o = K d_c,  P_oc+ = K P_cc+,  P_oo+ = P_oo + K (P_cc+ - P_cc) K^T

    own (c,): columns of the blocks updated, in the tangent of all; d (c,): their step; after
    (c, c): their covariance, in the tangent after it; kinds_own, kinds: of these blocks, and of
    all. x (size,): the updated ones hold their new values; P (n, n): before, of all. False when
    P_cc is not positive definite.
    """
    n, c = P.shape[0], own.shape[0]
    chosen, others = np.zeros(n, np.int64), np.empty(n - c, np.int64)
    for i in range(c):
        chosen[own[i]] = 1
    k = 0
    for i in range(n):
        if chosen[i] == 0:
            others[k] = i
            k += 1
    scale, L, Kt, change = np.empty(c), np.empty((c, c)), np.empty((c, n - c)), np.empty((c, c))
    for i in range(c):
        for j in range(c):
            change[i, j] = P[own[i], own[j]]
        for j in range(n - c):
            Kt[i, j] = P[own[i], others[j]]
    if not scaled_cholesky(change, scale, L):
        return False
    for i in range(c):
        for j in range(n - c):
            Kt[i, j] /= scale[i]
    solve_lower(L, Kt)
    solve_lower_transposed(L, Kt)
    for i in range(c):
        for j in range(n - c):
            Kt[i, j] /= scale[i]
    new = after.copy()
    to_tangent(new, d, kinds_own, True)
    for i in range(c):
        for j in range(c):
            change[i, j] = new[i, j] - change[i, j]
    cross, spread = np.empty((c, n - c)), np.empty((c, n - c))
    matmul_into(new, Kt, cross)
    matmul_into(change, Kt, spread)
    more, step = dense.transposed_matmul(Kt, spread), np.zeros(n)
    for i in range(c):
        step[own[i]] = d[i]
        for j in range(c):
            P[own[i], own[j]] = new[i, j]
        for j in range(n - c):
            step[others[j]] += Kt[i, j] * d[i]
            P[own[i], others[j]] = P[others[j], own[i]] = cross[i, j]
    for i in range(n - c):
        for j in range(n - c):
            P[others[i], others[j]] += more[i, j]
    to_tangent(P, step, kinds, False)
    for i in range(c):
        step[own[i]] = 0.0
    moved = retract(x, step, kinds)
    for k in range(kinds.shape[0]):
        if chosen[kinds[k, 2]] == 0:
            size = 9 if kinds[k, 0] else kinds[k, 3]
            for i in range(kinds[k, 1], kinds[k, 1] + size):
                x[i] = moved[i]
    return True
