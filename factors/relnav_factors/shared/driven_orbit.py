"""Orbits under gravity and a measured specific force, in inertial axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from relnav_factors.dynamics.accelerometer_bias import Navigation, bias_block, drift_block
from relnav_factors.shared.gravity import FIELD, Degree, earth_field
from relnav_factors.shared.orbit_steps import coast
from relnav_factors.shared.strapdown import (
    LARGEST_TURN,
    STRAPDOWN_INPUTS,
    condense,
    velocity_gained,
)
from relnav_factors.shared.thrust import THRUST
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE, GYRO_BIAS, GYRO_DRIFT
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity

# Columns of the sensitivities after those of the orbits: R_ic, gyro bias, accelerometer bias.
ATTITUDE, GYRO, FORCE, OTHERS = 0, 3, 6, 9
# Where p says whether gyro and accelerometer drift about constant biases.
_GYRO_DRIFTS, _FORCE_DRIFTS = FIELD + 2, FIELD + 3


@jit
def add_drifts(p: Array, x: Array, first: int, b_g: Array, b_f: Array) -> None:
    """Add to the biases what drifts about them, in place: b_g (3,), rad/s, b_f (3,), m/s^2.

    p: (9,), see `DrivenOrbit.constants`; x: from `first` on the drifts that there are, alike.
    """
    for drifts, bias in ((p[_GYRO_DRIFTS], b_g), (p[_FORCE_DRIFTS], b_f)):
        if drifts > 0.0:
            for i in range(3):
                bias[i] += x[first + i]
            first += 3


@jit
def put_drifts(p: Array, F: Array, bias: int, first: int) -> None:
    """Fill the columns of F (6, m) to drifts, from `first` on, with those to the biases, SI.

    p: (9,), see `DrivenOrbit.constants`; bias: the first column to b_g, before those to b_f.
    """
    for drifts, own in ((p[_GYRO_DRIFTS], bias), (p[_FORCE_DRIFTS], bias + FORCE - GYRO)):
        if drifts > 0.0:
            for i in range(6):
                for j in range(3):
                    F[i, first + j] = F[i, own + j]
            first += 3


@jit
def drive(
    p: Array, u: Array, y: Array, R_ic: Array, b_g: Array, b_f: Array
) -> tuple[Array, Array, Array]:
    """An orbit over an interval of strapdown samples, its sensitivity and its noise.

    p: (9,): field (5,), density of the velocity's random walk (m/s^1.5), longest step (s); u:
    (rows, 7): dt (s), w_ci_c (rad/s), f in c (m/s^2); y: (n,): r_c (m), v_c (m/s), or r_tc, v_tc,
    r_c, v_c, in i; R_ic: (3, 3); b_g: (3,), rad/s; b_f: (3,), m/s^2. Returns y at the end, its
    sensitivity (n, n + 9) to y, R_ic, b_g and b_f, and the covariance (6, 6) of the noise of its
    first six, SI.

    In each row gravity acts first. Then the measured force adds dv to the velocity and dv dt / 2 to
    the position: what is left out is how gravity changes over that displacement.
    """
    n = y.shape[0]
    S, Q = np.zeros((n, n + OTHERS)), np.zeros((6, 6))
    for i in range(n):
        S[i, i] = 1.0
    to_R, to_g = dense.identity(3), np.zeros((3, 3))
    turn, kick, none, sphere = np.empty(3), np.empty((3, 9)), np.zeros(THRUST), np.empty(0)
    for row in range(u.shape[0]):
        dt = u[row, 0]
        y, S, Q = coast(p, sphere, 0.0, y, S, Q, dt, p[FIELD + 1], 0.0, p[FIELD], none)
        dv, by_R, by_g, by_f, R_ic = velocity_gained(R_ic, u[row], b_g, b_f)
        dense.put_block(kick, 0, ATTITUDE, dense.matmul(by_R, to_R), 1.0)
        dense.put_block(kick, 0, GYRO, dense.add_scaled(by_g, dense.matmul(by_R, to_g), 1.0), 1.0)
        dense.put_block(kick, 0, FORCE, by_f, 1.0)
        for first in range(0, n, 6):
            for i in range(3):
                y[first + i] += 0.5 * dt * dv[i]
                y[first + 3 + i] += dv[i]
                for j in range(9):
                    S[first + i, n + j] += 0.5 * dt * kick[i, j]
                    S[first + 3 + i, n + j] += kick[i, j]
        for i in range(3):
            turn[i] = (u[row, 1 + i] - b_g[i]) * dt
        back = dense.transposed_matmul(so3.exp(turn), dense.identity(3))
        to_R = dense.matmul(back, to_R)
        to_g = dense.add_scaled(dense.matmul(back, to_g), so3.right_jacobian(turn), -dt)
    return y, S, Q


@dataclass(frozen=True, kw_only=True)
class DrivenOrbit(DynamicsModel):
    """What the orbits share whose own acceleration an accelerometer measures.

    Samples are taken together, so that an epoch costs the same at any rate of the
    accelerometer.

    velocity_random_walk_density: m/s^1.5, white noise of the accelerometer, per axis; degree:
    of the highest zonal harmonic of the Earth; max_step: s, the longest Runge-Kutta step;
    navigation: which estimate of the accelerometer's bias it takes; gyro_drift and
    accelerometer_drift: whether what drifts about a constant bias is a block of its own.
    """

    #: o does not turn.
    orbit: ClassVar[None] = None
    inputs: ClassVar[Mapping[str, tuple[str, ...]]] = STRAPDOWN_INPUTS
    noises: ClassVar[tuple[str, ...]] = ("velocity_random_walk_density",) * 2
    #: Blocks that a model reads besides.
    besides: ClassVar[tuple[Block, ...]] = ()

    velocity_random_walk_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    degree: Degree
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0
    navigation: Navigation
    gyro_drift: bool = False
    accelerometer_drift: bool = False

    @property
    def reads(self) -> tuple[Block, ...]:
        """In the order of `drive`, then those of the model alone, then the drifts."""
        biased = CHASER_ATTITUDE, GYRO_BIAS, bias_block(self.navigation)
        return *biased, *self.besides, *self.drifts

    @property
    def drifts(self) -> tuple[Block, ...]:
        """What drifts about constant biases."""
        own = drift_block(self.navigation)
        return (GYRO_DRIFT,) * self.gyro_drift + (own,) * self.accelerometer_drift

    def without_drift(self) -> Self:
        """The same with constant biases, see `relnav_graph.core.contracts.Drifts`."""
        return replace(self, gyro_drift=False, accelerometer_drift=False)

    def constants(self) -> Array:
        """(9,): field (5,), density of the velocity's random walk (m/s^1.5), longest step (s), 1 or
        0 each: whether the gyro and the accelerometer drift."""
        own = [self.velocity_random_walk_density, self.max_step]
        return np.concatenate(
            [earth_field(self.degree), own, [self.gyro_drift, self.accelerometer_drift]]
        )

    def condense(self, u: Array) -> Array:
        """The samples of an interval, (rows, 7), as one row, or a few in a fast turn."""
        return condense(u, LARGEST_TURN)
