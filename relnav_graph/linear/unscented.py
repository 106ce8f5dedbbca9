"""The compiled step of an unscented filter: the sigma points of `relnav_graph.maths.sigma_points`
through the kernels of processes and sensors.

Residuals are those of the sensors, at each point: tangent at what was measured, or at the measured
attitude or line of sight, which is the same for all points, so that they have a mean. The mean over
the points is the innovation.
"""

from __future__ import annotations

import numpy as np
from numba import types

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import DEGENERATE, INDICES, MATRIX, VECTOR
from relnav_graph.linear.filter import (
    FILTER_INPUT,
    FILTER_OUTPUT,
    NOT_FINITE,
    NOT_POSITIVE,
    PROPAGATED,
    SENSOR_BROKE,
    FilterInput,
    FilterOutput,
    room_for_squares,
    sound,
    update_epoch,
)
from relnav_graph.linear.innovations import gate
from relnav_graph.linear.rows import observe, propagate
from relnav_graph.linear.tables import TABLES, Tables, rows_of
from relnav_graph.linear.update import (
    CONVEX_ROUNDS,
    ROUNDS,
    WEIGHT_TOLERANCE,
    least_squares,
    measured_squares,
    reweigh,
    solution,
)
from relnav_graph.maths import dense
from relnav_graph.maths.dense import (
    cholesky,
    column_squares,
    copy,
    solve_lower,
    sum_of_squares,
    transpose_in_place,
    transposed_matmul,
)
from relnav_graph.maths.losses import root_weight
from relnav_graph.maths.manifold import local, retract, times_jacobian, times_transposed_jacobian
from relnav_graph.maths.reflections import SPARE, householder
from relnav_graph.maths.sigma_points import (
    CENTRE,
    EACH,
    SPREAD,
    draw,
    factor,
    mean_of,
    moments,
    regress,
    root_of,
    triangle,
    upper,
)

__all__ = ["unscented_epochs"]

#: Squared length of a step, in sigmas, after which an update is iterated no further.
CONVERGED = 1e-6


@jit
def _predict(
    tables: Tables,
    interval: int,
    kinds: Indices,
    weights: Array,
    x: Array,
    R: Array,
    Q: Array,
    F: Array,
    failure: Indices,
) -> None:
    """Carry x (size,) and R (n, n) over an interval, in place.

    Fills Q (q, q), the noise at x, and F (n, n), the regression of the points after on those
    before, ``F P = sum v_i d_i+ d_i^T``: of linear models their transition; of static blocks its
    rows are left as they are. failure (4,): where it fails.
    """
    n, q = R.shape[0], Q.shape[0]
    points, after = np.empty((1 + 2 * n, x.shape[0])), np.empty((1 + 2 * n, x.shape[0]))
    slope, noise = np.empty(F.shape), np.empty(Q.shape)
    draw(x, R, weights[SPREAD], kinds, points)
    for i in range(1 + 2 * n):
        give_way(i)
        dense.put_vector(after[i], 0, points[i])
        wanted = noise[: q if i == 0 else 0]
        a, status = propagate(tables, interval, points[i], after[i], slope, wanted)
        if status != 0:
            failure[0], failure[1], failure[2] = PROPAGATED, a, status
            return
        if i == 0:
            copy(noise, Q)
    dense.put_vector(x, 0, mean_of(after, n, weights, kinds))
    rows, root = np.zeros((2 * n + q + 1, n + SPARE)), np.sqrt(weights[EACH])
    noise_root, D = np.empty((q, q)), np.empty((n, n))
    centre = local(x, after[0], kinds, n)
    for i in range(n):
        plus, minus = local(x, after[1 + i], kinds, n), local(x, after[1 + n + i], kinds, n)
        for j in range(n):
            D[i, j] = weights[EACH] * weights[SPREAD] * (plus[j] - minus[j])
            rows[i, j], rows[n + i, j] = root * plus[j], root * minus[j]
    root_of(Q, noise_root)
    dense.put_block(rows, 2 * n, 0, noise_root, 1.0)
    for i in range(n - 1, -1, -1):  # F^T = R^-1 D
        for j in range(n):
            for l in range(i + 1, n):
                D[i, j] -= R[i, l] * D[l, j]
            D[i, j] /= R[i, i]
            if j < q:
                F[j, i] = D[i, j]
    if not triangle(rows, 2 * n + q, centre, weights[CENTRE]):
        failure[0] = NOT_POSITIVE
        return
    upper(rows, 0, R)


