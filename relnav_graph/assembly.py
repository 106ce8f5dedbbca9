"""A problem as contiguous arrays, linearised in one compiled call per model.

Filter and smoothers take their numbers from here, so they share every model, every
whitening and every skipped observation. Rows are whitened: multiplied by the inverse
Cholesky factor of their covariance. Columns are the tangent of one whole epoch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from relnav_graph.compiled import dynamics_address, sensor_address
from relnav_graph.errors import GeometryError, InputError, ModelError
from relnav_graph.loops import BROKEN, interval_rows, measure, transition
from relnav_graph.models import Dynamics, Measurement, Sensor
from relnav_graph.problem import Epoch, check_epoch
from relnav_graph.state import Layout

__all__ = ["Assembly", "MeasurementRows", "ProcessRows"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ProcessRows:
    """Whitened rows of all intervals: e + A d_k + B d_k+1. (M, n), (M, n, n) twice."""

    e: Array
    A: Array
    B: Array


@dataclass(frozen=True, eq=False)
class MeasurementRows:
    """Whitened rows of all observations: r + H d. (R,), (R, n); status (observations,)."""

    r: Array
    H: Array
    status: Indices


@dataclass(frozen=True, eq=False)
class _SensorArrays:
    """All observations of one sensor, in order of time."""

    name: str
    sensor: Sensor
    kernel: int
    p: Array
    q: Array
    z: Array
    ids: Indices
    epoch: Indices
    row: Indices
    whiten: Array
    gather: Indices
    columns: Indices
    part: slice  # of all observations

    def only(self, some: slice, first_row: int, part: slice) -> _SensorArrays:
        """Some observations, all of one epoch whose rows begin at first_row."""
        row = self.row[some] - first_row
        return replace(
            self,
            q=self.q[some],
            z=self.z[some],
            ids=self.ids[some],
            epoch=np.zeros(len(row), dtype=np.int64),
            row=row,
            whiten=self.whiten[some],
            part=part,
        )

    def check(self, status: Indices, times: Array) -> None:
        """Raise ModelError when the kernel broke its contract at an observation."""
        if np.count_nonzero(status) and (status < 0).any():
            i = int(np.nonzero(status < 0)[0][0])
            raise ModelError(
                f"sensor {self.name!r} ({self.sensor.kind}), id {self.ids[i]}"
                f" at t = {times[self.epoch[i]]} s: the kernel {BROKEN[int(status[i])]}"
            )


@dataclass(frozen=True, eq=False)
class _ProcessArrays:
    """All intervals of one process."""

    name: str
    process: Dynamics
    kernel: int
    p: Array
    u: Array
    offset: Indices
    gather: Indices
    scatter: Indices
    columns: Indices
    rows: Indices

    def only(self, intervals: slice) -> _ProcessArrays:
        """Some adjoining intervals, or none."""
        offset = self.offset[intervals.start : intervals.stop + 1]
        u = self.u[offset[0] : offset[-1]] if len(offset) else self.u[:0]
        return replace(self, u=u, offset=offset - offset[:1])


def process_rows(layout: Layout, x_next: Array, x1: Array, F: Array, whiten: Array) -> ProcessRows:
    """Rows of intervals that lead to x1 (M, size), predicted as x_next (M, size).

    F (M, n, columns): sensitivity of x_next; whiten (M, n, n).
    """
    return ProcessRows(*interval_rows(x_next, x1, F, whiten, layout.kinds))


def inverse_cholesky(where: str, covariances: Array) -> Array:
    """Whitening matrices (..., n, n) of covariances. Raises InputError unless positive
    definite."""
    scale = np.sqrt(np.einsum("...ii->...i", covariances))
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = covariances / (scale[..., :, None] * scale[..., None, :])
    try:
        if not np.isfinite(scaled).all():
            raise np.linalg.LinAlgError
        factor = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError as error:
        variances = np.einsum("...ii->...i", covariances)
        raise InputError(
            f"{where}: the noise covariance is not positive definite (variances"
            f" {variances.min():.3g} to {variances.max():.3g}); expected densities and sigmas > 0"
        ) from error
    return np.ascontiguousarray(np.linalg.inv(factor) / scale[..., None, :])


def _noise(name: str, sensor: Sensor, m: Measurement) -> Array:
    noise = np.asarray(sensor.noise(m))
    expected = (len(m.z), sensor.rows, sensor.rows)
    if noise.shape != expected:
        raise ModelError(
            f"sensor {name!r} at t = {m.t} s: noise gives {noise.shape}, expected {expected}"
        )
    return noise


class Assembly:
    """Epochs, with the intervals that lead to them, as arrays.

    t_before: start of an interval that leads to the first epoch, None when it has none.
    Raises InputError or ModelError on an epoch or a model that is not in order.
    """

    def __init__(
        self,
        layout: Layout,
        processes: Mapping[str, Dynamics],
        sensors: Mapping[str, Sensor],
        epochs: Sequence[Epoch],
        t_before: float | None = None,
    ) -> None:
        # The compiled loops trust every size: nothing unchecked may reach them.
        before = [t_before, *(e.t for e in epochs[:-1])]
        for t, epoch in zip(before, epochs, strict=True):
            check_epoch(processes, sensors, epoch, t)
        self.layout = layout
        self.times = np.array([e.t for e in epochs])
        self._sensors, self.row_offsets = self._stack_sensors(sensors, epochs)
        self.observations = sum(len(s.z) for s in self._sensors)
        first = 1 if t_before is None else 0
        starts = self.times[:-1] if t_before is None else np.array([t_before, *self.times[:-1]])
        self._starts = np.ascontiguousarray(starts)
        self._processes = [
            self._stack_process(name, process, epochs[first:])
            for name, process in processes.items()
        ]

    def at(self, k: int) -> Assembly:
        """Epoch k alone, with the interval that leads to it: what the constructor makes
        of it, without its cost."""
        one = copy(self)
        for name in ("_by_epoch", "observation_rows"):
            one.__dict__.pop(name, None)
        one.times = self.times[k : k + 1]
        first = int(self.row_offsets[k])
        one.row_offsets = self.row_offsets[k : k + 2] - first
        one._sensors, one.observations = [], 0
        for s in self._sensors:
            a, b = np.searchsorted(s.epoch, (k, k + 1))
            if b > a:
                part = slice(one.observations, one.observations + int(b - a))
                one._sensors.append(s.only(slice(a, b), first, part))
                one.observations = part.stop
        i = k - len(self.times) + len(self._starts)  # the interval that leads to epoch k
        intervals = slice(max(i, 0), i + 1)
        one._starts = self._starts[intervals]
        one._processes = [a.only(intervals) for a in self._processes]
        return one

    def _stack_sensors(
        self, sensors: Mapping[str, Sensor], epochs: Sequence[Epoch]
    ) -> tuple[list[_SensorArrays], Indices]:
        counts = np.zeros(len(epochs) + 1, dtype=np.int64)
        found: dict[str, list[tuple[int, int, int]]] = {name: [] for name in sensors}
        for k, epoch in enumerate(epochs):
            for i, m in enumerate(epoch.measurements):
                found[m.sensor].append((k, i, int(counts[k + 1])))
                counts[k + 1] += len(m.z) * sensors[m.sensor].rows
        offsets = np.cumsum(counts)
        stacks, start = [], 0
        for name, places in found.items():
            if not places:
                continue
            sensor = sensors[name]
            ms = [epochs[k].measurements[i] for k, i, _ in places]
            sizes = [len(m.z) for m in ms]
            ids = np.concatenate([m.ids for m in ms])
            z = np.concatenate([m.z for m in ms])
            try:
                z = np.ascontiguousarray(sensor.accept(z), dtype=np.float64)
            except InputError as error:
                raise InputError(f"sensor {name!r}: {error}") from error
            noise = np.concatenate([_noise(name, sensor, m) for m in ms])
            row = [
                offsets[k] + o + sensor.rows * np.arange(n)
                for (k, _, o), n in zip(places, sizes, strict=True)
            ]
            gather, columns = self.layout.gather(sensor.reads)
            stacks.append(
                _SensorArrays(
                    name=name,
                    sensor=sensor,
                    kernel=sensor_address(sensor.kernel),
                    p=np.ascontiguousarray(sensor.constants(), dtype=np.float64),
                    q=np.ascontiguousarray(sensor.observation_data(ids), dtype=np.float64),
                    z=z,
                    ids=ids,
                    epoch=np.repeat([k for k, _, _ in places], sizes),
                    row=np.concatenate(row),
                    whiten=inverse_cholesky(f"sensor {name!r}", noise),
                    gather=gather,
                    columns=columns,
                    part=slice(start, start + len(z)),
                )
            )
            start += len(z)
        return stacks, offsets

    def _stack_process(
        self, name: str, process: Dynamics, epochs: Sequence[Epoch]
    ) -> _ProcessArrays:
        parts = [np.ascontiguousarray(e.inputs[name], dtype=np.float64) for e in epochs]
        offset = np.concatenate(([0], np.cumsum([len(u) for u in parts]))).astype(np.int64)
        gather, columns = self.layout.gather(process.advances + process.reads)
        scatter, rows = self.layout.gather(process.advances)
        return _ProcessArrays(
            name=name,
            process=process,
            kernel=dynamics_address(process.kernel),
            p=np.ascontiguousarray(process.constants(), dtype=np.float64),
            u=np.ascontiguousarray(np.concatenate(parts)) if parts else np.zeros((0, 1)),
            offset=offset,
            gather=gather,
            scatter=scatter,
            columns=columns,
            rows=rows,
        )

    @property
    def sensor_parts(self) -> list[tuple[str, slice, int]]:
        """Of each sensor: its name, which of all observations are its own, and how many
        rows each of them has."""
        return [(s.name, s.part, s.sensor.rows) for s in self._sensors]

    @property
    def sensor_rows(self) -> dict[str, NDArray[np.bool_]]:
        """Which of all rows are of each sensor."""
        chosen = np.zeros(self.observations, dtype=bool)
        found = {}
        for s in self._sensors:
            chosen[s.part] = True
            found[s.name] = self.rows_of(chosen)
            chosen[s.part] = False
        return found

    @cached_property
    def observation_rows(self) -> Indices:
        """First row of each observation and the row after its last, (observations, 2)."""
        parts = [np.stack([s.row, s.row + s.sensor.rows], axis=1) for s in self._sensors]
        return np.concatenate(parts) if parts else np.zeros((0, 2), dtype=np.int64)

    @cached_property
    def _by_epoch(self) -> list[Indices]:
        """Of each epoch, its observations, in order of sensor."""
        epoch = np.concatenate([s.epoch for s in self._sensors] or [np.zeros(0, dtype=np.int64)])
        order = np.argsort(epoch, kind="stable")
        return np.split(order, np.searchsorted(epoch[order], np.arange(1, len(self.times))))

    def rows_of(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which of all rows belong to the chosen observations."""
        out = np.zeros(int(self.row_offsets[-1]), dtype=bool)
        for start, stop in self.observation_rows[chosen]:
            out[start:stop] = True
        return out

    def in_order(self, weights: Sequence[Array]) -> Array:
        """Weights of all observations, from those of each epoch assembled on its own."""
        out = np.ones(self.observations)
        for places, values in zip(self._by_epoch, weights, strict=True):
            out[places] = values
        return out

    def by_epoch(self, weights: Array) -> list[Array]:
        """The inverse of :meth:`in_order`."""
        return [weights[places] for places in self._by_epoch]

    def measure(self, x: Array, weight: Array) -> MeasurementRows:
        """Rows of all observations at the states x (N, size).

        weight: (observations,), the square root of a robust weight; 0 leaves one out. An
        observation that is impossible at its state has status > 0 and rows of zeros.
        Raises ModelError when a kernel breaks its contract.
        """
        count = int(self.row_offsets[-1])
        r, H = np.zeros(count), np.zeros((count, self.layout.dim))
        status = np.zeros(self.observations, dtype=np.int64)
        for s in self._sensors:
            measure(
                *(s.kernel, s.p, s.q, s.z, s.epoch, s.row),
                *(x, s.gather, s.columns, s.whiten, weight[s.part], r, H, status[s.part]),
            )
            s.check(status[s.part], self.times)
        return MeasurementRows(r, H, status)

    def transition(self, x: Array) -> tuple[Array, Array, Array]:
        """x_next (M, size), F and Q (M, n, n) of all intervals, from x (M, size).

        Raises ModelError when a kernel breaks its contract, GeometryError when it says
        that an interval cannot be propagated.
        """
        m, n = len(self._starts), self.layout.dim
        x_next, F, Q = np.zeros((m, self.layout.size)), np.zeros((m, n, n)), np.zeros((m, n, n))
        status = np.zeros(m, dtype=np.int64)
        for a in self._processes:
            transition(
                *(a.kernel, a.p, self._starts, a.u, a.offset),
                *(x, a.gather, a.scatter, a.columns, a.rows, x_next, F, Q, status),
            )
            if np.count_nonzero(status):
                k = int(np.nonzero(status)[0][0])
                code = int(status[k])
                where = f"process {a.name!r} ({a.process.kind}) from t = {self._starts[k]} s"
                if code < 0:
                    raise ModelError(f"{where}: the kernel {BROKEN[code]}")
                raise GeometryError(f"{where}: {a.process.failure(code)}")
        return x_next, F, Q

    def whitening(self, Q: Array) -> Array:
        """Whitening matrices (M, n, n) of the process noise. Raises InputError."""
        whiten = np.zeros_like(Q)
        for a in self._processes:
            rows = np.ix_(np.arange(len(Q)), a.rows, a.rows)
            whiten[rows] = inverse_cholesky(f"process {a.name!r}", Q[rows])
        return whiten

    def process(self, x: Array, whiten: Array) -> ProcessRows:
        """Rows of all intervals between the states x (M + 1, size)."""
        x_next, F, _ = self.transition(x[:-1])
        return process_rows(self.layout, x_next, x[1:], F, whiten)
