"""Relative motion in inertial axes, the chaser's own acceleration measured by strapdown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.models import DynamicsModel
from relnav_graph.state import (
    CHASER_POSITION,
    CHASER_VELOCITY,
    RELATIVE_POSITION,
    RELATIVE_VELOCITY,
    Block,
)
from relnav_graph.units import Quantity

from ._driven_orbit import OTHERS, drive, driven_by
from ._gravity import Degree, earth_field
from ._strapdown import LARGEST_TURN, STRAPDOWN_INPUTS, condense
from .accelerometer_bias import Navigation

Array = NDArray[np.float64]


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """x = (r_tc_i, v_tc_i, R_ic, b_g, b_f, r_c_i, v_c_i). p: as `drive` has it."""
    y = np.empty(12)
    for i in range(6):
        y[i], y[6 + i] = x[i], x[21 + i]
    R_ic, b_g, b_f = so3.matrix_at(x, 6), so3.vector_at(x, 15), so3.vector_at(x, 18)
    y, S, noise = drive(p, u, y, R_ic, b_g, b_f)
    for i in range(6):
        x_next[i] = y[i]
        for j in range(6):
            F[i, j], F[i, 6 + OTHERS + j] = S[i, j], S[i, 6 + j]
        for j in range(OTHERS):
            F[i, 6 + j] = S[i, 12 + j]
    so3.put(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class InertialRelativeMotion(DynamicsModel):
    """r_tc'' = R_ic (f - b_f) + g(r_c) - g(r_c - r_tc) + white; o is i and does not rotate.

    Yang et al. 2016, with the exact difference of two gravities in place of its gradient. f is
    what the chaser's accelerometer measures, its thrust above all; the target flies freely.
    Samples are taken together, so that an epoch costs the same at any rate of the
    accelerometer.

    velocity_random_walk_density: m/s^1.5, white noise of the accelerometer, per axis; degree:
    of the highest zonal harmonic of the Earth; max_step: s, the longest Runge-Kutta step;
    navigation: which estimate of the accelerometer's bias it takes.
    """

    kind: ClassVar[str] = "inertial_relative_motion"
    inputs: ClassVar[Mapping[str, tuple[str, ...]]] = STRAPDOWN_INPUTS
    noises: ClassVar[tuple[str, ...]] = ("velocity_random_walk_density",) * 2
    kernel = staticmethod(kernel)

    velocity_random_walk_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    degree: Degree = 2
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0
    navigation: Navigation = "relative"

    @property
    def advances(self) -> tuple[Block, ...]:
        return RELATIVE_POSITION, RELATIVE_VELOCITY

    @property
    def reads(self) -> tuple[Block, ...]:
        return (*driven_by(self.navigation), CHASER_POSITION, CHASER_VELOCITY)

    def constants(self) -> Array:
        own = [self.velocity_random_walk_density, self.max_step]
        return np.concatenate([earth_field(self.degree), own])

    def condense(self, u: Array) -> Array:
        """The samples of an interval as one row, or a few where the chaser turns fast."""
        return condense(u, LARGEST_TURN)
