"""The compiled measurement update of a filter.

Rows r + H d are whitened: the covariance of the measurement noise is the unit matrix.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.linear.partial_update import observe_own, to_tangent
from relnav_graph.linear.tables import Tables, rows_of
from relnav_graph.maths import dense
from relnav_graph.maths.dense import (
    column_squares,
    copy,
    inverse_upper,
    matmul_into,
    scaled_cholesky,
    solve_lower,
    sum_of_squares,
)
from relnav_graph.maths.losses import HUBER, root_weight
from relnav_graph.maths.manifold import local, retract, times_jacobian, times_transposed_jacobian
from relnav_graph.maths.reflections import SPARE, householder

__all__ = [
    "CONVEX_ROUNDS",
    "ROUNDS",
    "WEIGHT_TOLERANCE",
    "least_squares",
    "measured_squares",
    "reweigh",
    "robust_update",
    "solution",
]

#: Most rounds of reweighting; how many of them, first, take a convex loss instead; and the
#: change of a weight's square root below which the rounds end.
ROUNDS, CONVEX_ROUNDS, WEIGHT_TOLERANCE = 40, 4, 1e-3


@jit
def _squared_length(L: Array, scale: Array, d: Array) -> float:
    """``d^T P^-1 d`` for d (n,), with ``P = diag(scale) L L^T diag(scale)``.

    L: (n, n), lower; scale: (n,). See `relnav_graph.maths.dense.scaled_cholesky`.
    """
    v = np.empty((d.shape[0], 1))
    for i in range(d.shape[0]):
        v[i, 0] = d[i] / scale[i]
    solve_lower(L, v)
    return column_squares(v, 0, 0)


@jit
def least_squares(H: Array, C: Array, innovation: Array, a: Array) -> None:
    """Triangularise the least-squares problem ``min |y|^2 + |innovation + H C y|^2``.

        Q^T [I, 0; H C, -innovation] = [R, b; 0, rest],  R y = b

    H (rows, n); C (n, n), with ``C C^T`` the covariance before; innovation (rows,). Fills
    a (n + rows, n + 1 + SPARE): R upper in a[:n, :n], b in a[:n, n]. The step is C y, and
    ``R^T R`` is the information of y after the update. Reflections keep all digits with
    measurements however precise; forming H P H^T + I would lose them.
    """
    n, rows = C.shape[0], H.shape[0]
    G = np.empty((rows, n))
    matmul_into(H, C, G)
    for i in range(n + rows):
        for j in range(a.shape[1]):
            a[i, j] = 1.0 if i == j and j < n else 0.0
    dense.put_block(a, n, 0, G, 1.0)
    for i in range(rows):
        a[n + i, n] = -innovation[i]
    householder(a, n, n, n + rows, n + 1)


@jit
def solution(C: Array, a: Array) -> Array:
    """The step ``C R^-1 b`` (n,), with R and b in `a` as `least_squares` leaves them."""
    n = C.shape[0]
    y = np.empty(n)
    for i in range(n - 1, -1, -1):
        y[i] = a[i, n]
        for j in range(i + 1, n):
            y[i] -= a[i, j] * y[j]
        y[i] /= a[i, i]
    return dense.matvec(C, y)


@jit
def _covariance(C: Array, a: Array, P: Array) -> None:
    """``P+ = (C R^-1) (C R^-1)^T`` into P (n, n), for C (n, n) and R in `a[:n, :n]`."""
    n = C.shape[0]
    R, half = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            R[i, j] = a[i, j] if j >= i else 0.0
    matmul_into(C, inverse_upper(R), half)
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for l in range(n):
                value += half[i, l] * half[j, l]
            P[i, j] = P[j, i] = value


@jit
def _possible(before: Indices, after: Indices) -> bool:
    """Whether a new state may be accepted, by the statuses (observations,) before and after.

    Not when a kernel broke its contract, nor when an observation has become impossible: its
    rows are then zero and would count as a perfect fit.
    """
    lost = 0
    for i in range(after.shape[0]):
        if after[i] < 0 or (after[i] > 0 and before[i] == 0):
            lost += 1
    return lost == 0


@jit
def update(
    tables: Tables,
    kinds: Indices,
    own: Indices,
    whole: int,
    epoch: int,
    first: int,
    last: int,
    rows: int,
    iterations: int,
    weight: Array,
    ahead: Array,
    considered: Indices,
    x: Array,
    P: Array,
) -> bool:
    """Measurement update of one epoch in place: x (size,), P (n, n), by square roots.

    x: the whole state, of which the blocks of `kinds` are updated; own (n,): the columns of these
    in the tangent of all blocks, of dimension `whole`.

        x+ = argmin |local(x, x+)|^2_P^-1 + |r(x+)|^2,  P+ = (C R^-1) (C R^-1)^T
        with C C^T = P and R^T R = I + (H C)^T (H C)

    first, last: the observations of the epoch; rows: number of their rows; weight
    (last - first,): square roots of their weights; ahead (n,): the step from x to where it is
    linearised first.

    One iteration is the extended Kalman filter; more are Gauss-Newton steps towards the
    maximum a posteriori (Bell and Cathey 1993). A step is halved while the cost grows, and
    given up after ten halvings. P+ is in the tangent of the updated state. False when a
    covariance is not positive definite.

    considered: columns whose states, and covariances with one another, stay as they are, in one
    iteration; the others' gain, and all other covariances, are as if they did not (Schmidt 1966;
    Woodbury and Junkins 2010).
    """
    n = P.shape[0]
    x0, P0, scale, L = x.copy(), P.copy(), np.empty(n), np.empty((n, n))
    if not scaled_cholesky(P0, scale, L):
        return False
    r, H, H0 = np.empty(rows), np.empty((rows, n)), np.empty((rows, n))
    r_try, H_try = np.empty(rows), np.empty((rows, n))
    status, status_try = np.empty(last - first, np.int64), np.empty(last - first, np.int64)
    C, a, innovation = np.empty((n, n)), np.empty((n + rows, n + 1 + SPARE)), np.empty(rows)
    for i in range(n):
        for j in range(n):
            C[i, j] = scale[i] * L[i, j]
    at, step, e = np.empty((1, x.shape[0])), np.empty((1, n)), ahead.copy()
    cost = 0.0
    if sum_of_squares(e) > 0.0:
        dense.put_vector(x, 0, retract(x0, e, kinds))
        cost = _squared_length(L, scale, e)
    dense.put_vector(at[0], 0, x)
    observe_own(tables, first, last, epoch, at, weight, own, whole, r, H, status)
    cost += sum_of_squares(r)
    for _ in range(iterations):
        copy(H, H0)
        times_jacobian(H0, e, kinds, False)  # to perturbations in the tangent of x0
        for i in range(rows):
            innovation[i] = r[i]
            for j in range(n):
                innovation[i] -= H0[i, j] * e[j]
        least_squares(H0, C, innovation, a)
        found_step = solution(C, a)
        for j in considered:
            found_step[j] = 0.0
        for j in range(n):
            step[0, j] = found_step[j] - e[j]
        times_transposed_jacobian(step, e, kinds, False)  # to the tangent of x
        if iterations == 1:
            dense.put_vector(x, 0, retract(x, step[0], kinds))
            break
        found = False
        for _halving in range(10):
            dense.put_vector(at[0], 0, retract(x, step[0], kinds))
            observe_own(
                tables, first, last, epoch, at, weight, own, whole, r_try, H_try, status_try
            )
            if _possible(status, status_try):
                dense.put_vector(e, 0, local(x0, at[0], kinds, n))
                cost_try = _squared_length(L, scale, e) + sum_of_squares(r_try)
                if cost_try <= cost * (1 + 1e-9) + 1e-9:
                    found = True
                    break
            for j in range(n):
                step[0, j] *= 0.5
        if not found:  # no way down from here: x is the best there is
            break
        # Squared length of the step in sigmas of the posterior. Convergence is quadratic: after
        # a step this short the next one would be negligible.
        length2 = _squared_length(L, scale, step[0]) + sum_of_squares(dense.matvec(H, step[0]))
        cost = cost_try
        dense.put_vector(x, 0, at[0])
        dense.put_vector(r, 0, r_try)
        copy(H_try, H)
        for i in range(last - first):
            status[i] = status_try[i]
        if length2 < 1e-6:
            break
    _covariance(C, a, P)
    for i in considered:
        for j in considered:
            P[i, j] = P0[i, j]
    to_tangent(P, local(x0, x, kinds, n), kinds, False)
    return True


@jit
def reweigh(losses: Array, chosen: Array, s2: Array, turn: int, weight: Array) -> float:
    """The weights of a robust loss at residuals of mean squares s2, and by how much their square
    roots change.

    losses (count, 2): kind and tuning of each observation; chosen (count,): 0 for one left out;
    s2 (count,); turn: number of the round; weight (count,): square roots, before and after.
    """
    change = 0.0
    for i in range(weight.shape[0]):
        kind, c = losses[i, 0], losses[i, 1]
        if kind == 0.0 or chosen[i] == 0.0:
            continue
        # The cost of a loss that redescends has many minima: the first rounds take a
        # convex loss, so that the others start near its only minimum.
        if turn < CONVEX_ROUNDS:
            kind, c = float(HUBER), 1.345
        root = root_weight(kind, c, s2[i])
        change = max(change, abs(root - weight[i]))
        weight[i] = root
    return change


@jit
def measured_squares(
    tables: Tables,
    own: Indices,
    whole: int,
    epoch: int,
    first: int,
    last: int,
    x: Array,
    chosen: Array,
    r: Array,
    H: Array,
    status: Indices,
    s2: Array,
) -> None:
    """Mean squares s2 (last - first,) of the whitened residuals of the chosen observations at x
    (size,); r (rows,), H (rows, n), status (last - first,): filled on the way."""
    at = np.empty((1, x.shape[0]))
    dense.put_vector(at[0], 0, x)
    observe_own(tables, first, last, epoch, at, chosen, own, whole, r, H, status)
    for i in range(last - first):
        start, height = rows_of(tables.observations, tables.sensors, first, i)
        s2[i] = sum_of_squares(r[start : start + height]) / height
        if status[i] != 0:  # impossible at the new x: its rows of zeros are no fit
            s2[i] = np.inf


@jit
def robust_update(
    tables: Tables,
    kinds: Indices,
    own: Indices,
    whole: int,
    epoch: int,
    first: int,
    last: int,
    rows: int,
    iterations: int,
    losses: Array,
    innovations: Array,
    weight: Array,
    ahead: Array,
    considered: Indices,
    x: Array,
    P: Array,
) -> bool:
    """:func:`update` repeated with the weights of the last result until they no longer change.

    losses (last - first, 2): kind and tuning; innovations (last - first,): mean squares of the
    normalised innovations, for the first weights. weight (last - first,): 1 to use an
    observation or 0 to leave it out before, square roots of the weights after; own, whole, ahead,
    considered: see there. x (size,) and P (n, n) are updated in place.
    """
    count = last - first
    robust = False
    for i in range(count):
        robust = robust or losses[i, 0] != 0.0
    chosen, x0, P0 = weight.copy(), x.copy(), P.copy()
    r, H = np.empty(rows), np.empty((rows, P.shape[0]))
    status, s2 = np.empty(count, np.int64), innovations.copy()
    for turn in range(ROUNDS):
        change = reweigh(losses, chosen, s2, turn, weight)
        if turn > CONVEX_ROUNDS and change < WEIGHT_TOLERANCE:
            break
        dense.put_vector(x, 0, x0)
        copy(P0, P)
        if not update(
            tables,
            kinds,
            own,
            whole,
            epoch,
            first,
            last,
            rows,
            iterations,
            weight,
            ahead,
            considered,
            x,
            P,
        ):
            return False
        if not robust:
            break
        measured_squares(tables, own, whole, epoch, first, last, x, chosen, r, H, status, s2)
    return True
