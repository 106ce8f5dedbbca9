"""Bias of an accelerometer on the chaser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from relnav_factors.shared.gauss_markov import GaussMarkov
from relnav_graph.core.catalogue import ABSOLUTE_ACCELEROMETER_BIAS, ACCELEROMETER_BIAS
from relnav_graph.core.state import Block
from relnav_graph.units import Quantity

#: Whose estimate of the bias: that of the relative motion, or of the chaser's own orbit.
Navigation = Literal["relative", "absolute"]


def bias_block(navigation: Navigation) -> Block:
    """The block that holds the bias."""
    return ACCELEROMETER_BIAS if navigation == "relative" else ABSOLUTE_ACCELEROMETER_BIAS


@dataclass(frozen=True, kw_only=True)
class AccelerometerBias(GaussMarkov):
    """b' = -b / T + white, in axes of c, as in Yang et al. 2016.

    sigma: m/s^2, standard deviation of each axis in the long run; time_constant: T, s;
    navigation: which of two estimates of the one bias this is, "relative" or "absolute".
    """

    kind: ClassVar[str] = "accelerometer_bias"

    sigma: Annotated[float, Quantity("m/s^2", positive=True)]
    navigation: Navigation = "relative"

    @property
    def advances(self) -> tuple[Block, ...]:
        return (bias_block(self.navigation),)
