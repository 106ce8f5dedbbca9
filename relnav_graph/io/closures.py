"""Tables of loop closures: the sensors of all keyframes in one, each row with both times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.core.contracts import CopiesBlocks, ReadsCopies, Sensor
from relnav_graph.core.copies import closure_of
from relnav_graph.core.epochs import epoch_times
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.models import ENTRY_POINTS
from relnav_graph.files import is_name
from relnav_graph.io.tabular import Table, read_table
from relnav_graph.registry import classes, provides
from relnav_graph.units import parse_quantity

__all__ = ["by_keyframe", "earlier_times", "grouped", "keyframes_in", "of_closures"]


def grouped(sensors: Mapping[str, Sensor]) -> dict[str, dict[str, Sensor]]:
    """The sensors of each table, by its name: those that close loops to the keyframes of one table
    share it. Those that measure nothing have none."""
    out: dict[str, dict[str, Sensor]] = {}
    for name, sensor in sensors.items():
        if not isinstance(sensor, CopiesBlocks):
            closure = closure_of(name, sensor)
            out.setdefault(name if closure is None else closure[0], {})[name] = sensor
    return out


def of_closures(sensors: Mapping[str, Sensor]) -> bool:
    """Whether the sensors of a table close loops."""
    return any(closure_of(name, sensor) is not None for name, sensor in sensors.items())


def by_keyframe(table: Table, sensors: Mapping[str, Sensor]) -> dict[str, Table]:
    """The rows of each sensor in a table of closures, as a table without ``t_from_s``.

    Raises InputError, naming file, line and column, on a closure to an epoch that is no keyframe,
    or not an earlier one.
    """
    table.require(("t_s", "t_from_s"), tuple(table.columns))
    found, keyframes = dict[str, Table](), []
    t_from, left = table["t_from_s"], np.ones(len(table.lines), np.bool_)
    for name, sensor in sensors.items():
        closure = closure_of(name, sensor)
        keyframe = np.nan if closure is None else closure[1]
        keyframes.append(f"{keyframe + table.origin:.15g}")
        own = np.abs(t_from - keyframe) <= SAME_TIME
        left &= ~own
        columns = {key: column[own] for key, column in table.columns.items()}
        part = replace(table, columns=columns, lines=table.lines[own])
        later = part["t_s"] > part["t_from_s"] + SAME_TIME
        part.refuse(~later, "t_from_s", "a time before t_s")
        del columns["t_from_s"]
        found[name] = part
    table.refuse(left, "t_from_s", f"the time of a keyframe, one of {', '.join(keyframes)}")
    return found


def earlier_times(
    measurements: Sequence[Measurement], sensors: Mapping[str, Sensor]
) -> dict[str, NDArray[Any]]:
    """The column ``t_from_s`` (rows,), s, of closures; nothing of other measurements."""
    if not of_closures(sensors):
        return {}
    found = [closure_of(m.sensor, sensors[m.sensor]) for m in measurements]
    counts = [len(m.z) for m in measurements]
    return {"t_from_s": np.repeat([(c or ("", np.nan))[1] for c in found], counts)}


def keyframes_in(folder: Path, scenario: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Settings by sensor: the keyframes, s, that tables of closures name and the scenario does not.

    Raises InputError on a table that cannot be read, or an origin that is no time.
    """
    out: dict[str, dict[str, Any]] = {}
    tables, time = scenario.get("sensors"), scenario.get("time")
    known = classes(ENTRY_POINTS)  # a kind in a module is somebody's code: not before it is trusted
    for name, own in tables.items() if isinstance(tables, Mapping) else ():
        if not isinstance(own, Mapping) or "keyframes" in own or not is_name(name):
            continue
        cls = known.get(str(own.get("kind")))
        if cls is None or not provides(cls, ReadsCopies):
            continue
        table = read_table(folder, name)
        if table is not None and "t_from_s" in table.columns:
            origin = time.get("origin", 0.0) if isinstance(time, Mapping) else 0.0
            # Stamps of one epoch may differ in their last digits: they are one keyframe.
            keyframes = epoch_times(np.unique(table["t_from_s"]) - parse_quantity(origin, "s"))
            out[name] = {"keyframes": keyframes.tolist()}
    return out
