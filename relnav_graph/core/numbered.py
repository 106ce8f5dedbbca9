"""Numbered blocks: static ones that observations read by their id, such as the points of a map."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from relnav_graph.core.contracts import ReadsNumbered, Sensor
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Block

__all__ = ["families", "first_seen", "numbered_of"]


def numbered_of(sensor: Any) -> Block | None:
    """The block that each observation of a sensor reads by its id, without a number; else None."""
    return sensor.numbered if isinstance(sensor, ReadsNumbered) else None


def families(sensors: Mapping[str, Sensor]) -> dict[str, Block]:
    """The numbered blocks, without a number, that sensors read, by name."""
    found = (numbered_of(sensor) for sensor in sensors.values())
    return {block.name: block for block in found if block is not None}


def first_seen(
    sensors: Mapping[str, Sensor], measurements: Iterable[Measurement]
) -> tuple[Block, ...]:
    """The numbered blocks that measurements are of, in order of first sight."""
    out: dict[Block, None] = {}
    own = {name: numbered_of(sensor) for name, sensor in sensors.items()}
    for m in measurements:
        block = own.get(m.sensor)
        if block is not None:
            out.update(dict.fromkeys(block.numbered(int(i)) for i in m.ids))
    return tuple(out)
