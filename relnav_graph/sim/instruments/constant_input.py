"""An input that is known exactly and does not change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import InputSeries
from relnav_graph.units import Quantity, check_fields

__all__ = [
    "ConstantInput",
]


@dataclass(frozen=True)
class ConstantInput:
    """An input that is known and constant; values: SI."""

    kind: ClassVar[str] = "constant_input"

    values: Annotated[Array, Quantity("1", (None,))]

    def __post_init__(self) -> None:
        check_fields(self)

    def series(self, name: str, t_first: float, t_last: float) -> InputSeries:
        """One sample from t_first to t_last, s."""
        return InputSeries(name, np.array([t_first]), np.array([t_last]), self.values[None])
