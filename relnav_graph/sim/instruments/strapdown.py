"""Strapdown gyro and accelerometer: what they read, given the true means over each sample.

The error of each is a constant bias, a first-order Gauss-Markov drift about it, and white noise.
Their errors are drawn interval by interval (`begin`), so that a pass of any length is never
held at the rate of its fastest sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity, check_fields

__all__ = ["ErrorSampler", "StrapdownAccelerometer", "StrapdownGyro"]


def _zeros() -> Array:
    return np.zeros(3)


class ErrorSampler:
    """The errors of a sensor, one interval after the other.

    white: density of the white noise; sigma, time_constant: of the drift, a Gauss-Markov process
    that is as old as the sensor. bias: the constant one, (3,); drift: what it drifts about that,
    (3,), at the end of the last interval.
    """

    def __init__(
        self,
        bias: Array,
        white: float,
        sigma: float,
        time_constant: float,
        rng: np.random.Generator,
    ) -> None:
        self.bias, self._rng = np.array(bias), rng
        self.drift = sigma * rng.standard_normal(3)
        self._white, self._sigma, self._time_constant = white, sigma, time_constant

    def take(self, edges: Array) -> Array:
        """Errors (n, 3) of the samples between `edges` (n + 1,), s: the bias and the drift in the
        middle of each, and white noise."""
        dt = np.diff(edges)
        white, steps = self._rng.standard_normal((2, len(dt), 3))
        kept = np.exp(-dt / self._time_constant)
        steps *= (self._sigma * np.sqrt(1 - kept**2))[:, None]
        drift = np.empty((len(dt) + 1, 3))
        drift[0] = self.drift
        for k in range(len(dt)):
            drift[k + 1] = kept[k] * drift[k] + steps[k]
        self.drift = drift[-1]
        errors: Array = self.bias + 0.5 * (drift[1:] + drift[:-1])
        errors += (self._white / np.sqrt(dt))[:, None] * white
        return errors


def _edges(kind: str, period: float, t_first: float, t_last: float) -> Array:
    if not t_last > t_first:
        raise InputError(f"{kind}: found a pass from {t_first} s to {t_last} s")
    # The margin keeps rounding from adding a sample of no length.
    n = int(np.ceil((t_last - t_first) / period * (1 - 1e-9)))
    return np.append(t_first + period * np.arange(n), t_last)


@dataclass(frozen=True, eq=False, kw_only=True)
class StrapdownGyro:
    """A gyro with a constant bias and a Gauss-Markov drift about it.

    period: between samples, s; angle_random_walk_density: white noise, rad/sqrt(s);
    constant_bias: b_c, rad/s; drift_sigma: rad/s, of the drift, at the start as later;
    drift_time_constant: s. Raises InputError on values of a wrong shape or sign.
    """

    kind: ClassVar[str] = "strapdown_gyro"
    #: Blocks whose truth its constant bias is.
    measures: ClassVar[tuple[str, ...]] = ("gyro_bias",)

    period: Annotated[float, Quantity("s", positive=True)]
    angle_random_walk_density: Annotated[float, Quantity("rad/sqrt(s)", nonnegative=True)]
    drift_sigma: Annotated[float, Quantity("rad/s", nonnegative=True)]
    drift_time_constant: Annotated[float, Quantity("s", positive=True)]
    constant_bias: Annotated[Array, Quantity("rad/s", (3,))] = field(default_factory=_zeros)

    def __post_init__(self) -> None:
        check_fields(self)

    def edges(self, t_first: float, t_last: float) -> Array:
        """Edges (n + 1,) of the samples from t_first to t_last, s, `period` apart; the last
        may be shorter. Raises InputError when t_last is not after t_first."""
        return _edges(self.kind, self.period, t_first, t_last)

    def begin(self, rng: np.random.Generator) -> ErrorSampler:
        """Errors from the start of a pass on, rad/s."""
        own = self.angle_random_walk_density, self.drift_sigma, self.drift_time_constant
        return ErrorSampler(self.constant_bias, *own, rng)


@dataclass(frozen=True, eq=False, kw_only=True)
class StrapdownAccelerometer:
    """An accelerometer with a constant bias and a Gauss-Markov drift about it.

    period: between samples, s; velocity_random_walk_density: white noise, m/s^1.5;
    constant_bias: b_f_c, m/s^2; drift_sigma: m/s^2, of the drift, at the start as later;
    drift_time_constant: s. Raises InputError on values of a wrong shape or sign.
    """

    kind: ClassVar[str] = "strapdown_accelerometer"
    measures: ClassVar[tuple[str, ...]] = ("accelerometer_bias", "absolute_accelerometer_bias")

    period: Annotated[float, Quantity("s", positive=True)]
    velocity_random_walk_density: Annotated[float, Quantity("m/s^1.5", nonnegative=True)]
    drift_sigma: Annotated[float, Quantity("m/s^2", nonnegative=True)]
    drift_time_constant: Annotated[float, Quantity("s", positive=True)]
    constant_bias: Annotated[Array, Quantity("m/s^2", (3,))] = field(default_factory=_zeros)

    def __post_init__(self) -> None:
        check_fields(self)

    def edges(self, t_first: float, t_last: float) -> Array:
        """Edges (n + 1,), s, of the samples, as those of `StrapdownGyro`."""
        return _edges(self.kind, self.period, t_first, t_last)

    def begin(self, rng: np.random.Generator) -> ErrorSampler:
        """Errors from the start of a pass on, m/s^2."""
        own = self.velocity_random_walk_density, self.drift_sigma, self.drift_time_constant
        return ErrorSampler(self.constant_bias, *own, rng)
