"""Orbit of the chaser itself, its own acceleration measured by strapdown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.models import DynamicsModel
from relnav_graph.state import CHASER_POSITION, CHASER_VELOCITY, Block
from relnav_graph.units import Quantity

from ._driven_orbit import drive, driven_by
from ._gravity import Degree, earth_field
from ._strapdown import LARGEST_TURN, STRAPDOWN_INPUTS, condense
from .accelerometer_bias import Navigation

Array = NDArray[np.float64]


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """x = (r_c_i, v_c_i, R_ic, b_g, b_f). p: as `drive` has it."""
    y = np.empty(6)
    for i in range(6):
        y[i] = x[i]
    R_ic, b_g, b_f = so3.matrix_at(x, 6), so3.vector_at(x, 15), so3.vector_at(x, 18)
    y, S, noise = drive(p, u, y, R_ic, b_g, b_f)
    so3.put_vector(x_next, 0, y)
    so3.put(F, 0, 0, S, 1.0)
    so3.put(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class InertialOrbitMotion(DynamicsModel):
    """r_c'' = R_ic (f - b_f) + g(r_c) + white: the absolute navigation of Yang et al. 2016.

    velocity_random_walk_density: m/s^1.5, white noise of the accelerometer, per axis; degree:
    of the highest zonal harmonic of the Earth; max_step: s, the longest Runge-Kutta step;
    navigation: which estimate of the accelerometer's bias it takes.
    """

    kind: ClassVar[str] = "inertial_orbit_motion"
    inputs: ClassVar[Mapping[str, tuple[str, ...]]] = STRAPDOWN_INPUTS
    noises: ClassVar[tuple[str, ...]] = ("velocity_random_walk_density",) * 2
    kernel = staticmethod(kernel)

    velocity_random_walk_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    degree: Degree = 4
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0
    navigation: Navigation = "absolute"

    @property
    def advances(self) -> tuple[Block, ...]:
        return CHASER_POSITION, CHASER_VELOCITY

    @property
    def reads(self) -> tuple[Block, ...]:
        return driven_by(self.navigation)

    def constants(self) -> Array:
        own = [self.velocity_random_walk_density, self.max_step]
        return np.concatenate([earth_field(self.degree), own])

    def condense(self, u: Array) -> Array:
        """The samples of an interval as one row, or a few where the chaser turns fast."""
        return condense(u, LARGEST_TURN)
