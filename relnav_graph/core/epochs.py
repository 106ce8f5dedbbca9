"""Epochs: a time, what was measured then, and the inputs since the epoch before."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics, ReadsCopies, ReadsTime, Sensor
from relnav_graph.core.measurement import SAME_TIME, InputSeries, Measurement, edge_tolerance
from relnav_graph.core.models import check_inputs
from relnav_graph.errors import InputError

__all__ = [
    "Epoch",
    "make_epochs",
]


@dataclass(frozen=True, eq=False)
class Epoch:
    """A time, what was measured then, and the inputs since the epoch before.

    t: s; inputs: for each process by name, u (rows, 1 + channels): one row per sub-interval,
    its length in s, then the mean of each input over it, SI. Where a gap in an input was bridged
    or its stamps jitter, u (rows, 1 + 2 channels): then the spread of each, one sigma, SI.
    bridged: how long each input was, of those that were, s, by name.
    """

    t: float
    measurements: tuple[Measurement, ...] = ()
    inputs: Mapping[str, Array] = field(default_factory=dict)
    bridged: Mapping[str, float] = field(default_factory=dict)

    def of(self, processes: Container[str]) -> Epoch:
        """The same with the inputs of some processes only, by name."""
        return replace(self, inputs={n: u for n, u in self.inputs.items() if n in processes})


#: Longest interval, s: whoever asks for more means something else.
LONGEST = 1e6


def unit_hint(length: float) -> str:
    """What stamps `length` s apart may be in, if not in seconds: the finest unit that makes a
    tenth of a second or more of it; "" where it is no more than that in any."""
    for unit, scale in (("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3)):
        if length * scale >= 0.1:
            return f": are the stamps in {unit}?"
    return ""


def _check_length(where: str, length: float) -> None:
    """Raise InputError on an interval that no model can mean."""
    if length > LONGEST:
        raise InputError(
            f"{where}: found an interval of {length:.6g} s, expected at most {LONGEST:g} s"
            + unit_hint(length)
        )


def _check_closure(m: Measurement, sensor: Sensor) -> None:
    """Raise InputError on a loop closure to an epoch that is not an earlier one."""
    if getattr(sensor, "keyframe", None) is None or not isinstance(sensor, ReadsCopies):
        return
    if m.t <= float(sensor.keyframe or 0.0) + SAME_TIME:
        raise InputError(
            f"sensor {m.sensor!r}: found a measurement at t = {m.t} s, expected one after its"
            f" keyframe, {sensor.keyframe} s: a closure is to an earlier epoch"
        )


def check_epoch(
    processes: Mapping[str, Dynamics],
    sensors: Mapping[str, Sensor],
    epoch: Epoch,
    t_before: float | None,
) -> None:
    """Check an epoch and, unless t_before is None, the interval that leads to it.

    Raises InputError when a sensor is unknown, a measurement is of another time or width or a
    closure to a later epoch, or a process lacks inputs, has some of another form, or of another
    length of time, or is to go on for longer than any model can mean.
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
        _check_closure(m, sensors[m.sensor])
    for name, process in processes.items() if t_before is not None else ():
        where = f"process {name!r} ({process.kind}) from {t_before} s to {epoch.t} s"
        _check_length(where, epoch.t - float(t_before or 0.0))
        if name not in epoch.inputs:
            raise InputError(f"{where}: found no inputs for it in the epoch")
        u = check_inputs(where, process, epoch.inputs[name], spreads=True)
        length, expected = float(u[:, 0].sum()), epoch.t - float(t_before or 0.0)
        if abs(length - expected) > SAME_TIME:
            raise InputError(f"{where}: found inputs over {length} s, expected {expected} s")


def observation_data(name: str, sensor: Sensor, measurements: Sequence[Measurement]) -> Array:
    """What a sensor's kernel needs to know of each of its observations (k, nq), one after the
    other. Raises InputError, naming the time, on an id that the sensor does not know."""
    if isinstance(sensor, ReadsTime) and sensor.reads_time:
        return np.concatenate([sensor.at(m.t).observation_data(m.ids) for m in measurements])
    try:
        return sensor.observation_data(np.concatenate([m.ids for m in measurements]))
    except InputError:
        for m in measurements:
            try:
                sensor.observation_data(m.ids)
            except InputError as error:
                raise InputError(f"sensor {name!r} at t = {m.t} s: {error}") from error
        raise


