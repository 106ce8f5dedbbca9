"""A problem as contiguous arrays, linearised in one compiled call.

Filter and smoothers take their numbers from here, so they share every model, every
whitening and every skipped observation. Rows are whitened: multiplied by the inverse
Cholesky factor of their covariance. Columns are the tangent of one whole epoch.
Observations stand in order of time, those of an epoch in order of its measurements.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled.contracts import DEGENERATE, dynamics_address, sensor_address
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.epochs import Epoch, check_epoch, observation_data
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Layout
from relnav_graph.errors import GeometryError, InputError, ModelError
from relnav_graph.linear import rows
from relnav_graph.linear.intervals import ProcessRows, process_rows
from relnav_graph.linear.tables import (
    EPOCH,
    OWN_COLUMN,
    OWN_PLACE,
    Q_DATA,
    ROW,
    ROWS,
    SENSOR,
    WHITEN,
    WIDTH,
    Z_DATA,
    Collected,
    Tables,
)
from relnav_graph.linear.whitening import (
    inverse_cholesky,
    measurement_noise,
    raised,
    with_constraints,
)

__all__ = ["Assembly"]


class Assembly:
    """Epochs, with the intervals that lead to them, as arrays.

    t_before: start of an interval that leads to the first epoch, None when it has none. sensors: by
    name; observations: their number; epoch_offsets and row_offsets (N + 1,): where each epoch's
    observations and rows begin; sensor_of (observations,): the place of each one's sensor among
    `sensor_names`. checked: whether the epochs are known to be in order. Raises InputError or
    ModelError on an epoch or a model that is not in order.
    """

    def __init__(
        self,
        layout: Layout,
        processes: Mapping[str, Dynamics],
        sensors: Mapping[str, Sensor],
        epochs: Sequence[Epoch],
        t_before: float | None = None,
        *,
        checked: bool = False,
    ) -> None:
        self.layout = layout
        self.sensor_names = tuple(sensors)
        self.sensors, self._processes = dict(sensors), dict(processes)
        numbers, places = Collected(np.float64), Collected(np.int64)
        sensor_table = np.zeros((len(sensors), 9), dtype=np.int64)
        for i, sensor in enumerate(sensors.values()):
            gather, columns = layout.gather(sensor.reads)
            sensor_table[i] = [
                sensor_address(sensor.kernel),
                *numbers.add(sensor.constants()),
                *places.add(gather),
                *places.add(columns),
                sensor.rows,
                0 if (own := numbered_of(sensor)) is None else own.dim,
            ]
        process_table = np.zeros((len(processes), 14), dtype=np.int64)
        for i, process in enumerate(processes.values()):
            gather, columns = layout.gather(process.advances + process.reads)
            scatter, rows = layout.gather(process.advances)
            process_table[i] = [
                dynamics_address(process.kernel),
                *numbers.add(process.constants()),
                *places.add(gather),
                *places.add(columns),
                *places.add(rows),
                *places.add(scatter),
                1 + sum(len(c) for c in process.inputs.values()),
                *places.add(Layout(process.advances).kinds),
            ]
        self._models = sensor_table, process_table, places.array(), numbers.array()
        self._take(epochs, t_before, checked)

    def _take(self, epochs: Sequence[Epoch], t_before: float | None, checked: bool) -> None:
        """Fill the tables with epochs."""
        # The compiled loops trust every size: nothing unchecked may reach them.
        before = [t_before, *(e.t for e in epochs)][:-1]
        for t, epoch in zip(before, epochs, strict=True) if not checked else ():
            check_epoch(self._processes, self.sensors, epoch, t)
        self.times = np.array([e.t for e in epochs])
        starts = self.times[:-1] if t_before is None else np.array([t_before, *self.times[:-1]])
        sensor_table, process_table, places, constants = self._models
        numbers = Collected(np.float64)
        numbers.add(constants)
        observations = self._stack_observations(epochs, numbers)
        intervals = np.zeros((len(starts), len(process_table), 3), dtype=np.int64)
        for i, name in enumerate(self._processes):
            for k, epoch in enumerate(epochs[len(epochs) - len(starts) :]):
                u, width = epoch.inputs[name], process_table[i, WIDTH]
                spread = u.shape[1] > width
                intervals[k, i] = numbers.add(u[:, :width])[0], len(u), spread
                if spread:
                    numbers.add(u[:, width:])
        self.tables = Tables(
            *(sensor_table, observations, process_table, intervals),
            *(np.ascontiguousarray(starts), places, numbers.array()),
        )

    def again(self, epoch: Epoch, t_before: float | None) -> Assembly:
        """The assembly of another epoch with the same models.

        t_before: s, see the class. Equal to a new one, at a third of the constructor's cost.
        """
        one = copy(self)
        one._take([epoch], t_before, False)
        return one

    @classmethod
    def of(cls, problem: Problem) -> Assembly:
        """The assembly of all epochs of a problem, which has checked them already."""
        models = problem.layout, problem.processes, problem.sensors
        return cls(*models, problem.epochs, checked=True)

    @classmethod
    def ahead(cls, problem: Problem, epoch: Epoch, t_before: float | None) -> Assembly:
        """That of one more epoch, with the models of a problem; t_before: s, see the class."""
        return cls(problem.layout, problem.processes, problem.sensors, [epoch], t_before)

    def _stack_observations(self, epochs: Sequence[Epoch], numbers: Collected) -> Indices:
        """The table of observations; their data go to the numbers, sensor by sensor."""
        flat = [(k, m) for k, epoch in enumerate(epochs) for m in epoch.measurements]
        sizes = np.array([len(m.z) for _, m in flat], dtype=np.int64)
        which = {name: i for i, name in enumerate(self.sensor_names)}
        sensor_of = np.array([which[m.sensor] for _, m in flat], dtype=np.int64)
        heights = np.array([s.rows for s in self.sensors.values()], dtype=np.int64)
        self.sensor_of = np.repeat(sensor_of, sizes)
        self.ids = np.concatenate([np.zeros(0, dtype=np.int64), *(m.ids for _, m in flat)])
        self.observations = len(self.ids)
        out = np.zeros((self.observations, 10), dtype=np.int64)
        out[:, SENSOR] = self.sensor_of
        out[:, EPOCH] = np.repeat(np.array([k for k, _ in flat], dtype=np.int64), sizes)
        ends = np.cumsum(heights[self.sensor_of])
        out[:, ROW] = ends - heights[self.sensor_of]
        edges = np.searchsorted(out[:, EPOCH], np.arange(len(epochs) + 1))
        self.epoch_offsets = edges.astype(np.int64)
        self.row_offsets = np.concatenate(([0], ends))[edges].astype(np.int64)
        for name, sensor in self.sensors.items():
            own = np.flatnonzero(self.sensor_of == which[name])
            if not len(own):
                continue
            ms = [m for _, m in flat if m.sensor == name]
            try:
                z = sensor.accept(np.concatenate([m.z for m in ms]))
            except InputError as error:
                raise InputError(f"sensor {name!r}: {error}") from error
            noise = np.concatenate([measurement_noise(name, sensor, m) for m in ms])
            data = observation_data(name, sensor, ms), z
            where = f"sensor {name!r}"
            whiten = inverse_cholesky(where, raised(where, noise, z))
            for column, values in zip((Q_DATA, Z_DATA), data, strict=True):
                begin, end = numbers.add(values)
                width = (end - begin) // len(own)
                out[own, column] = begin + width * np.arange(len(own))
                out[own, column + 1] = out[own, column] + width
            out[own, WHITEN] = numbers.add(whiten)[0] + sensor.rows**2 * np.arange(len(own))
            if (block := numbered_of(sensor)) is not None:
                ids, which_id = np.unique(self.ids[own], return_inverse=True)
                names = [block.numbered(int(i)).name for i in ids]
                starts = [
                    (self.layout.stored(n).start, self.layout.tangent(n).start) for n in names
                ]
                out[own, OWN_PLACE : OWN_COLUMN + 1] = np.array(starts)[which_id]
        return out

    def within(self, layout: Layout) -> Assembly:
        """The same in a layout that has further blocks after those of its own."""
        one = copy(self)
        one.layout = layout
        return one

    def at(self, k: int) -> Assembly:
        """The assembly of epoch k alone, with the interval that leads to it.

        Equal to a new one, without the cost of the constructor.
        """
        one, tables = copy(self), self.tables
        first, last = self.epoch_offsets[k : k + 2]
        one.times = self.times[k : k + 1]
        one.sensor_of, one.ids = self.sensor_of[first:last], self.ids[first:last]
        one.observations = int(last - first)
        one.row_offsets = self.row_offsets[k : k + 2] - self.row_offsets[k]
        one.epoch_offsets = self.epoch_offsets[k : k + 2] - first
        observations = tables.observations[first:last].copy()
        observations[:, EPOCH] = 0
        observations[:, ROW] -= self.row_offsets[k]
        i = k - len(self.times) + len(tables.starts)  # the interval that leads to epoch k
        interval = slice(max(i, 0), i + 1)
        one.tables = tables._replace(
            observations=observations,
            intervals=tables.intervals[interval],
            starts=tables.starts[interval],
        )
        return one

    @classmethod
    def join(cls, parts: Sequence[Assembly]) -> Assembly:
        """Adjoining parts of one pass as one assembly.

        Equal to a new one of all their epochs, without the cost of the constructor. Every part
        but the first must have the interval that leads to it.
        """
        one = copy(parts[0])
        base, numbers, size = dict[int, int](), list[Array](), 0
        observations, intervals, epochs, rows, count = [], [], [], [], 0
        first_row = first_observation = 0
        for part in parts:
            t = part.tables
            if id(t.numbers) not in base:  # parts cut from one assembly share theirs
                base[id(t.numbers)] = size
                numbers.append(t.numbers)
                size += len(t.numbers)
            shift = base[id(t.numbers)]
            own = t.observations + np.array([0, count, first_row, *5 * [shift], 0, 0])
            observations.append(own)
            intervals.append(t.intervals + np.array([shift, 0, 0]))
            epochs.append(part.epoch_offsets[:-1] + first_observation)
            rows.append(part.row_offsets[:-1] + first_row)
            count += len(part.times)
            first_row += int(part.row_offsets[-1])
            first_observation += part.observations
        one.times = np.concatenate([p.times for p in parts])
        one.sensor_of = np.concatenate([p.sensor_of for p in parts])
        one.ids = np.concatenate([p.ids for p in parts])
        one.observations = first_observation
        one.epoch_offsets = np.concatenate([*epochs, [first_observation]])
        one.row_offsets = np.concatenate([*rows, [first_row]])
        one.tables = parts[0].tables._replace(
            observations=np.concatenate(observations),
            intervals=np.concatenate(intervals),
            starts=np.concatenate([p.tables.starts for p in parts]),
            numbers=np.concatenate(numbers) if len(numbers) > 1 else numbers[0],
        )
        return one

    def preceded(self) -> Assembly:
        """The same with one more epoch in front, at the start of the first interval.

        The new epoch has no measurements.
        """
        one = copy(self)
        one.times = np.concatenate([self.tables.starts[:1], self.times])
        one.epoch_offsets = np.concatenate([[0], self.epoch_offsets])
        one.row_offsets = np.concatenate([[0], self.row_offsets])
        observations = self.tables.observations.copy()
        observations[:, EPOCH] += 1
        one.tables = self.tables._replace(observations=observations)
        return one

    @property
    def heights(self) -> Indices:
        """Rows of each observation (observations,)."""
        rows: Indices = self.tables.sensors[self.sensor_of, ROWS]
        return rows

    def rows_of(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which rows belong to the chosen observations: (observations,) to (R,)."""
        return np.repeat(chosen, self.heights)

    def by_sensor(self, values: NDArray[np.bool_]) -> dict[str, int]:
        """How many of the marked observations each sensor has made; values (observations,)."""
        counts = np.bincount(self.sensor_of[values], minlength=len(self.sensor_names))
        return {name: int(n) for name, n in zip(self.sensor_names, counts, strict=True)}

    def check(self, status: Indices, first: int = 0) -> None:
        """Raise ModelError when a kernel broke its contract at an observation, GeometryError
        when that is degenerate.

        status (count,): of the observations from `first` on.
        """
        if not status.any():
            return
        bad = (status < 0) | (status >= DEGENERATE)
        if bad.any():
            i = int(np.nonzero(bad)[0][0])
            o, name = first + i, self.sensor_names[self.sensor_of[first + i]]
            sensor, t = self.sensors[name], self.times[self.tables.observations[o, EPOCH]]
            where = f"sensor {name!r} ({sensor.kind}), id {self.ids[o]} at t = {t} s"
            if status[i] < 0:
                raise ModelError(f"{where}: the kernel {rows.BROKEN[int(status[i])]}")
            raise GeometryError(f"{where}: {sensor.failure(int(status[i]))}")

    def measure(self, x: Array, weight: Array) -> rows.MeasurementRows:
        """Rows of all observations at the states x (N, size), H to the tangents of all blocks.

        weight: (observations,), the square root of a robust weight; 0 leaves one out. An
        observation that is impossible at its state has status > 0 and rows of zeros. Raises
        InputError on x of another shape, and as `check` does.
        """
        self.layout.check_states(x, len(self.times))
        count = int(self.row_offsets[-1])
        r, H = np.empty(count), np.empty((count, self.layout.dim))
        status = np.empty(self.observations, dtype=np.int64)
        rows.measure(self.tables, x, weight, r, H, status)
        self.check(status)
        return rows.MeasurementRows(r, H, status)

    def check_propagated(self, failure: Indices) -> None:
        """Raise ModelError when a kernel broke its contract in an interval, GeometryError
        when the kernel could not propagate.

        failure (3,): interval, process, status.
        """
        k, i, code = failure.tolist()
        if not code:
            return
        name = list(self._processes)[i]
        process = self._processes[name]
        where = f"process {name!r} ({process.kind}) from t = {self.tables.starts[k]} s"
        if code < 0:
            raise ModelError(f"{where}: the kernel {rows.BROKEN[code]}")
        raise GeometryError(f"{where}: {process.failure(code)}")

    def predict(self, x: Array, P: Array) -> tuple[Array, Array]:
        """``x- = f(x)``, ``P- = F P F^T + Q`` at the end of the only interval.

        x: (size,); P: (dim, dim), of all blocks. Returns the same shapes. Raises as `transition`.
        """
        ahead, F, Q = self.transition(x[None])
        whole, n = np.eye(self.layout.dim), len(Q[0])
        whole[:n] = F[0]
        P = whole @ P @ whole.T
        P[:n, :n] += Q[0]
        return ahead[0], 0.5 * (P + P.T)

    def transition(self, x: Array) -> tuple[Array, Array, Array]:
        """x_next (M, size), F (M, n, dim) and Q (M, n, n) of all intervals, from x (M, size).

        n: tangent dimension of the blocks that move, dim: of all blocks; for what these are see
        `relnav_graph.linear.rows.propagate`.
        Raises InputError on x of another shape, and as `check_propagated` does.
        """
        m, n = len(self.tables.starts), self.layout.moving.dim
        self.layout.check_states(x, m)
        x_next, F, Q = np.array(x), np.empty((m, n, self.layout.dim)), np.empty((m, n, n))
        failure = np.zeros(3, dtype=np.int64)
        rows.transition(self.tables, x, x_next, F, Q, failure)
        self.check_propagated(failure)
        return x_next, F, Q

    def whitening(self, x: Array) -> Array:
        """Whitening matrices (M, n, n) of the process noise of all intervals, from x (M, size).

        Raises as `transition` and `whitening_of`.
        """
        x_next, _, Q = self.transition(x)
        return self.whitening_of(x_next, Q)

    def whitening_of(self, x_next: Array, Q: Array) -> Array:
        """Whitening matrices (M, n, n) of the process noise Q (M, n, n).

        x_next (M, size): states at the ends of the intervals. A state without noise gets a very
        small one, and one with less than its rounding as much as that. Raises InputError when Q
        is not positive definite.
        """
        whiten, failure = np.zeros_like(Q), np.zeros(3, dtype=np.int64)
        if not np.einsum("kii->ki", Q).all():
            Q = with_constraints(Q)
        rows.whitening(self.tables, Q, x_next, self.layout.moving.kinds, whiten, failure)
        if failure[2]:
            name = list(self._processes)[failure[1]]
            _, own = self.layout.gather(self._processes[name].advances)
            inverse_cholesky(f"process {name!r}", Q[failure[0]][np.ix_(own, own)])
        return whiten

    def process(self, x: Array, whiten: Array) -> ProcessRows:
        """Whitened rows of all intervals between the states x (M + 1, size).

        whiten: (M, n, n). Raises as :meth:`transition` does.
        """
        x_next, F, _ = self.transition(np.ascontiguousarray(x[:-1]))
        return process_rows(self.layout.moving, x_next, x[1:], F, whiten)
