"""A problem as contiguous arrays, linearised in one compiled call per model.

Filter and smoothers take their numbers from here, so they share every model, every
whitening and every skipped observation. Rows are whitened: multiplied by the inverse
Cholesky factor of their covariance. Columns are the tangent of one whole epoch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import types
from numpy.typing import NDArray

from relnav_graph.compiled import (
    DYNAMICS_KERNEL,
    INDICES,
    MATRIX,
    SENSOR_KERNEL,
    STACK,
    VECTOR,
    dynamics_pointer,
    jit,
    jit_as,
    sensor_pointer,
)
from relnav_graph.errors import GeometryError, InputError, ModelError
from relnav_graph.models import Dynamics, Kernel, Sensor
from relnav_graph.problem import Epoch
from relnav_graph.state import Layout, _jacobian, _local

__all__ = ["Assembly", "MeasurementRows", "ProcessRows"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Statuses that the loops add to those of the kernels.
UNFILLED, OUTSIDE = -1, -2
_GUARD = 64  # numbers before and after each array that a kernel fills
_MARK = 1.2345678901234567e300


@jit
def _guarded(n: int) -> Array:
    """A buffer for n numbers with guards on both sides: a kernel that writes past its
    arrays is found out, before it can spoil anybody else's memory."""
    return np.full(n + 2 * _GUARD, _MARK)


@jit
def _intact(buffer: Array) -> bool:
    for i in range(_GUARD):
        if buffer[i] != _MARK or buffer[buffer.shape[0] - 1 - i] != _MARK:
            return False
    return True


@jit
def _finite(a: Array) -> bool:
    for value in a.flat:  # noqa: SIM110 (numba knows no all() over a generator)
        if not np.isfinite(value):
            return False
    return True


