"""The bias of an Earth sensor, a first-order Gauss-Markov process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from relnav_factors.shared.gauss_markov import GaussMarkov
from relnav_graph.core.catalogue import EARTH_SENSOR_BIAS, EARTH_SENSOR_DRIFT
from relnav_graph.core.state import Block
from relnav_graph.units import Quantity


@dataclass(frozen=True, kw_only=True)
class EarthSensorBias(GaussMarkov):
    """b' = -b / T + white, of both angles of an Earth sensor, or of their drift about a constant.

    sigma: rad, standard deviation of each angle in the long run; time_constant: T, s; part:
    see `GaussMarkov`. Yang et al. 2016 have a constant and a drift.
    """

    kind: ClassVar[str] = "earth_sensor_bias"

    sigma: Annotated[float, Quantity("rad", positive=True)]

    @property
    def advances(self) -> tuple[Block, ...]:
        return (EARTH_SENSOR_BIAS if self.part == "bias" else EARTH_SENSOR_DRIFT,)
