"""What a scenario says of its scores: how good the truth is itself, and what is compared how."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from relnav_graph.arrays import Array
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.scored import InAxes, Scored
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity

__all__ = ["ScoreSettings", "make_scored", "make_truth_noise"]

Problems = list[tuple[str, str]]


class ScoreSettings(BaseModel):
    """How tracks are compared with the truth. axes: by vector of the state, a frame in whose axes
    it is compared instead of in its own, which the estimate may know badly; its covariance is taken
    jointly with that of the attitudes that lead there. without: blocks that a second joint ANEES,
    `anees_without`, leaves out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    axes: dict[str, str] = {}
    without: list[str] = []


def _blocks(layout: Layout, numbered: Mapping[str, Block]) -> dict[str, Block]:
    return {b.name: b for b in layout if b.number is None} | dict(numbered)


def _unknown(path: str, name: str, known: Iterable[str]) -> tuple[str, str]:
    return path, f"found {name!r}, expected one of {', '.join(known)}"


def make_scored(
    settings: ScoreSettings, layout: Layout, numbered: Mapping[str, Block], problems: Problems
) -> Scored:
    """The settings, checked against the state and its families of numbered blocks; what is wrong
    goes into `problems`."""
    known, seen = _blocks(layout, numbered), list[InAxes]()
    for name, frame in settings.axes.items():
        if name not in layout:
            problems.append(_unknown("score.axes", name, [b.name for b in layout]))
            continue
        try:
            seen.append(InAxes.of(layout.block(name), frame, layout))
        except InputError as error:
            problems.append((f"score.axes.{name}", str(error)))
    for i, name in enumerate(settings.without):
        if name not in known:
            problems.append(_unknown(f"score.without[{i}]", name, known))
    return Scored(tuple(seen), tuple(dict.fromkeys(settings.without)))


def make_truth_noise(
    table: Mapping[str, Any], layout: Layout, numbered: Mapping[str, Block], problems: Problems
) -> dict[str, Array]:
    """Sigmas (dim,), SI, by block, family of numbered blocks or derived quantity; what is wrong
    goes into `problems`."""
    known = _blocks(layout, numbered) | {q.block.name: q.block for q in derived_quantities(layout)}
    found = {}
    for name, value in table.items():
        if name not in known:
            problems.append(_unknown("truth_noise", name, known))
            continue
        block = known[name]
        try:
            sigma = Quantity(block.unit, (block.dim,), nonnegative=True, fill=True).parse(value)
            if not (sigma < np.sqrt(np.finfo(np.float64).max)).all():  # nor would be its square
                raise InputError(f"found {sigma.max():g} {block.unit}, expected one below 1e154")
            found[name] = np.asarray(sigma)
        except InputError as error:
            problems.append((f"truth_noise.{name}", str(error)))
    return found