def process_inputs(
    process: Dynamics, series: Mapping[str, InputSeries], t0: float, t1: float
) -> Array:
    """u (rows, 1 + channels) of a process over [t0, t1], s; one row when it has no inputs.

    Each row: length of the sub-interval, s, then the mean of each input over it, SI; and the
    spread of each where a gap was bridged or stamps jitter, see `Epoch`.

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
    edges = edges[np.concatenate(([True], np.diff(edges) > edge_tolerance(t0, t1)))]
    edges[-1] = t1
    middle = 0.5 * (edges[1:] + edges[:-1])
    columns = [np.diff(edges)[:, None]]
    columns += [values[np.searchsorted(e, middle) - 1] for e, values in parts]
    u = np.ascontiguousarray(np.hstack(columns))
    spreads: Array = np.hstack([series[name].spreads(edges) for name in process.inputs])
    return _condensed(process, u, spreads) if spreads.any() else process.condense(u)


def channels(process: Dynamics) -> dict[str, slice]:
    """Where each input of a process stands among the columns of u, see `process_inputs`."""
    found, first = dict[str, slice](), 1
    for name, columns in process.inputs.items():
        found[name] = slice(first, first + len(columns))
        first += len(columns)
    return found


def _condensed(process: Dynamics, u: Array, spreads: Array) -> Array:
    """u (rows, 1 + 2 channels): of each run of rows the process may make fewer, but not of those
    whose inputs are held."""
    held = spreads.max(axis=1) > 0
    starts = np.nonzero(held[:-1] | held[1:])[0] + 1
    parts = []
    for own, sigma in zip(np.split(u, starts), np.split(spreads, starts), strict=True):
        few = own if sigma.any() else process.condense(np.ascontiguousarray(own))
        parts.append(
            np.hstack([few, sigma if sigma.any() else np.zeros((len(few), u.shape[1] - 1))])
        )
    return np.concatenate(parts)


def bridged(
    process: Dynamics, series: Mapping[str, InputSeries], t0: float, t1: float
) -> dict[str, float]:
    """How long each input of a process is bridged in [t0, t1], s, by name."""
    gaps = {name: series[name].gaps(t0, t1) for name in process.inputs}
    return {name: sum(b - a for a, b in parts) for name, parts in gaps.items() if parts}


#: An input whose samples and whole length are so many times, at least, and so many times, between,
#: those of the epochs (or the other way round) has stamps in another unit.
COARSER, LONGER = 5.0, (300.0, 3000.0)


def _check_stamps(times: Array, series: InputSeries) -> None:
    """Raise InputError where epochs at times (N,), s, and samples of an input look as if stamps of
    one of them were in ms: not where an input would then be of another time, so that the epochs
    are a part of what it tells."""
    if len(times) < 2 or not len(series.t_start):
        return
    first, last = float(series.t_start[0]), float(series.t_end[-1])
    if first <= times[0] and times[-1] <= last < 1000 * times[0]:
        return
    step, apart = float(np.median(series.t_end - series.t_start)), float(np.median(np.diff(times)))
    whole, over = last - first, float(times[-1] - times[0])
    ms = {
        "the stamps of the input": (step / apart, whole / over),
        "those of the measurements": (apart / step, over / whole),
    }
    for which, (coarser, longer) in ms.items():
        if coarser > COARSER and LONGER[0] < longer < LONGER[1]:
            raise InputError(
                f"input {series.name!r}: found samples {step:.6g} s apart over {whole:.6g} s, and"
                f" epochs {apart:.6g} s apart over {over:.6g} s: are {which} in ms? If not, leave"
                " out what is not of this pass"
            )


def make_epochs(
    processes: Mapping[str, Dynamics],
    measurements: Sequence[Measurement],
    inputs: Mapping[str, InputSeries],
    times: Array | None = None,
    merge: float = SAME_TIME,
) -> tuple[Epoch, ...]:
    """Epochs at the times of the measurements, or at `times` (N,), s, which must contain them.

    What is within `merge`, s, is one epoch, see `epoch_times`; 0: only equal stamps are. Raises
    InputError on measurements that fall between given times, when inputs do not cover an interval,
    and where stamps of an input are a thousand times those of the epochs, or these those.
    """
    ordered = sorted(measurements, key=lambda m: m.t)
    stamps = np.array([m.t for m in ordered]) if times is None else np.asarray(times)
    stamps = epoch_times(stamps, merge)
    groups: list[list[Measurement]] = [[] for _ in stamps]
    for m in ordered:
        k = int(np.searchsorted(stamps, m.t - merge))
        if k == len(stamps) or stamps[k] > m.t + merge:
            raise InputError(f"sensor {m.sensor!r}: measurement at {m.t} s lies between epochs")
        groups[k].append(stamped(m, float(stamps[k])))
    for name in sorted({n for p in processes.values() for n in p.inputs} & inputs.keys()):
        _check_stamps(stamps, inputs[name])
    epochs = []
    for k, t in enumerate(stamps):
        u, held = {}, dict[str, float]()
        if k:
            between = float(stamps[k - 1]), float(t)
            for name, process in processes.items():
                u[name] = process_inputs(process, inputs, *between)
                if u[name].shape[1] > 1 + sum(map(len, process.inputs.values())):  # with spreads
                    held |= bridged(process, inputs, *between)
        epochs.append(Epoch(float(t), tuple(groups[k]), u, held))
    return tuple(epochs)


def epoch_times(stamps: Array, merge: float = SAME_TIME) -> Array:
    """Times of the epochs (M,), s, of stamps (N,), s, in order: those within `merge`, s, of the
    first of an epoch are of that epoch."""
    chains = np.flatnonzero(np.diff(stamps, prepend=-np.inf) > merge)
    ends = np.append(chains[1:], len(stamps)) - 1
    kept = []
    for first, last in zip(chains.tolist(), ends.tolist(), strict=False):
        while stamps[last] - stamps[first] > merge:  # a chain may reach further than one link
            kept.append(first)
            first += int(np.searchsorted(stamps[first:], stamps[first] + merge, side="right"))
        kept.append(first)
    return stamps[np.array(kept, dtype=np.int64)]


def stamped(m: Measurement, t: float) -> Measurement:
    """A measurement as one of the epoch at t, s: with its time, unless that is the same."""
    return m if abs(m.t - t) <= SAME_TIME else replace(m, t=t)
