"""A rate-integrating gyro: what it reads, given the true mean rates.

Source: Farrenkopf 1978; Crassidis and Junkins 2012, sec. 7.1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import InputSeries
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity, check_fields

__all__ = ["RateIntegratingGyro"]


@dataclass(frozen=True, eq=False)
class RateIntegratingGyro:
    """A gyro with white noise and a bias that walks at random.

    period: time between samples, s; angle_random_walk_density: of the rate's white noise,
    rad/sqrt(s); bias_random_walk_density: of the bias's derivative, rad/s^1.5;
    initial_bias: b_c at the first edge, rad/s. The densities are continuous: the white
    error of one sample over dt has variance angle_random_walk_density^2 / dt.

    Raises InputError on values of a wrong shape or sign.
    """

    kind: ClassVar[str] = "rate_integrating_gyro"

    period: Annotated[float, Quantity("s", positive=True)]
    angle_random_walk_density: Annotated[float, Quantity("rad/sqrt(s)", nonnegative=True)]
    bias_random_walk_density: Annotated[float, Quantity("rad/s^1.5", nonnegative=True)]
    initial_bias: Annotated[Array, Quantity("rad/s", (3,))] = field(
        default_factory=lambda: np.zeros(3)
    )

    def __post_init__(self) -> None:
        check_fields(self)

    def edges(self, t_first: float, t_last: float) -> Array:
        """Edges (n + 1,) of the samples from t_first to t_last, s, `period` apart.

        The last sample is shorter when the period does not divide the span. Raises
        InputError when t_last is not after t_first.
        """
        if not t_last > t_first:
            raise InputError(f"gyro: found a pass from {t_first} s to {t_last} s")
        # The margin keeps rounding from adding a sample of no length.
        n = int(np.ceil((t_last - t_first) / self.period * (1 - 1e-12)))
        return np.append(t_first + self.period * np.arange(n), t_last)

    def sample(
        self, mean_rate: Array, t_start: Array, t_end: Array, rng: np.random.Generator
    ) -> tuple[InputSeries, Array]:
        """The input "gyro" and the true bias at all edges (n + 1, 3), rad/s.

        mean_rate (n, 3): true mean of w_ci_c over each [t_start, t_end], rad/s, s; the
        intervals adjoin. Each output is the mean of rate + bias + white noise over its
        interval. Raises InputError when the intervals leave gaps or the sizes differ.
        """
        t_start, t_end = np.asarray(t_start), np.asarray(t_end)
        dt = t_end - t_start
        if np.shape(mean_rate) != (len(dt), 3):
            raise InputError(f"gyro: found rates {np.shape(mean_rate)}, expected ({len(dt)}, 3)")
        gaps = np.abs(t_start[1:] - t_end[:-1]) > 1e-9
        if (dt <= 0).any() or gaps.any():
            raise InputError("gyro: expected intervals that run forwards and adjoin")
        root = np.sqrt(dt)[:, None]
        walk, area, white = rng.standard_normal((3, len(dt), 3))
        steps = self.bias_random_walk_density * root * walk
        bias = self.initial_bias + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        # Given both ends, the mean of a Brownian path is their average plus the area of a
        # bridge, of variance sigma_u^2 dt / 12 and independent of the ends. So the mean
        # less b_k has variance sigma_u^2 dt / 3 and covariance sigma_u^2 dt / 2 with the step.
        mean_bias = 0.5 * (bias[1:] + bias[:-1])
        mean_bias += self.bias_random_walk_density * root / np.sqrt(12.0) * area
        values = mean_rate + mean_bias + self.angle_random_walk_density / root * white
        return InputSeries("gyro", t_start, t_end, values), bias
