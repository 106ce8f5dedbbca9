"""Numbered blocks: static ones that observations read by their id, such as the points of a map."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from relnav_graph.core.contracts import ReadsNumbered, Sensor
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError

__all__ = [
    "families",
    "first_seen",
    "members",
    "number_in",
    "numbered_of",
    "times_seen",
    "unnumbered",
]

_NUMBERED = re.compile(r"(.+)\[(\d+)\]")


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
    """The numbered blocks that measurements are of, in order of first sight. Raises InputError,
    naming sensor and time, on an id below zero."""
    out: dict[Block, None] = {}
    own = {name: numbered_of(sensor) for name, sensor in sensors.items()}
    for m in measurements:
        block = own.get(m.sensor)
        if block is not None:
            if (m.ids < 0).any():
                found = f"found id {m.ids.min()}, expected zero or more"
                raise InputError(f"sensor {m.sensor!r} at t = {m.t} s: {found}")
            out.update(dict.fromkeys(block.numbered(int(i)) for i in m.ids))
    return tuple(out)


def times_seen(
    sensors: Mapping[str, Sensor], measurements: Iterable[Measurement]
) -> dict[str, int]:
    """How many observations there are of each numbered block, by its name."""
    found: Counter[str] = Counter()
    own = {name: numbered_of(sensor) for name, sensor in sensors.items()}
    for m in measurements:
        block = own.get(m.sensor)
        if block is not None:
            found.update(block.numbered(int(i)).name for i in m.ids)
    return dict(found)


def unnumbered(block: Block) -> Block:
    """The block without a number of which :meth:`Block.numbered` made this one."""
    if block.number is None:
        return block
    symbol = block.symbol.removesuffix(f"_{block.number}")
    return replace(block, name=block.family, symbol=symbol, number=None)


def members(blocks: Iterable[Block]) -> dict[str, tuple[Block, ...]]:
    """The numbered ones of some blocks, by their family, in order."""
    out: dict[str, tuple[Block, ...]] = {}
    for block in blocks:
        if block.number is not None:
            out[block.family] = (*out.get(block.family, ()), block)
    return out


def number_in(name: str) -> tuple[str, int | None]:
    """Family and number in the name of a numbered block; the name and None of another one."""
    found = _NUMBERED.fullmatch(name)
    return (name, None) if found is None else (found[1], int(found[2]))
