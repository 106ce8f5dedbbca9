"""Biases as a whole, of instruments whose bias is a constant and what drifts about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core import catalogue
from relnav_graph.core.models import DerivedQuantity
from relnav_graph.core.state import Block


class WholeBias(DerivedQuantity):
    """b + d: what the instrument really adds, but for white noise."""

    block: ClassVar[Block]

    def values(self, *x: Array) -> tuple[Array, Array]:
        """b + d (N, dim) of b, d (N, dim), SI, and its Jacobian (N, dim, 2 dim)."""
        constant, drift = x
        one = np.eye(self.block.dim)
        return constant + drift, np.tile(np.hstack([one, one]), (len(constant), 1, 1))


@dataclass(frozen=True)
class WholeAccelerometerBias(WholeBias):
    """b_f + d_f of an accelerometer, as in Yang et al. 2016, of the relative navigation."""

    kind: ClassVar[str] = "whole_accelerometer_bias"
    block: ClassVar[Block] = Block(
        "whole_accelerometer_bias", "(b+d)_f_c", "vector", 3, "m/s^2", "c", "m/s^2"
    )
    reads = (catalogue.ACCELEROMETER_BIAS, catalogue.ACCELEROMETER_DRIFT)


@dataclass(frozen=True)
class WholeAbsoluteAccelerometerBias(WholeBias):
    """b_F + d_F of an accelerometer, as in Yang et al. 2016, of the absolute navigation."""

    kind: ClassVar[str] = "whole_absolute_accelerometer_bias"
    block: ClassVar[Block] = Block(
        "whole_absolute_accelerometer_bias", "(b+d)_F_c", "vector", 3, "m/s^2", "c", "m/s^2"
    )
    reads = (catalogue.ABSOLUTE_ACCELEROMETER_BIAS, catalogue.ABSOLUTE_ACCELEROMETER_DRIFT)


@dataclass(frozen=True)
class WholeGyroBias(WholeBias):
    """b + d of a gyro, as in Yang et al. 2016."""

    kind: ClassVar[str] = "whole_gyro_bias"
    block: ClassVar[Block] = Block("whole_gyro_bias", "(b+d)_c", "vector", 3, "rad/s", "c", "deg/h")
    reads = (catalogue.GYRO_BIAS, catalogue.GYRO_DRIFT)


@dataclass(frozen=True)
class WholeEarthSensorBias(WholeBias):
    """b_e + d_e of an Earth sensor, as in Yang et al. 2016."""

    kind: ClassVar[str] = "whole_earth_sensor_bias"
    block: ClassVar[Block] = Block(
        "whole_earth_sensor_bias", "(b+d)_e_s", "vector", 2, "rad", "s", "deg"
    )
    reads = (catalogue.EARTH_SENSOR_BIAS, catalogue.EARTH_SENSOR_DRIFT)


@dataclass(frozen=True)
class WholeRangeBias(WholeBias):
    """z - |r| = b + d: what a measured distance has too much, but for white noise."""

    kind: ClassVar[str] = "whole_range_bias"
    block: ClassVar[Block] = Block("whole_range_bias", "(b+d)_r", "vector", 1, "m", "-", "m")
    reads = (catalogue.RANGE_BIAS, catalogue.RANGE_DRIFT)


@dataclass(frozen=True)
class WholeRangeRateBias(WholeBias):
    """z - |r|' = b + d: what a measured range rate has too much, but for white noise."""

    kind: ClassVar[str] = "whole_range_rate_bias"
    block: ClassVar[Block] = Block(
        "whole_range_rate_bias", "(b+d)_v", "vector", 1, "m/s", "-", "m/s"
    )
    reads = (catalogue.RANGE_RATE_BIAS, catalogue.RANGE_RATE_DRIFT)
