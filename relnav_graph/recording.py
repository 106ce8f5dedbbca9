"""`Recording`: the data of one pass, simulated or real, before it becomes a `Problem`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from relnav_graph.arrays import Array
from relnav_graph.models import Measurement
from relnav_graph.problem import InputSeries
from relnav_graph.track import Truth

__all__ = ["Recording"]


@dataclass(frozen=True, eq=False)
class Recording:
    """Measurements, inputs and, where known, truth.

    times: epochs to estimate at, s (N,); every measurement falls on one of them.
    settings: values that the data bring for the scenario (camera constants, points), as
    nested tables; a value written in the scenario wins over them.
    """

    times: Array
    measurements: tuple[Measurement, ...]
    inputs: Mapping[str, InputSeries] = field(default_factory=dict)
    truth: Truth | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
