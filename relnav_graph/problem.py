"""The estimation problem: all that an estimator sees, immutable.

Filter and smoothers receive the same `Problem`: that is the fairness argument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError, ModelError
from relnav_graph.maths.losses import Loss
from relnav_graph.models import Dynamics, Measurement, Sensor, check_inputs
from relnav_graph.state import Layout

__all__ = ["Epoch", "InputSeries", "Prior", "Problem", "make_epochs"]

#: Times closer than this are the same, s: above the rounding of stamps of 1e9 s.
SAME_TIME = 1e-6


@dataclass(frozen=True, eq=False)
class InputSeries:
    """A known input: the mean of `values` (n, channels) over each [t_start, t_end], s.

    Raises InputError on values that are not finite and on intervals that overlap or run
    backwards.
    """

    name: str
    t_start: Array
    t_end: Array
    values: Array

    def __post_init__(self) -> None:
        for key in ("t_start", "t_end", "values"):
            array = np.array(getattr(self, key), dtype=np.float64, order="C")
            if not np.isfinite(array).all():
                raise InputError(f"input {self.name!r}: {key} holds a value that is not finite")
            object.__setattr__(self, key, array)
        n = len(self.t_start)
        if self.t_end.shape != (n,) or self.values.ndim != 2 or len(self.values) != n:
            raise InputError(f"input {self.name!r}: t_start, t_end and values differ in length")
        backwards = self.t_end <= self.t_start
        backwards[1:] |= self.t_start[1:] < self.t_end[:-1] - SAME_TIME
        if backwards.any():
            t = self.t_start[np.nonzero(backwards)[0][0]]
            raise InputError(f"input {self.name!r}: intervals overlap or run backwards at {t} s")

    def over(self, t0: float, t1: float) -> tuple[Array, Array]:
        """Edges (k + 1,) and values (k, channels) covering [t0, t1]. Raises InputError
        where there is no sample."""
        tolerance = SAME_TIME
        i = int(np.searchsorted(self.t_end, t0 + tolerance, side="right"))
        j = int(np.searchsorted(self.t_start, t1 - tolerance, side="left"))
        starts, ends = self.t_start[i:j], self.t_end[i:j]
        if j <= i or starts[0] > t0 + tolerance or ends[-1] < t1 - tolerance:
            raise InputError(f"input {self.name!r} does not cover {t0} s to {t1} s")
        gaps = starts[1:] - ends[:-1] > tolerance
        if gaps.any():
            t = ends[:-1][gaps][0]
            raise InputError(f"input {self.name!r} has a gap after {t} s")
        return np.concatenate(([t0], ends[:-1], [t1])), self.values[i:j]


@dataclass(frozen=True, eq=False)
class Epoch:
    """A time, what was measured then, and the inputs since the epoch before.

    inputs: for each process, u (rows, 1 + channels) as its kernel wants it.
    """

    t: float
    measurements: tuple[Measurement, ...] = ()
    inputs: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Prior:
    """Mean x (stored vector) and covariance P (tangent) at the first epoch.

    Raises InputError when x is not finite or P not symmetric positive definite.
    """

    x: Array
    P: Array

    def __post_init__(self) -> None:
        if not np.isfinite(self.x).all():
            raise InputError(f"the prior: found x = {self.x}, expected finite values")
        check_covariance("the prior", self.P)


def check_epoch(
    processes: Mapping[str, Dynamics],
    sensors: Mapping[str, Sensor],
    epoch: Epoch,
    t_before: float | None,
) -> None:
    """Check an epoch and, unless t_before is None, the interval that leads to it.

    Raises InputError when a sensor is unknown, a measurement is of another time or width,
    or a process lacks inputs, has some of another form, or of another length of time.
    """
    for m in epoch.measurements:
        if m.sensor not in sensors:
            raise InputError(f"t = {m.t} s: unknown sensor {m.sensor!r}")
        if abs(m.t - epoch.t) > SAME_TIME:
            raise InputError(f"sensor {m.sensor!r}: found t = {m.t} s in the epoch at {epoch.t} s")
        columns = sensors[m.sensor].columns
        if m.z.shape[1] != len(columns):
            raise InputError(
                f"sensor {m.sensor!r} at t = {m.t} s: found z of {m.z.shape}, expected {columns}"
            )
    for name, process in processes.items() if t_before is not None else ():
        where = f"process {name!r} ({process.kind}) from {t_before} s to {epoch.t} s"
        if name not in epoch.inputs:
            raise InputError(f"{where}: found no inputs for it in the epoch")
        u = check_inputs(where, process.inputs, epoch.inputs[name])
        length, expected = float(u[:, 0].sum()), epoch.t - float(t_before or 0.0)
        if abs(length - expected) > SAME_TIME:
            raise InputError(f"{where}: found inputs over {length} s, expected {expected} s")


def check_covariance(where: str, P: Array) -> None:
    """Raise InputError unless P is finite, symmetric and positive definite."""
    P = np.asarray(P)
    if P.ndim != 2 or P.shape[0] != P.shape[1] or not np.isfinite(P).all():
        raise InputError(f"covariance of {where}: found {P.shape}, expected finite and square")
    scale = np.sqrt(np.abs(np.diag(P)))
    if (np.diag(P) <= 0).any():
        raise InputError(f"covariance of {where}: found variance {np.diag(P).min()}, expected > 0")
    if np.abs((P - P.T) / np.outer(scale, scale)).max() > 1e-9:
        raise InputError(f"covariance of {where} is not symmetric")
    smallest = np.linalg.eigvalsh(P / np.outer(scale, scale)).min()
    if smallest <= 0:
        raise InputError(
            f"covariance of {where} is not positive definite: smallest eigenvalue of the"
            f" correlation matrix {smallest:.3g}"
        )


@dataclass(frozen=True, eq=False)
class Problem:
    """Models, prior and data of one pass.

    processes, sensors: models by name; gates: probability of the chi-square gate by
    sensor, where one is asked for; losses: robust ones, likewise; window: of a
    fixed-lag smoother and for late data online, s, None for a number of epochs. Without
    epochs it is one to be driven online: they come later. Raises ModelError when a block is
    advanced by no process or by two, InputError when times do not increase or a sensor is unknown.
    """

    processes: Mapping[str, Dynamics]
    sensors: Mapping[str, Sensor]
    prior: Prior
    epochs: tuple[Epoch, ...]
    gates: Mapping[str, float] = field(default_factory=dict)
    window: float | None = None
    losses: Mapping[str, Loss] = field(default_factory=dict)
    layout: Layout = field(init=False)

    def __post_init__(self) -> None:
        for name in ("processes", "sensors", "gates", "losses"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for name in ("gates", "losses"):
            for sensor in getattr(self, name):
                if sensor not in self.sensors:
                    raise InputError(f"{name}: unknown sensor {sensor!r}")
        object.__setattr__(self, "epochs", tuple(self.epochs))
        object.__setattr__(self, "layout", layout_of(self.processes, self.sensors))
        n = self.layout.dim
        if self.prior.x.shape != (self.layout.size,) or self.prior.P.shape != (n, n):
            raise InputError(
                f"prior: found x {self.prior.x.shape} and P {self.prior.P.shape}, expected"
                f" ({self.layout.size},) and ({n}, {n}) for {self.layout}"
            )
        try:
            self.layout.pack(self.layout.values(self.prior.x))
        except InputError as error:
            raise InputError(f"prior: {error}") from error
        times = np.array([e.t for e in self.epochs])
        bad = ~np.isfinite(times) | np.concatenate(([False], np.diff(times) <= 0))
        if bad.any():
            k = int(np.nonzero(bad)[0][0])
            raise InputError(f"epoch {k}: found t = {times[k]} s, expected increasing times")
        for before, epoch in zip((None, *self.epochs), self.epochs, strict=False):
            t_before = None if before is None else before.t
            check_epoch(self.processes, self.sensors, epoch, t_before)

    @property
    def times(self) -> Array:
        """Times of the epochs (N,), s."""
        return np.array([e.t for e in self.epochs])


def layout_of(processes: Mapping[str, Dynamics], sensors: Mapping[str, Sensor]) -> Layout:
    """The blocks that the processes advance, in order.

    Raises ModelError unless each block read is advanced by exactly one process.
    """
    advanced: dict[str, str] = {}
    for name, process in processes.items():
        for block in process.advances:
            if block.name in advanced:
                raise ModelError(
                    f"block {block.name!r} is advanced by both {advanced[block.name]!r}"
                    f" and {name!r}"
                )
            advanced[block.name] = name
    everything = [(n, b) for n, p in processes.items() for b in p.advances + p.reads]
    everything += [(n, b) for n, s in sensors.items() for b in s.reads]
    for name, block in everything:
        if block.name not in advanced:
            raise ModelError(f"{name!r} reads block {block.name!r}, which no process advances")
    return Layout(block for _, block in everything)


def process_inputs(
    process: Dynamics, series: Mapping[str, InputSeries], t0: float, t1: float
) -> Array:
    """u (rows, 1 + channels) of a process over [t0, t1]; one row when it has no inputs.

    Raises InputError when an input is missing or does not cover the interval.
    """
    if not process.inputs:
        return np.array([[t1 - t0]])
    parts = []
    for name in process.inputs:
        if name not in series:
            raise InputError(f"{process.kind} needs the input {name!r}; given: {list(series)}")
        parts.append(series[name].over(t0, t1))
    edges = np.array([t0, t1])
    for part_edges, _ in parts:
        edges = np.union1d(edges, part_edges)
    # Edges closer than that are one edge, written with different rounding.
    edges = edges[np.concatenate(([True], np.diff(edges) > SAME_TIME))]
    edges[-1] = t1
    middle = 0.5 * (edges[1:] + edges[:-1])
    columns = [np.diff(edges)[:, None]]
    columns += [values[np.searchsorted(e, middle) - 1] for e, values in parts]
    return process.condense(np.ascontiguousarray(np.hstack(columns)))


def make_epochs(
    processes: Mapping[str, Dynamics],
    measurements: Sequence[Measurement],
    inputs: Mapping[str, InputSeries],
    times: Array | None = None,
) -> tuple[Epoch, ...]:
    """Epochs at the times of the measurements, or at `times`, which must contain them.

    Measurements within a microsecond are of one epoch. Raises InputError on measurements
    that fall between given times, and when inputs do not cover an interval.
    """
    ordered = sorted(measurements, key=lambda m: m.t)
    stamps = np.array([m.t for m in ordered]) if times is None else np.asarray(times)
    if times is None and len(stamps):
        stamps = stamps[np.concatenate(([True], np.diff(stamps) > SAME_TIME))]
    groups: list[list[Measurement]] = [[] for _ in stamps]
    for m in ordered:
        k = int(np.abs(stamps - m.t).argmin()) if len(stamps) < 2 else _nearest(stamps, m.t)
        if abs(stamps[k] - m.t) > SAME_TIME:
            raise InputError(f"sensor {m.sensor!r}: measurement at {m.t} s lies between epochs")
        groups[k].append(m)
    epochs = []
    for k, t in enumerate(stamps):
        u = {}
        if k:
            for name, process in processes.items():
                u[name] = process_inputs(process, inputs, float(stamps[k - 1]), float(t))
        epochs.append(Epoch(float(t), tuple(groups[k]), u))
    return tuple(epochs)


def _nearest(stamps: Array, t: float) -> int:
    k = int(np.clip(np.searchsorted(stamps, t), 1, len(stamps) - 1))
    return k if stamps[k] - t < t - stamps[k - 1] else k - 1
