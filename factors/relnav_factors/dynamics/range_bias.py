"""Biases of measured distances and of their rates, first-order Gauss-Markov processes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from relnav_factors.shared.gauss_markov import GaussMarkov
from relnav_graph.core.catalogue import (
    RANGE_BIAS,
    RANGE_DRIFT,
    RANGE_RATE_BIAS,
    RANGE_RATE_DRIFT,
)
from relnav_graph.core.state import Block
from relnav_graph.units import Quantity


@dataclass(frozen=True, kw_only=True)
class RangeBias(GaussMarkov):
    """b' = -b / T + white, of a measured distance, or of what wanders about its constant bias.

    sigma: m, standard deviation in the long run; time_constant: T, s; part: see `GaussMarkov`.
    """

    kind: ClassVar[str] = "range_bias"

    sigma: Annotated[float, Quantity("m", positive=True)]

    @property
    def advances(self) -> tuple[Block, ...]:
        return (RANGE_BIAS if self.part == "bias" else RANGE_DRIFT,)


@dataclass(frozen=True, kw_only=True)
class RangeRateBias(GaussMarkov):
    """b' = -b / T + white, of a measured range rate, or of what wanders about its constant bias.

    sigma: m/s, standard deviation in the long run; time_constant: T, s; part: see `GaussMarkov`.
    """

    kind: ClassVar[str] = "range_rate_bias"

    sigma: Annotated[float, Quantity("m/s", positive=True)]

    @property
    def advances(self) -> tuple[Block, ...]:
        return (RANGE_RATE_BIAS if self.part == "bias" else RANGE_RATE_DRIFT,)
