"""Bias of an accelerometer on the chaser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from relnav_factors.shared.gauss_markov import GaussMarkov
from relnav_graph.core.catalogue import (
    ABSOLUTE_ACCELEROMETER_BIAS,
    ABSOLUTE_ACCELEROMETER_DRIFT,
    ACCELEROMETER_BIAS,
    ACCELEROMETER_DRIFT,
)
from relnav_graph.core.state import Block
from relnav_graph.units import Quantity

#: Whose estimate of the bias: that of the relative motion, or of the chaser's own orbit.
Navigation = Literal["relative", "absolute"]


def bias_block(navigation: Navigation) -> Block:
    """The block that holds the bias."""
    return ACCELEROMETER_BIAS if navigation == "relative" else ABSOLUTE_ACCELEROMETER_BIAS


def drift_block(navigation: Navigation) -> Block:
    """The block that holds what drifts about a constant bias."""
    return ACCELEROMETER_DRIFT if navigation == "relative" else ABSOLUTE_ACCELEROMETER_DRIFT


@dataclass(frozen=True, kw_only=True)
class AccelerometerBias(GaussMarkov):
    """b' = -b / T + white, in axes of c, of the bias or of its drift about a constant.

    sigma: m/s^2, standard deviation of each axis in the long run; time_constant: T, s;
    navigation: which of two estimates of the one bias this is, "relative" or "absolute"; part:
    see `GaussMarkov`. Yang et al. 2016 have a constant and a drift.
    """

    kind: ClassVar[str] = "accelerometer_bias"

    sigma: Annotated[float, Quantity("m/s^2", positive=True)]
    navigation: Navigation = "relative"

    @property
    def advances(self) -> tuple[Block, ...]:
        return ((bias_block if self.part == "bias" else drift_block)(self.navigation),)
