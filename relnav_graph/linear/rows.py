"""The compiled loops that linearise all observations of the sensors and intervals of the processes.

The loops are compiled once for all models: they call a kernel by its address. They find out a
kernel that leaves an entry unfilled or writes past its arrays.

A linearised observation is r + H d, a linearised interval e + A d_k + B d_k+1, with d the
tangent vector of a whole epoch's state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import (
    GUARD,
    INDEX_MATRIX,
    INDICES,
    MARK,
    MATRIX,
    STACK,
    VECTOR,
    call_dynamics,
    call_sensor,
)
from relnav_graph.linear.tables import (
    ADDRESS,
    COLUMNS,
    EPOCH,
    GATHER,
    KINDS,
    NUMBERED,
    OWN_COLUMN,
    OWN_PLACE,
    Q_DATA,
    ROW,
    ROWS,
    SCATTER,
    SENSOR,
    SPREAD,
    TABLES,
    U_DATA,
    U_ROWS,
    WHITEN,
    WIDTH,
    Z_DATA,
    P,
    Tables,
)
from relnav_graph.linear.whitening import RESOLUTION
from relnav_graph.maths import dense
from relnav_graph.maths.dense import scaled_cholesky, solve_lower
from relnav_graph.maths.manifold import local

__all__ = [
    "BROKEN",
    "MeasurementRows",
    "measure",
    "observe",
    "propagate",
    "transition",
    "whitening",
]

#: Of a spread: the step by which its effect is found, short enough to be in proportion.
SMALL = 1e-3
# Statuses that the loops add to those of the kernels, and what they mean.
UNFILLED, OUTSIDE = -1, -2
BROKEN = {UNFILLED: "left an entry unfilled or not finite", OUTSIDE: "wrote past its arrays"}


@dataclass(frozen=True, eq=False)
class MeasurementRows:
    """Whitened rows r + H d of all observations, d the tangent vector of their epoch.

    r (R,); H (R, n); status (observations,): 0, or why an observation is impossible.
    """

    r: Array
    H: Array
    status: Indices


@jit
def _guarded(n: int) -> Array:
    """A buffer for n numbers with guards on both sides, (n + 2 GUARD,)."""
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
def _matrix(numbers: Array, start: int, rows: int, columns: int) -> Array:
    """The matrix (rows, columns) whose rows stand in `numbers` from `start` on: a view."""
    return numbers[start : start + rows * columns].reshape(rows, columns)


@jit
def _gather(x: Array, places: Indices, out: Array) -> None:
    """``out = x[places]``: the stored values of some blocks of a state x (size,)."""
    for i in range(places.shape[0]):
        out[i] = x[places[i]]


@jit
def observe(
    tables: Tables,
    first: int,
    last: int,
    epoch: int,
    x: Array,
    weight: Array,
    r: Array,
    H: Array,
    status: Indices,
) -> None:
    """Fill the whitened rows ``r + H d`` of observations first to last - 1, in order of time.

    x (N, size): states, from `epoch` on; weight (last - first,): square roots of robust
    weights. Fills r (rows,), H (rows, n), status (last - first,). Rows of observations whose
    status is not 0, or whose weight is 0, are zero.
    """
    for i in range(r.shape[0]):
        r[i] = 0.0
        for j in range(H.shape[1]):
            H[i, j] = 0.0
    start, sensor_of = first, tables.observations[:, SENSOR]
    while start < last:  # one turn for each run of observations of the same sensor
        stop, sensor = start + 1, sensor_of[start]
        while stop < last and sensor_of[stop] == sensor:
            stop += 1
        one = tables.sensors[sensor]
        _observe_run(tables, one, first, start, stop, epoch, x, weight, r, H, status)
        start = stop


@jit
def _observe_run(
    tables: Tables,
    sensor: Indices,
    first: int,
    start: int,
    stop: int,
    epoch: int,
    x: Array,
    weight: Array,
    r: Array,
    H: Array,
    status: Indices,
) -> None:
    """:func:`observe` of observations start to stop - 1, all of one sensor.

    sensor: (9,), its row of the table; the other arrays as in :func:`observe`.
    """
    observations, places, numbers = tables.observations, tables.places, tables.numbers
    p = numbers[sensor[P] : sensor[P + 1]]
    gather = places[sensor[GATHER] : sensor[GATHER + 1]]
    shared = places[sensor[COLUMNS] : sensor[COLUMNS + 1]]
    rows, known, own = sensor[ROWS], gather.shape[0], sensor[NUMBERED]
    n = shared.shape[0] + own
    x_one, columns = np.empty(known + own), np.empty(n, np.int64)
    for j in range(n - own):
        columns[j] = shared[j]
    r_buffer, h_buffer = _guarded(rows), _guarded(rows * n)
    r_one = r_buffer[GUARD : GUARD + rows]
    h_one = _matrix(h_buffer, GUARD, rows, n)
    for o in range(start, stop):
        give_way(o)
        i, one = o - first, observations[o]
        status[i] = 0
        if weight[i] == 0.0:
            continue
        _reset(r_buffer)
        _reset(h_buffer)
        _gather(x[one[EPOCH] - epoch], gather, x_one)
        for j in range(own):
            x_one[known + j] = x[one[EPOCH] - epoch, one[OWN_PLACE] + j]
            columns[n - own + j] = one[OWN_COLUMN] + j
        q, z = numbers[one[Q_DATA] : one[Q_DATA + 1]], numbers[one[Z_DATA] : one[Z_DATA + 1]]
        status[i] = call_sensor(sensor[ADDRESS], p, q, z, x_one, r_one, h_one)
        wrong = min(_verdict(r_buffer), _verdict(h_buffer))
        if wrong == OUTSIDE or (wrong == UNFILLED and status[i] == 0):
            status[i] = wrong
        if status[i] != 0:
            continue
        row = one[ROW] - observations[first, ROW]
        for a in range(rows):
            for b in range(a + 1):
                w = weight[i] * numbers[one[WHITEN] + a * rows + b]
                r[row + a] += w * r_one[b]
                for j in range(n):
                    H[row + a, columns[j]] += w * h_one[b, j]


@jit
def _add_spreads(
    address: int,
    p: Array,
    t: float,
    u: Array,
    spreads: Array,
    x: Array,
    x_next: Array,
    kinds: Indices,
    F: Array,
    Q: Array,
) -> None:
    """``Q += sum of d d^T``, d (n,) how far one sigma of one held input moves x_next.

    u (rows, 1 + channels), spreads (rows, channels): of the interval of a process, from t, s; x,
    x_next: stored values of the blocks it takes, and of those it advances; F (n, columns): not
    changed; Q (n, n).
    """
    n, moved = Q.shape[0], u.copy()
    other, slope, noise = np.empty(x_next.shape[0]), np.empty(F.shape), np.empty((n, n))
    for row in range(u.shape[0]):
        for channel in range(spreads.shape[1]):
            sigma = spreads[row, channel]
            if sigma == 0.0:
                continue
            moved[row, 1 + channel] = u[row, 1 + channel] + SMALL * sigma
            call_dynamics(address, p, t, moved, x, other, slope, noise)
            moved[row, 1 + channel] = u[row, 1 + channel]
            d = local(x_next, other, kinds, n)
            for i in range(n):
                for j in range(n):
                    Q[i, j] += d[i] * d[j] / (SMALL * SMALL)


@jit
def propagate(
    tables: Tables, k: int, x: Array, x_next: Array, F: Array, Q: Array
) -> tuple[int, int]:
    """Fill x_next (size,), F (n, columns) and Q (n, n) of interval k from the state x (size,).

    ``x_next = f(x)``, ``F = d x_next / d x`` between tangents, Q the covariance of the process
    noise, n of the blocks that move; a Q without rows is not wanted. What belongs to static blocks
    in x_next, and in further rows of F, is left as it is. Returns the number and status of the
    process that failed; -1, 0 when none did.
    """
    intervals, places, numbers = tables.intervals, tables.places, tables.numbers
    for a in range(tables.processes.shape[0]):
        process = tables.processes[a]
        p = numbers[process[P] : process[P + 1]]
        gather = places[process[GATHER] : process[GATHER + 1]]
        scatter = places[process[SCATTER] : process[SCATTER + 1]]
        columns = places[process[COLUMNS] : process[COLUMNS + 1]]
        rows = places[process[ROWS] : process[ROWS + 1]]
        m, n, size = rows.shape[0], columns.shape[0], scatter.shape[0]
        x_one = np.empty(gather.shape[0])
        _gather(x, gather, x_one)
        x_buffer, f_buffer, q_buffer = _guarded(size), _guarded(m * n), _guarded(m * m)
        _reset(x_buffer)
        _reset(f_buffer)
        _reset(q_buffer)
        x_out = x_buffer[GUARD : GUARD + size]
        f_out = _matrix(f_buffer, GUARD, m, n)
        q_out = _matrix(q_buffer, GUARD, m, m)
        u = _matrix(numbers, intervals[k, a, U_DATA], intervals[k, a, U_ROWS], process[WIDTH])
        status = call_dynamics(process[ADDRESS], p, tables.starts[k], u, x_one, x_out, f_out, q_out)
        wrong = min(_verdict(x_buffer), _verdict(f_buffer), _verdict(q_buffer))
        if wrong == OUTSIDE or (wrong == UNFILLED and status == 0):
            status = wrong
        if status != 0:
            return a, status
        if intervals[k, a, SPREAD] != 0 and Q.shape[0] > 0:
            begin = intervals[k, a, U_DATA] + u.size
            spreads = _matrix(numbers, begin, u.shape[0], u.shape[1] - 1)
            kinds = places[process[KINDS] : process[KINDS + 1]].reshape(-1, 4)
            _add_spreads(
                process[ADDRESS], p, tables.starts[k], u, spreads, x_one, x_out, kinds, f_out, q_out
            )
        for i in range(size):
            x_next[scatter[i]] = x_out[i]
        for i in range(m):
            for j in range(F.shape[1]):
                F[rows[i], j] = 0.0
            for j in range(Q.shape[1]):
                Q[rows[i], j] = 0.0
            for j in range(n):
                F[rows[i], columns[j]] = f_out[i, j]
            for j in range(m if Q.shape[0] > 0 else 0):
                Q[rows[i], rows[j]] = q_out[i, j]
    return -1, 0


@jit_loop(TABLES, MATRIX, VECTOR, VECTOR, MATRIX, INDICES)
def measure(tables: Tables, x: Array, weight: Array, r: Array, H: Array, status: Indices) -> None:
    """Fill the whitened rows ``r + H d`` of all observations of a pass.

    x: states (N, size); weight, status: (observations,); r: (R,); H: (R, n).
    """
    observe(tables, 0, tables.observations.shape[0], 0, x, weight, r, H, status)


@jit_loop(TABLES, MATRIX, MATRIX, STACK, STACK, INDICES)
def transition(
    tables: Tables, x: Array, x_next: Array, F: Array, Q: Array, failure: Indices
) -> None:
    """Propagate the states x (M, size) over all intervals.

    Fills x_next (M, size), F (M, n, columns) and Q (M, n, n); see :func:`propagate`.
    failure (3,): interval, process and status where one cannot be propagated.
    """
    for k in range(tables.starts.shape[0]):
        give_way(k)
        process, status = propagate(tables, k, x[k], x_next[k], F[k], Q[k])
        if status != 0:
            failure[0], failure[1], failure[2] = k, process, status
            return


@jit
def _resolution(x: Array, kinds: Indices, out: Array) -> None:
    """What rounding lets a state x (size,) be told to, along each axis of its tangent, out (n,):
    `RESOLUTION` of the largest value in its block, or of 1 rad."""
    for b in range(kinds.shape[0]):
        largest = kinds[b, 0] * 1.0
        for i in range(kinds[b, 3] if kinds[b, 0] == 0 else 0):
            largest = max(largest, abs(x[kinds[b, 1] + i]))
        for i in range(kinds[b, 3]):
            out[kinds[b, 2] + i] = RESOLUTION * largest


@jit_loop(TABLES, STACK, MATRIX, INDEX_MATRIX, STACK, INDICES)
def whitening(
    tables: Tables, Q: Array, x_next: Array, kinds: Indices, whiten: Array, failure: Indices
) -> None:
    """Inverse Cholesky factors ``W = L^-1``, ``L L^T = Q``, of the process noise Q (M, n, n).

    x_next (M, size): states at the ends of the intervals. A variance below what their rounding
    lets be told, as over microseconds, is raised to that: its residuals would be noise.
    Fills whiten (M, n, n), process by process: Q is block-diagonal. failure (3,): interval,
    process and 1 where a block is not positive definite.
    """
    floor = np.zeros(Q.shape[1])
    for a in range(tables.processes.shape[0]):
        process = tables.processes[a]
        rows = tables.places[process[ROWS] : process[ROWS + 1]]
        n = rows.shape[0]
        own, L, scale = np.empty((n, n)), np.empty((n, n)), np.empty(n)
        for k in range(Q.shape[0]):
            _resolution(x_next[k], kinds, floor)
            give_way(k)
            for i in range(n):
                for j in range(n):
                    own[i, j] = Q[k, rows[i], rows[j]]
                least = floor[rows[i]] * floor[rows[i]]
                if own[i, i] < least:
                    own[i, i] += least
            if not scaled_cholesky(own, scale, L):
                failure[0], failure[1], failure[2] = k, a, 1
                return
            inverse = dense.identity(n)
            solve_lower(L, inverse)
            for i in range(n):
                for j in range(n):
                    whiten[k, rows[i], rows[j]] = inverse[i, j] / scale[j]
