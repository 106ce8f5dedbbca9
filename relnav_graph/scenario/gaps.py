"""Gaps in the inputs: what a scenario says of them, or what holds where it says nothing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from relnav_graph.core.contracts import Dynamics
from relnav_graph.core.measurement import Bridge
from relnav_graph.errors import InputError
from relnav_graph.scenario.schema import Problems, ScenarioFile
from relnav_graph.scenario.settings import GapSettings
from relnav_graph.units import Quantity, column_unit, parse_quantity

__all__ = ["bridge_of", "check_stamps", "make_bridges"]

#: How far an input may have gone from its last mean, where the scenario does not say: of a craft
#: that turns steadily and coasts.
SPREADS = {"rad/s": "0.1 deg/s", "m/s^2": "0.01 m/s^2", "m/s": "0.1 m/s"}


def bridge_of(columns: tuple[str, ...], own: GapSettings) -> Bridge | None:
    """How one input is bridged; None where nobody says how far it may go.

    Raises InputError on a spread in another unit, or below zero.
    """
    units = [column_unit(c) or "1" for c in columns]
    if own.spread is None:
        if not all(unit in SPREADS for unit in units):
            return None
        return Bridge(own.bridge, np.array([parse_quantity(SPREADS[u], u) for u in units]))
    given = own.spread if isinstance(own.spread, list) else [own.spread] * len(units)
    if len(given) != len(units):
        raise InputError(f"found {len(given)} numbers, expected one, or one for each of {columns}")
    spread = [Quantity(u, nonnegative=True).parse(v) for v, u in zip(given, units, strict=True)]
    return Bridge(own.bridge, np.array(spread))


def make_bridges(
    file: ScenarioFile, processes: Mapping[str, Dynamics], problems: Problems
) -> dict[str, Bridge]:
    """How each input of the processes is bridged; what is wrong goes into `problems`."""
    inputs = {name: c for p in processes.values() for name, c in p.inputs.items()}
    for name in file.gaps:
        if name not in inputs:
            known = ", ".join(inputs) or "none"
            problems.append((f"gaps.{name}", f"unknown input; those of the processes: {known}"))
    found = {}
    for name, columns in inputs.items():
        try:
            bridge = bridge_of(columns, file.gaps.get(name, GapSettings()))
        except InputError as error:
            problems.append((f"gaps.{name}.spread", str(error)))
            continue
        if bridge is not None:
            found[name] = bridge
    return found


def check_stamps(file: ScenarioFile, processes: Mapping[str, Dynamics], problems: Problems) -> None:
    """Note in `problems` each of [stamps] that is of no input and no sensor, or jitters and is of
    a sensor."""
    inputs = {name for p in processes.values() for name in p.inputs}
    for name, own in file.stamps.items():
        if name not in inputs and name not in file.sensors:
            known = ", ".join([*inputs, *file.sensors])
            problems.append((f"stamps.{name}", f"neither input nor sensor; there are: {known}"))
        elif name not in inputs and own.jitter:
            known = ", ".join(inputs) or "none"
            message = f"found that of a sensor, expected that of an input; there are: {known}"
            problems.append((f"stamps.{name}.jitter", message))