@jit_as(
    types.FunctionType(SENSOR_KERNEL),
    *(VECTOR, MATRIX, MATRIX, INDICES, INDICES),
    *(MATRIX, INDICES, INDICES, STACK, VECTOR),
    *(VECTOR, MATRIX, INDICES),
)
def _measure(
    kernel: Kernel,
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
    """Fill the rows r, H of all observations of one sensor; zero where status != 0."""
    rows, n = whiten.shape[1], columns.shape[0]
    r_buffer, h_buffer = _guarded(rows), _guarded(rows * n)
    r_one = r_buffer[_GUARD : _GUARD + rows]
    h_one = h_buffer[_GUARD : _GUARD + rows * n].reshape(rows, n)
    for i in range(z.shape[0]):
        start = row[i]
        r[start : start + rows] = 0.0
        H[start : start + rows] = 0.0
        if weight[i] == 0.0:
            status[i] = 0
            continue
        r_one[:] = np.nan
        h_one[:, :] = np.nan
        status[i] = kernel(p, q[i], z[i], x[epoch[i]][gather], r_one, h_one)
        if not (_intact(r_buffer) and _intact(h_buffer)):
            status[i] = OUTSIDE
        elif status[i] == 0 and not (_finite(r_one) and _finite(h_one)):
            status[i] = UNFILLED
        if status[i] != 0:
            continue
        for a in range(rows):
            for b in range(a + 1):
                w = weight[i] * whiten[i, a, b]
                r[start + a] += w * r_one[b]
                for j in range(n):
                    H[start + a, columns[j]] += w * h_one[b, j]


@jit_as(
    types.FunctionType(DYNAMICS_KERNEL),
    *(VECTOR, VECTOR, MATRIX, INDICES),
    *(MATRIX, INDICES, INDICES, INDICES, INDICES),
    *(MATRIX, STACK, STACK, INDICES),
)
def _transition(
    kernel: Kernel,
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
    m, n, size = rows.shape[0], columns.shape[0], scatter.shape[0]
    x_buffer, f_buffer, q_buffer = _guarded(size), _guarded(m * n), _guarded(m * m)
    x_one = x_buffer[_GUARD : _GUARD + size]
    f_one = f_buffer[_GUARD : _GUARD + m * n].reshape(m, n)
    q_one = q_buffer[_GUARD : _GUARD + m * m].reshape(m, m)
    for k in range(t.shape[0]):
        x_one[:] = np.nan
        f_one[:, :] = np.nan
        q_one[:, :] = np.nan
        inputs = u[offset[k] : offset[k + 1]]
        status[k] = kernel(p, t[k], inputs, x[k][gather], x_one, f_one, q_one)
        if not (_intact(x_buffer) and _intact(f_buffer) and _intact(q_buffer)):
            status[k] = OUTSIDE
        elif not (_finite(x_one) and _finite(f_one) and _finite(q_one)):
            status[k] = UNFILLED if status[k] == 0 else status[k]
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
def _process_rows(
    x0_next: Array, x1: Array, F: Array, whiten: Array, kinds: Indices
) -> tuple[Array, Array, Array]:
    """e = local(propagate(x_k), x_k+1), whitened, with its exact Jacobians to both ends.

    On SO(3): e = Log(A^T B), de/db = J_r^-1(e), de/da = -J_r^-1(-e), the left inverse.
    """
    count, n = x1.shape[0], F.shape[1]
    e, a, b = np.empty((count, n)), np.empty((count, n, n)), np.empty((count, n, n))
    for k in range(count):
        error = _local(x0_next[k], x1[k], kinds, n)
        w = whiten[k]
        e[k] = w @ error
        a[k] = -(w @ _jacobian(-error, kinds, True)) @ F[k]
        b[k] = w @ _jacobian(error, kinds, True)
    return e, a, b


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

    def check(self, status: Indices, times: Array) -> None:
        for code, what in (
            (UNFILLED, "left an entry unfilled or not finite"),
            (OUTSIDE, "wrote past its arrays"),
        ):
            if (status == code).any():
                i = int(np.nonzero(status == code)[0][0])
                raise ModelError(
                    f"sensor {self.name!r} ({self.sensor.kind}), id {self.ids[i]}"
                    f" at t = {times[self.epoch[i]]} s: the kernel {what}"
                )


@dataclass(frozen=True, eq=False)
class _ProcessArrays:
    """All intervals of one process."""

    name: str
    process: Dynamics
    p: Array
    u: Array
    offset: Indices
    gather: Indices
    scatter: Indices
    columns: Indices
    rows: Indices


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


class Assembly:
    """Epochs, with the intervals that lead to them, as arrays.

    t_before: start of an interval that leads to the first epoch, None when it has none.
    """

    def __init__(
        self,
        layout: Layout,
        processes: Mapping[str, Dynamics],
        sensors: Mapping[str, Sensor],
        epochs: Sequence[Epoch],
        t_before: float | None = None,
    ) -> None:
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
            if z.shape[1] != len(sensor.columns):
                raise InputError(
                    f"sensor {name!r}: found {z.shape[1]} values per row, expected {sensor.columns}"
                )
            noise = np.concatenate([sensor.noise(m) for m in ms])
            if noise.shape != (len(z), sensor.rows, sensor.rows):
                raise ModelError(
                    f"sensor {name!r}: noise gives {noise.shape},"
                    f" expected {(len(z), sensor.rows, sensor.rows)}"
                )
            row = [
                offsets[k] + o + sensor.rows * np.arange(n)
                for (k, _, o), n in zip(places, sizes, strict=True)
            ]
            gather, columns = self.layout.gather(sensor.reads)
            stacks.append(
                _SensorArrays(
                    name=name,
                    sensor=sensor,
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
        parts = [epoch.inputs[name] for epoch in epochs]
        offset = np.concatenate(([0], np.cumsum([len(u) for u in parts]))).astype(np.int64)
        gather, columns = self.layout.gather(process.advances + process.reads)
        scatter, rows = self.layout.gather(process.advances)
        return _ProcessArrays(
            name=name,
            process=process,
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
            _measure(
                sensor_pointer(s.sensor.kernel),
                *(s.p, s.q, s.z, s.epoch, s.row),
                *(x, s.gather, s.columns, s.whiten, weight[s.part]),
                *(r, H, status[s.part]),
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
            _transition(
                dynamics_pointer(a.process.kernel),
                *(a.p, self._starts, a.u, a.offset),
                *(x, a.gather, a.scatter, a.columns, a.rows),
                *(x_next, F, Q, status),
            )
            if status.any():
                k = int(np.nonzero(status)[0][0])
                where = f"process {a.name!r} ({a.process.kind}) from t = {self._starts[k]} s"
                if status[k] > 0:
                    raise GeometryError(f"{where}: status {status[k]}")
                what = (
                    "left an entry unfilled or not finite"
                    if status[k] == UNFILLED
                    else "wrote past its arrays"
                )
                raise ModelError(f"{where}: the kernel {what}")
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
        return ProcessRows(*_process_rows(x_next, x[1:], F, whiten, self.layout.kinds))
