"""Copies of blocks at an epoch, which measurements between any two epochs read.

A loop closure compares an epoch with an earlier one, its keyframe. It reads a static copy of what
stood in the state there; a sensor that measures nothing ties the copy to it, at the keyframe. So
the graph stays a chain with a border, whatever epochs are compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from relnav_graph.core.contracts import CopiesBlocks, ReadsCopies, Sensor
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.track import Truth, at_all_times
from relnav_graph.errors import InputError

__all__ = [
    "check_copied",
    "closure_name",
    "closure_of",
    "copied",
    "copiers",
    "uncopied",
    "with_copiers",
    "with_copies",
    "with_true_copies",
    "without_copies",
]


def closure_name(table: str, keyframe: float) -> str:
    """The name of the sensor of a keyframe, s, of those that one table of a scenario makes."""
    return f"{table}.{keyframe:.15g}"


def closure_of(name: str, sensor: Any) -> tuple[str, float] | None:
    """Table and keyframe, s, of a sensor that `closure_name` has named; None of any other."""
    if isinstance(sensor, ReadsCopies) and sensor.keyframe is not None:
        table = name.removesuffix(closure_name("", sensor.keyframe))
        if table != name:
            return table, sensor.keyframe
    return None


def with_copiers(sensors: Mapping[str, Sensor]) -> dict[str, Sensor]:
    """Sensors by name, with ``NAME.copy`` for each that reads copies: the one that makes them."""
    out = dict(sensors)
    for name, sensor in sensors.items():
        if isinstance(sensor, ReadsCopies) and sensor.keyframe is not None:
            out.setdefault(f"{name}.copy", sensor.copier())
    return out


def copiers(sensors: Mapping[str, Sensor]) -> dict[str, CopiesBlocks]:
    """Those of sensors, by name, that measure nothing but make copies."""
    keyed = {n: s for n, s in sensors.items() if getattr(s, "keyframe", None) is not None}
    return {n: s for n, s in keyed.items() if isinstance(s, CopiesBlocks)}


def with_copies(epoch: Epoch, makers: Mapping[str, CopiesBlocks], merge: float) -> Epoch:
    """An epoch, with the copies that are to be made within `merge`, s, of it.

    makers: the `copiers` of a problem's sensors.
    """
    there = {m.sensor for m in epoch.measurements}
    made = [
        Measurement(name, epoch.t, np.zeros((1, copier.rows)), np.zeros(1, np.int64))
        for name, copier in makers.items()
        if abs(copier.keyframe - epoch.t) <= merge and name not in there
    ]
    return replace(epoch, measurements=(*epoch.measurements, *made)) if made else epoch


def copied(
    epochs: Sequence[Epoch], sensors: Mapping[str, Sensor], merge: float
) -> tuple[Epoch, ...]:
    """Epochs with all copies of their span made.

    Raises InputError on a keyframe between the first and the last epoch that is not one of them.
    """
    makers = copiers(sensors)
    if not makers or not epochs:
        return tuple(epochs)
    out = tuple(with_copies(e, makers, merge) for e in epochs)
    made = {m.sensor for e in out for m in e.measurements}
    for name, sensor in makers.items():
        if name not in made and out[0].t - merge <= sensor.keyframe <= out[-1].t + merge:
            times = np.array([e.t for e in out])
            near = times[np.abs(times - sensor.keyframe).argmin()]
            raise InputError(
                f"sensor {name!r}: found a keyframe at {sensor.keyframe} s, where there is no"
                f" epoch; the nearest is at {near} s"
            )
    return out


def with_true_copies(truth: Truth, sensors: Mapping[str, Sensor]) -> Truth:
    """A truth with what the copies that sensors read are of, as far as it is known: at all of its
    times the value at the keyframe."""
    values = dict(truth.values)
    for sensor in sensors.values():
        if not isinstance(sensor, ReadsCopies) or sensor.keyframe is None:
            continue
        rows, there = truth.at(np.array([sensor.keyframe]))
        copier = sensor.copier()
        for name, block in copier.copies.items() if isinstance(copier, CopiesBlocks) else ():
            if there[0] and block.name in truth.values:
                values[name] = at_all_times(truth.values[block.name][rows[0]], len(truth.t))
    return replace(truth, values=values)


def without_copies(epoch: Epoch, sensors: Mapping[str, Sensor]) -> Epoch:
    """What was measured at an epoch."""
    makers = copiers(sensors)
    kept = [m for m in epoch.measurements if m.sensor not in makers]
    return replace(epoch, measurements=tuple(kept))


def uncopied(
    measurements: Iterable[Measurement], sensors: Mapping[str, Sensor], used: Mapping[str, int]
) -> list[tuple[Measurement, str]]:
    """Those of measurements that are closures to an epoch that was not copied, and why.

    used: how many observations of each sensor were used.
    """
    makers = copiers(sensors)
    if not makers:
        return []
    made = {s.keyframe for name, s in makers.items() if used.get(name, 0)}
    found = list[tuple[Measurement, str]]()
    for m in measurements:
        sensor: Any = sensors[m.sensor]
        if not isinstance(sensor, ReadsCopies) or sensor.keyframe in (None, *made):
            continue
        reason = f"closure: no epoch was there to be copied at {sensor.keyframe} s"
        found.append((m, reason))
    return found


def check_copied(
    measurements: Iterable[Measurement], sensors: Mapping[str, Sensor], used: Mapping[str, int]
) -> None:
    """Raise InputError on a closure to an epoch that was not copied; used: see `uncopied`."""
    for m, reason in uncopied(measurements, sensors, used):
        raise InputError(f"sensor {m.sensor!r} at t = {m.t} s: {reason}")