@jit
def _step(mean: Array, H: Array, x0: Array, R0: Array, kinds: Indices, x: Array, R: Array) -> float:
    """Update x0 (size,), R0 (n, n) with rows that are linear at x (size,), into x and R (n, n).

    mean (rows,), H (rows, n): see `regress`. R is in the tangent of the new x. Returns the squared
    length of the step from the old x, in sigmas of the new one.
    """
    n, rows = R0.shape[0], mean.shape[0]
    C, a = np.empty((n, n)), np.empty((n + rows, n + 1 + SPARE))
    for i in range(n):
        for j in range(n):
            C[i, j] = R0[j, i]
    e, innovation, before = local(x0, x, kinds, n), mean.copy(), x.copy()
    times_jacobian(H, e, kinds, False)  # to perturbations in the tangent of x0
    for i in range(rows):
        for j in range(n):
            innovation[i] -= H[i, j] * e[j]
    least_squares(H, C, innovation, a)
    step = solution(C, a)
    dense.put_vector(x, 0, retract(x0, step, kinds))
    upper(a, 0, C)
    transpose_in_place(C)
    copy(R0, R)
    solve_lower(C, R)
    times_transposed_jacobian(R, step, kinds, False)
    moved = np.zeros((n, n + SPARE))
    dense.put_block(moved, 0, 0, R, 1.0)
    householder(moved, n, 0, n, n)
    upper(moved, 0, R)
    d, length2 = local(x, before, kinds, n), 0.0
    for i in range(n):  # R^-T d
        for j in range(i):
            d[i] -= R[j, i] * d[j]
        d[i] /= R[i, i]
        length2 += d[i] * d[i]
    return length2


@jit
def _observe(
    tables: Tables,
    k: int,
    first: int,
    last: int,
    points: Array,
    Y: Array,
    H: Array,
    weight: Array,
    failure: Indices,
) -> None:
    """Whitened residuals Y (count, rows) of an epoch's observations at points (count, size).

    weight (last - first,): 1, or 0 for an observation that is impossible at one of them; H (rows,
    n): filled on the way.
    """
    status, every = np.empty(last - first, np.int64), np.ones(last - first)
    for o in range(last - first):
        weight[o] = 1.0
    for i in range(points.shape[0]):
        observe(tables, first, last, k, points[i : i + 1], every, Y[i], H, status)
        for o in range(last - first):
            if status[o] < 0 or status[o] >= DEGENERATE:
                failure[0], failure[1], failure[2] = SENSOR_BROKE, first + o, status[o]
                return
            if status[o] != 0:
                weight[o] = 0.0


@jit
def _fewer(seen: Array, chosen: Array) -> bool:
    """Whether an observation that was chosen is seen no more, both (observations,), 1 or 0."""
    lost = 0
    for o in range(seen.shape[0]):
        if seen[o] < chosen[o]:
            lost += 1
    return lost > 0


@jit
def _rows_weighted(tables: Tables, first: int, weight: Array, roots: Array) -> None:
    """The weights (observations,) of the rows: roots (rows,)."""
    for o in range(weight.shape[0]):
        start, count = rows_of(tables.observations, tables.sensors, first, o)
        for a in range(start, start + count):
            roots[a] = weight[o]


@jit
def _measured(
    tables: Tables,
    given: FilterInput,
    weights: Array,
    iterations: int,
    k: int,
    x: Array,
    R: Array,
    out: FilterOutput,
    innovation: Array,
    S: Array,
    failure: Indices,
) -> None:
    """Update x (size,) and R (n, n) with what epoch k measured, in place.

    The points of the prediction say what the innovation is, and give the rows of the first update.
    Further iterations take those of points drawn from the result, and update the prediction anew:
    posterior linearisation (Garcia-Fernandez, Svensson, Morelande, Sarkka 2015).
    innovation (rows,), S (rows, rows): get the whitened innovation and its covariance; of `out`,
    weights, nis and used are filled.
    """
    kinds, n, rows = given.kinds, R.shape[0], innovation.shape[0]
    first, last = given.epoch_offsets[k], given.epoch_offsets[k + 1]
    losses, weight = given.losses[first:last], out.weights[first:last]
    points, Y = np.empty((1 + 2 * n, x.shape[0])), np.empty((1 + 2 * n, rows))
    H, squares, roots = np.empty((rows, n)), np.zeros(last - first), np.empty(rows)
    r, seen = np.empty(rows), np.empty(last - first)
    draw(x, R, weights[SPREAD], kinds, points)
    _observe(tables, k, first, last, points, Y, H, weight, failure)
    if failure[0] != 0:
        return
    moments(Y, weights, innovation, S)
    gate(tables, S, innovation, given.limits[first:last], losses, first, weight, squares)
    robust, chosen = False, weight.copy()
    used, v = S.copy(), np.zeros((rows, 1))
    for o in range(last - first):
        start, count = rows_of(tables.observations, tables.sensors, first, o)
        out.used[k] += count if weight[o] != 0.0 else 0
        for a in range(start, start + count):
            v[a, 0] = weight[o] * innovation[a]
            if losses[o, 0] != 0.0 and weight[o] != 0.0:  # counts as far as the loss lets it
                robust = True
                v[a, 0] *= root_weight(losses[o, 0], losses[o, 1], squares[o])
            for b in range(rows if weight[o] == 0.0 else 0):
                used[a, b] = used[b, a] = 1.0 if a == b else 0.0
    if not cholesky(used):
        failure[0] = NOT_POSITIVE
        return
    solve_lower(used, v)
    out.nis[k] = column_squares(v, 0, 0)
    x0, R0 = x.copy(), R.copy()
    status = np.empty(last - first, np.int64)
    for turn in range(ROUNDS if robust else 1):
        change = reweigh(losses, chosen, squares, turn, weight)
        if turn > CONVEX_ROUNDS and change < WEIGHT_TOLERANCE:
            break
        dense.put_vector(x, 0, x0)
        copy(R0, R)
        _rows_weighted(tables, first, weight, roots)
        for iteration in range(iterations):
            if iteration > 0 or turn > 0:
                draw(x, R, weights[SPREAD], kinds, points)
                _observe(tables, k, first, last, points, Y, H, seen, failure)
                if iteration > 0 and (failure[0] != 0 or _fewer(seen, chosen)):
                    failure[0] = 0  # no further from here: x is the best there is
                    break
            if not regress(Y, R, weights, roots, r, H):
                failure[0] = NOT_POSITIVE
                return
            if _step(r, H, x0, R0, kinds, x, R) < CONVERGED:
                break
        if robust:
            measured_squares(
                tables, np.arange(n), n, k, first, last, x, chosen, r, H, status, squares
            )


