"""Orbit of the chaser itself, in an inertial frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.gravity import FIELD, Degree, earth_field
from relnav_factors.shared.orbit_steps import FAILURES, coast, orbit_status
from relnav_factors.shared.thrust import Thrusted, thrust_of
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_POSITION, CHASER_VELOCITY
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``r_c'' = g(r_c) + thrust + white``, ``r_c' = v_c + white``, by Runge-Kutta steps.

    p (8,): field (5,), position density (m/sqrt(s)), acceleration density (m/s^1.5), longest step
    (s). u (rows, 1): dt, s, or (rows, 10), see `thrust_of`. x, x_next (6,): r_c_i (m), v_c_i (m/s).
    F, Q (6, 6), SI.
    """
    y, total, noise = x, dense.identity(6), np.zeros((6, 6))
    walk, white, longest = p[FIELD], p[FIELD + 1], p[FIELD + 2]
    for row in range(u.shape[0]):
        thrust = thrust_of(u, row)
        y, total, noise = coast(p, y, total, noise, u[row, 0], longest, walk, white, thrust)
    status = orbit_status(x, y, total)
    if status != 0:
        return status
    dense.put_vector(x_next, 0, y)
    dense.put_block(F, 0, 0, total, 1.0)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class OrbitTwoBody(Thrusted):
    """Position and velocity of the chaser, r'' = g(r) + white, in the inertial frame.

    Xiong et al. 2013, eq. 13: a point mass; with zonal harmonics on request.

    acceleration_density: m/s^1.5, white, per axis; position_density: m/sqrt(s), a random
    walk of the position beside it (the paper's w_2, eq. 14, drives both); degree: of the
    highest zonal harmonic of the Earth, 0 or 2 to 4; max_step: s, the longest Runge-Kutta
    step.
    """

    kind: ClassVar[str] = "orbit_two_body"
    noises: ClassVar[tuple[str, ...]] = ("position_density", "acceleration_density")
    kernel = staticmethod(kernel)
    failures = FAILURES

    acceleration_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    position_density: Annotated[float, Quantity("m/sqrt(s)", nonnegative=True)] = 0.0
    degree: Degree = 0
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0

    @property
    def advances(self) -> tuple[Block, ...]:
        return CHASER_POSITION, CHASER_VELOCITY

    def constants(self) -> Array:
        own = [self.position_density, self.acceleration_density, self.max_step]
        return np.concatenate([earth_field(self.degree), own])
