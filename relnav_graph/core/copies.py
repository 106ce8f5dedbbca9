"""Copies of blocks at an epoch, which measurements between any two epochs read.

A loop closure compares an epoch with an earlier one, its keyframe. It reads a static copy of what
stood in the state there; a sensor that measures nothing ties the copy to it, at the keyframe. So
the graph stays a chain with a border, whatever epochs are compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from relnav_graph.core.contracts import CopiesBlocks, ReadsCopies, Sensor
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError

__all__ = ["closure_name", "closure_of", "copied", "with_copiers", "with_copies"]


def closure_name(table: str, keyframe: float) -> str:
    """The name of the sensor of a keyframe, s, of those that one table of a scenario makes."""
    return f"{table}.{keyframe:.15g}"


def closure_of(name: str, sensor: Sensor) -> tuple[str, float] | None:
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


def with_copies(epoch: Epoch, sensors: Mapping[str, Sensor], merge: float) -> Epoch:
    """An epoch, with the copies that are to be made within `merge`, s, of it."""
    there = {m.sensor for m in epoch.measurements}
    made = [
        Measurement(name, epoch.t, np.zeros((1, sensor.rows)), np.zeros(1, np.int64))
        for name, sensor in sensors.items()
        if isinstance(sensor, CopiesBlocks)
        and abs(sensor.keyframe - epoch.t) <= merge
        and name not in there
    ]
    return replace(epoch, measurements=(*epoch.measurements, *made)) if made else epoch


def copied(
    epochs: Sequence[Epoch], sensors: Mapping[str, Sensor], merge: float
) -> tuple[Epoch, ...]:
    """Epochs with all copies of their span made.

    Raises InputError on a keyframe between the first and the last epoch that is not one of them.
    """
    out = tuple(with_copies(e, sensors, merge) for e in epochs)
    made = {m.sensor for e in out for m in e.measurements}
    for name, sensor in sensors.items():
        if isinstance(sensor, CopiesBlocks) and name not in made and out:
            if out[0].t - merge <= sensor.keyframe <= out[-1].t + merge:
                times = np.array([e.t for e in out])
                near = times[np.abs(times - sensor.keyframe).argmin()]
                raise InputError(
                    f"sensor {name!r}: found a keyframe at {sensor.keyframe} s, where there is no"
                    f" epoch; the nearest is at {near} s"
                )
    return out


def check_closure(name: str, sensor: Sensor, t: float, merge: float) -> None:
    """Raise InputError on a measurement at t, s, that a sensor of copies cannot give: a copy of
    another epoch than its own, or a closure to an epoch that is not an earlier one."""
    if isinstance(sensor, CopiesBlocks):
        if abs(t - sensor.keyframe) > merge:
            raise InputError(
                f"sensor {name!r}: found a copy at {t} s, expected one at its keyframe,"
                f" {sensor.keyframe} s"
            )
    elif isinstance(sensor, ReadsCopies) and sensor.keyframe is not None:
        if not t > sensor.keyframe + merge:
            raise InputError(
                f"sensor {name!r}: found a measurement at {t} s, expected one after its keyframe,"
                f" {sensor.keyframe} s: a closure is to an earlier epoch"
            )
