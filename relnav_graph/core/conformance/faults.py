"""What is wrong with a model: which check, where, and in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.numeric import Wrong, components
from relnav_graph.core.problem import check_covariance
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError

__all__ = ["Fault", "badly_filled", "covariance_fault", "say_wrong"]

#: What outputs hold before a second call: no number that a kernel would write.
GARBAGE = -7.21875e3


@dataclass(frozen=True)
class Fault:
    """A check that failed: its name, the regime, where (an output, a method), and what it found."""

    check: str
    regime: str
    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.check}, {self.regime}: {self.where}: {self.text}"


#: Of each output, names for its axes: rows, or blocks, whose components are meant.
Axes = Mapping[str, tuple[Sequence[Any], ...]]


def _place(axes: Axes, name: str, at: Sequence[int]) -> str:
    """An entry of an output in words."""
    said = []
    for axis, index in zip(axes[name], at, strict=True):
        named = isinstance(axis[0], Block) if len(axis) else False
        said.append(components(axis)[index] if named else str(axis[index]))
    return f"{name}[{', '.join(map(str, at))}]: {', '.join(said)}"


def badly_filled(call: Callable[[float], tuple[int, Any]], regime: str, axes: Axes) -> list[Fault]:
    """Where outputs are not filled, overrun, or not the same from call to call.

    call: the kernel, with outputs that hold a number before; its status, and they. axes: see
    `Axes`. A status that is not zero says that the observation is impossible: nothing is asked.
    """
    status, first = call(float("nan"))
    faults = [Fault("outputs", regime, n, "the kernel wrote past it") for n in first.overrun]
    if status:
        return faults
    left = [_place(axes, name, at) for name, at in first.unfilled]
    faults += [Fault("outputs", regime, place, "unfilled, or not finite") for place in left]
    again, second = call(GARBAGE)
    if faults or again:
        return faults
    for name, a, b in zip(first.shapes, first.arrays, second.arrays, strict=True):
        for at in np.argwhere(a != b).tolist()[:1]:
            text = "another value when the outputs hold other numbers before, or from call to call"
            faults.append(Fault("outputs", regime, _place(axes, name, at), text))
    return faults


def say_wrong(
    name: str,
    regime: str,
    wrong: Sequence[Wrong],
    rows: Sequence[str],
    blocks: Sequence[Block],
    scale: Array | None = None,
) -> list[Fault]:
    """Wrong entries of a Jacobian in words; rows repeat for each observation. scale (m,): by which
    they were divided."""
    named, found = components(blocks), list[Fault]()
    for entry in wrong:
        size = 1.0 if scale is None else float(scale[entry.row])
        i = entry.row % len(rows)
        hint = f" ({entry.looks})" if entry.looks else ""
        text = f"found {size * entry.found:.6g}, differences say {size * entry.numeric:.6g}{hint}"
        where = f"{name}[{i}, {entry.column}]: {rows[i]}, {named[entry.column]}"
        found.append(Fault("jacobian", regime, where, text))
    return found


def covariance_fault(where: str, regime: str, P: Array) -> Fault | None:
    """What keeps P (n, n) from being a covariance, if anything does."""
    try:
        check_covariance(where, P)
    except InputError as error:
        return Fault("noise", regime, where, str(error))
    return None
