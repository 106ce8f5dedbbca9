"""Orbit of the chaser itself, in an inertial frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.earth import UNKNOWN_TIME, time_known
from relnav_factors.shared.earth_bound import EarthBound
from relnav_factors.shared.gravity import FIELD
from relnav_factors.shared.orbit_steps import FAILURES, fly, orbit_status
from relnav_factors.shared.white_noise import duration
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_POSITION, CHASER_VELOCITY
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``r_c'' = g(r_c) + thrust + white``, ``r_c' = v_c + white``, by Runge-Kutta steps.

    p (8 + n,): field (5,), position density (m/sqrt(s)), acceleration density (m/s^1.5), longest
    step (s), Earth (n,), see `earth_numbers`, or none. u (rows, 1): dt, s, or (rows, 10), see
    `fly`. x, x_next (6,): r_c_i (m), v_c_i (m/s). F, Q (6, 6), SI.
    """
    earth = p[FIELD + 3 :]
    if not (time_known(earth, t) and time_known(earth, t + duration(u))):
        return UNKNOWN_TIME
    walk, white, longest = p[FIELD], p[FIELD + 1], p[FIELD + 2]
    y, total, noise = fly(p, earth, t, u, x, longest, walk, white)
    status = orbit_status(x, y, total)
    if status != 0:
        return status
    dense.put_vector(x_next, 0, y)
    dense.put_block(F, 0, 0, total, 1.0)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class OrbitTwoBody(EarthBound):
    """Position and velocity of the chaser, r'' = g(r) + white, in the inertial frame.

    Xiong et al. 2013, eq. 13: a point mass; with the Earth's harmonics, Sun and Moon on request.

    acceleration_density: m/s^1.5, white, per axis; position_density: m/sqrt(s), a random
    walk of the position beside it (the paper's w_2, eq. 14, drives both); degree, order,
    third_bodies: of gravity, see `EarthBound`; max_step: s, the longest Runge-Kutta step.
    """

    kind: ClassVar[str] = "orbit_two_body"
    noises: ClassVar[tuple[str, ...]] = ("position_density", "acceleration_density")
    kernel = staticmethod(kernel)
    failures = FAILURES

    acceleration_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    position_density: Annotated[float, Quantity("m/sqrt(s)", nonnegative=True)] = 0.0
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0

    @property
    def advances(self) -> tuple[Block, ...]:
        return CHASER_POSITION, CHASER_VELOCITY

    def constants(self) -> Array:
        own = [self.position_density, self.acceleration_density, self.max_step]
        return np.concatenate([self.sphere, own, self.earth])