@jit_loop(
    *(
        TABLES,
        FILTER_INPUT,
        VECTOR,
        types.int64,
        types.int64,
        types.int64,
        VECTOR,
        MATRIX,
        VECTOR,
        FILTER_OUTPUT,
        VECTOR,
        VECTOR,
        INDICES,
        INDICES,
    )
)
def unscented_epochs(
    tables: Tables,
    given: FilterInput,
    weights: Array,
    iterations: int,
    begin: int,
    end: int,
    xk: Array,
    R: Array,
    ahead: Array,
    out: FilterOutput,
    innovations: Array,
    spreads: Array,
    offsets: Indices,
    failure: Indices,
) -> None:
    """Carry sigma points to each epoch from `begin` to `end`, and update with what it measured.

    weights (4,): see `weights_of`; xk (size,), R (n, n): the estimate before epoch `begin`, and the
    root of its covariance; in the end those at the last epoch. ahead (n,), out, failure (4,): as of
    `relnav_graph.linear.filter.filter_epochs`, F as of `_predict`. innovations (R,): whitened, the
    mean over the points; spreads: of each epoch, from offsets[k] on, their covariance (rows, rows).

    Points are drawn from the estimate, and drawn anew from the prediction, which has the process
    noise in it, before they are measured. Where `ahead` is not zero, numbered blocks are first
    seen: their prior says nothing of where they are, and points drawn from it as little; the first
    epoch is then updated as by the extended filter, linearised there, and has no spread (NaN).
    """
    kinds, q = given.kinds, out.Q.shape[1]
    lag = given.epoch_offsets.shape[0] - 1 - tables.starts.shape[0]
    squares = room_for_squares(given.epoch_offsets, begin, end)
    for k in range(begin, end):
        give_way(0)
        failure[3] = k
        if k >= lag:
            slot = k % out.F.shape[0]
            _predict(tables, k - lag, kinds, weights, xk, R, out.Q[0], out.F[slot], failure)
            if failure[0] != 0:
                return
        dense.put_vector(out.x_predicted[k], 0, xk)
        copy(transposed_matmul(R, R), out.P_predicted[k])
        copy(out.P_predicted[k], out.P[k])
        out.nis[k], out.used[k] = 0.0, 0
        start, stop = given.row_offsets[k], given.row_offsets[k + 1]
        rows = stop - start
        S = spreads[offsets[k] : offsets[k + 1]].reshape(rows, rows)
        if k == begin and sum_of_squares(ahead) > 0.0:
            for i in range(offsets[k], offsets[k + 1]):
                spreads[i] = np.nan
            update_epoch(
                tables, given, iterations, k, ahead, q, xk, out.P[k], squares, out, failure
            )
            if failure[0] == 0 and not factor(out.P[k], R):
                failure[0] = NOT_POSITIVE
        elif rows > 0:
            r = innovations[start:stop]
            _measured(tables, given, weights, iterations, k, xk, R, out, r, S, failure)
            copy(transposed_matmul(R, R), out.P[k])
        if failure[0] != 0:
            return
        dense.put_vector(out.x[k], 0, xk)
        if not sound(xk, R):
            failure[0] = NOT_FINITE
            return
