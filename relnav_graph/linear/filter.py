"""The compiled filter step: one definition for a whole pass and for one epoch online."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import (
    DEGENERATE,
    INDEX_MATRIX,
    INDICES,
    MATRIX,
    STACK,
    VECTOR,
)
from relnav_graph.linear.innovations import gate, innovation_covariance, misfit
from relnav_graph.linear.partial_update import observe_own, update_others
from relnav_graph.linear.rows import propagate
from relnav_graph.linear.tables import (
    COLUMNS,
    NUMBERED,
    OWN_COLUMN,
    SENSOR,
    TABLES,
    Tables,
    rows_of,
)
from relnav_graph.linear.update import robust_update
from relnav_graph.maths import dense
from relnav_graph.maths.dense import (
    copy,
    sandwich,
    sum_of_squares,
)
from relnav_graph.maths.losses import root_weight
from relnav_graph.maths.manifold import local, retract, times_jacobian

__all__ = [
    "FAILURES",
    "FILTER_INPUT",
    "FILTER_OUTPUT",
    "NOT_POSITIVE",
    "PROPAGATED",
    "SENSOR_BROKE",
    "FilterInput",
    "FilterOutput",
    "filter_epochs",
    "room_for_squares",
    "sound",
    "update_epoch",
]


# What stopped a step: the first of the four numbers of `failure`, see `filter_epochs`.
PROPAGATED, SENSOR_BROKE, NOT_POSITIVE, NOT_FINITE = 1, 2, 3, 4
FAILURES = {
    NOT_POSITIVE: "the covariance is not positive definite",
    NOT_FINITE: "the estimate is not finite",
}


@jit
def sound(x: Array, A: Array) -> bool:
    """Whether a state x (size,) and the matrix A (n, n) of its uncertainty are finite."""
    found = True
    for i in range(x.shape[0]):
        found = found and np.isfinite(x[i])
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            found = found and np.isfinite(A[i, j])
    return found


@jit
def room_for_squares(epoch_offsets: Indices, begin: int, end: int) -> Array:
    """Zeros, as many as the largest of the epochs from begin to end - 1 has observations."""
    most = 0
    for k in range(begin, end):
        most = max(most, epoch_offsets[k + 1] - epoch_offsets[k])
    return np.zeros(most)


class FilterInput(NamedTuple):
    """What a filter is given beside the tables of a pass.

    epoch_offsets, row_offsets (N + 1,): where each epoch's observations and rows begin; kinds
    (blocks, 4): of the state's blocks, see `relnav_graph.maths.manifold`; limits
    (observations,): largest squared normalised innovation that passes the gate, inf for no
    gate; losses (observations, 2): kind and tuning of the robust loss, kind 0 for none;
    considered: the columns that are counted and not estimated.
    """

    epoch_offsets: Indices
    row_offsets: Indices
    kinds: Indices
    limits: Array
    losses: Array
    considered: Indices


class FilterOutput(NamedTuple):
    """What a filter fills in; see `filter_epochs`.

    x_predicted (N, size), P_predicted (N, n, n): before the update; F (N or 1, n, n), Q
    (1, q, q): of the interval that leads to the epoch, q of the blocks that move; x (N, size),
    P (N, n, n): after the update; nis, used (N,); weights (observations,).

    The rows of F that belong to static blocks must be those of the unit matrix.
    """

    x_predicted: Array
    P_predicted: Array
    F: Array
    Q: Array
    x: Array
    P: Array
    weights: Array
    nis: Array
    used: Indices


FILTER_INPUT = types.NamedTuple(
    (INDICES, INDICES, INDEX_MATRIX, VECTOR, MATRIX, INDICES), FilterInput
)
FILTER_OUTPUT = types.NamedTuple(
    (MATRIX, STACK, STACK, STACK, MATRIX, STACK, VECTOR, VECTOR, INDICES), FilterOutput
)


@jit
def update_epoch(
    tables: Tables,
    given: FilterInput,
    iterations: int,
    k: int,
    ahead: Array,
    moving: int,
    xk: Array,
    Pk: Array,
    squares: Array,
    out: FilterOutput,
    failure: Indices,
) -> None:
    """Update the prediction xk (size,), Pk (n, n) of epoch k with what it measured, in place.

    ahead (n,): the step from it to where it is linearised first; moving: dimension of the blocks
    that move; squares: room for as many numbers as the epoch has observations, or more. Fills
    weights, nis and used of `out`, and failure (4,); see `filter_epochs`.
    """
    kinds, n = given.kinds, Pk.shape[0]
    first, last = given.epoch_offsets[k], given.epoch_offsets[k + 1]
    rows = given.row_offsets[k + 1] - given.row_offsets[k]
    out.nis[k], out.used[k] = 0.0, 0
    if last == first:
        return
    losses, weight = given.losses[first:last], out.weights[first:last]
    own, own_kinds = np.arange(n), kinds
    P_own, there, before = Pk, ahead, xk
    # What follows from the others' steps does not hold where some may not take theirs.
    partly = moving < n and given.considered.shape[0] == 0
    if partly:
        own, own_kinds = _read(tables, kinds, n, moving, first, last)
        P_own, there, before = dense.part_of(Pk, own), ahead[own], xk.copy()
    _measured_epoch(
        tables,
        own_kinds,
        own,
        n,
        k,
        first,
        last,
        xk,
        P_own,
        there,
        given.limits[first:last],
        losses,
        weight,
        squares[: last - first],
        rows,
        out.nis,
        out.used,
        failure,
    )
    if failure[0] == 0 and not robust_update(
        tables,
        own_kinds,
        own,
        n,
        k,
        first,
        last,
        rows,
        iterations,
        losses,
        squares[: last - first],
        weight,
        there,
        given.considered,
        xk,
        P_own,
    ):
        failure[0] = NOT_POSITIVE
    if own.shape[0] < n and failure[0] == 0:
        d = local(before, xk, own_kinds, own.shape[0])
        if not update_others(own, d, own_kinds, P_own, kinds, xk, Pk):
            failure[0] = NOT_POSITIVE
    elif partly:
        copy(P_own, Pk)


@jit_loop(
    *(
        TABLES,
        FILTER_INPUT,
        types.int64,
        types.int64,
        types.int64,
        VECTOR,
        MATRIX,
        VECTOR,
        FILTER_OUTPUT,
        INDICES,
    )
)
def filter_epochs(
    tables: Tables,
    given: FilterInput,
    iterations: int,
    begin: int,
    end: int,
    x_before: Array,
    P_before: Array,
    ahead: Array,
    out: FilterOutput,
    failure: Indices,
) -> None:
    """Predict to each epoch from `begin` to `end` and update with what it measured.

        x- = f(x),  P- = F P F^T + Q;   then x, P by `relnav_graph.linear.update.update`

    x_before (size,), P_before (n, n): the estimate before epoch `begin`; epochs begin to
    end - 1 are done. ahead (n,): the step from the first epoch's prediction to where its
    measurements are linearised first. Fills `out`, where nis is ``r^T (H P- H^T + I)^-1 r`` of
    the rows used, `used` the number of these rows, and `weights` the square root of a robust
    weight, 0 for an observation left out. F and Q may have room for one epoch only: then they
    keep the last one's. failure (4,): what stopped the filter, process or observation, status,
    epoch.
    """
    epoch_offsets, x, P = given.epoch_offsets, out.x, out.P
    x_predicted, P_predicted, F, Q = out.x_predicted, out.P_predicted, out.F, out.Q
    lag = epoch_offsets.shape[0] - 1 - tables.starts.shape[0]
    xk, Pk = x_before.copy(), P_before.copy()
    n = Pk.shape[0]
    squares, here = room_for_squares(epoch_offsets, begin, end), np.zeros(n)
    for k in range(begin, end):
        give_way(0)
        for j in range(n):
            here[j] = ahead[j] if k == begin else 0.0
        slot = k % F.shape[0]
        failure[3] = k
        if k >= lag:
            dense.put_vector(x_predicted[k], 0, xk)
            a, status = propagate(tables, k - lag, xk, x_predicted[k], F[slot], Q[0])
            if status != 0:
                failure[0], failure[1], failure[2] = PROPAGATED, a, status
                return
            dense.put_vector(xk, 0, x_predicted[k])
            sandwich(F[slot], Pk, P_predicted[k])
            for i in range(Q.shape[1]):
                for j in range(Q.shape[1]):
                    P_predicted[k, i, j] += Q[0, i, j]
            copy(P_predicted[k], Pk)
        else:
            dense.put_vector(x_predicted[k], 0, xk)
            copy(Pk, P_predicted[k])
        update_epoch(tables, given, iterations, k, here, Q.shape[1], xk, Pk, squares, out, failure)
        if failure[0] != 0:
            return
        dense.put_vector(x[k], 0, xk)
        copy(Pk, P[k])
        if not sound(xk, Pk):
            failure[0] = NOT_FINITE
            return


@jit
def _read(
    tables: Tables, kinds: Indices, n: int, moving: int, first: int, last: int
) -> tuple[Indices, Indices]:
    """The columns of all blocks that move, `moving` of n, and of the static ones that observations
    first to last - 1 read; and the kinds of these blocks, with their places among these columns."""
    read = np.zeros(n, np.int64)
    read[:moving] = 1
    for o in range(first, last):
        sensor = tables.sensors[tables.observations[o, SENSOR]]
        if o == first or tables.observations[o, SENSOR] != tables.observations[o - 1, SENSOR]:
            for i in range(sensor[COLUMNS], sensor[COLUMNS + 1]):
                read[tables.places[i]] = 1
        for j in range(sensor[NUMBERED]):
            read[tables.observations[o, OWN_COLUMN] + j] = 1
    own, own_kinds = np.flatnonzero(read), np.empty_like(kinds)
    blocks = filled = 0
    for k in range(kinds.shape[0]):
        if read[kinds[k, 2]] != 0:
            own_kinds[blocks] = kinds[k]
            own_kinds[blocks, 2] = filled
            blocks, filled = blocks + 1, filled + kinds[k, 3]
    return own, own_kinds[:blocks]


@jit
def _measured_epoch(
    tables: Tables,
    kinds: Indices,
    own: Indices,
    whole: int,
    k: int,
    first: int,
    last: int,
    x: Array,
    P: Array,
    ahead: Array,
    limit: Array,
    losses: Array,
    weight: Array,
    squares: Array,
    rows: int,
    nis: Array,
    used: Indices,
    failure: Indices,
) -> None:
    """Gate epoch k: fill weights, squares, nis[k] and used[k] from the innovations.

    x (size,): the prediction; P (n, n): its covariance, of the blocks of `kinds`, which have the
    columns own (n,) of all, of dimension `whole`; ahead (n,): the step from there to where the
    measurements are linearised; limit, weight, squares (observations of the epoch,);
    losses (observations of the epoch, 2); rows: number of their rows; nis, used (N,).
    """
    n = P.shape[0]
    r, H, S = np.empty(rows), np.empty((rows, n)), np.empty((rows, rows))
    status = np.empty(last - first, np.int64)
    for i in range(last - first):
        weight[i] = 1.0
    at = np.empty((1, x.shape[0]))
    moved = sum_of_squares(ahead) > 0.0
    dense.put_vector(at[0], 0, retract(x, ahead, kinds) if moved else x)
    observe_own(tables, first, last, k, at, weight, own, whole, r, H, status)
    if moved:
        times_jacobian(H, ahead, kinds, False)
        for i in range(rows):
            for j in range(n):
                r[i] -= H[i, j] * ahead[j]
    for i in range(last - first):
        if status[i] < 0 or status[i] >= DEGENERATE:
            failure[0], failure[1], failure[2] = SENSOR_BROKE, first + i, status[i]
            return
        weight[i] = 1.0 if status[i] == 0 else 0.0
    innovation_covariance(H, P, S)
    gate(tables, S, r, limit, losses, first, weight, squares)
    # Rows that are not used become zero: they then add nothing to the misfit.
    for i in range(last - first):
        start, count = rows_of(tables.observations, tables.sensors, first, i)
        if weight[i] != 0.0:
            used[k] += count
            if losses[i, 0] != 0.0:  # the misfit counts as far as the loss lets it
                for a in range(start, start + count):
                    r[a] *= root_weight(losses[i, 0], losses[i, 1], squares[i])
            continue
        for a in range(start, start + count):
            r[a] = 0.0
            for j in range(n):
                H[a, j] = 0.0
    nis[k] = misfit(H, P, r)
    if not np.isfinite(nis[k]):
        failure[0] = NOT_POSITIVE
