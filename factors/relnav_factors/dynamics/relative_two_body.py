"""Relative motion of two craft of which one has its own orbit in the state."""

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
from relnav_graph.core.catalogue import (
    CHASER_POSITION,
    CHASER_VELOCITY,
    RELATIVE_POSITION,
    RELATIVE_VELOCITY,
)
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``r_tc'' = g(r_c) - g(r_c - r_tc) + thrust + white``, by Runge-Kutta steps.

    p (7 + n,): field (5,), acceleration density (m/s^1.5), longest step (s), Earth (n,), see
    `earth_numbers`, or none. u (rows, 1): dt, s, or (rows, 10), see `fly`. x (12,):
    r_tc_i (m), v_tc_i (m/s), r_c_i, v_c_i. x_next (6,): r_tc_i, v_tc_i. F (6, 12), Q (6, 6), SI.
    """
    earth = p[FIELD + 2 :]
    if not (time_known(earth, t) and time_known(earth, t + duration(u))):
        return UNKNOWN_TIME
    y, total, noise = fly(p, earth, t, u, x, p[FIELD + 1], 0.0, p[FIELD])
    status = orbit_status(x, y, total)
    if status != 0:
        return status
    for i in range(6):
        x_next[i] = y[i]
        for j in range(12):
            F[i, j] = total[i, j]
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class RelativeTwoBody(EarthBound):
    """r_tc'' = g(r_c) - g(r_c - r_tc) + white, in axes that do not rotate: o is i.

    The exact difference of two gravities, where Xiong et al. 2013, eq. 12, have its first
    order, in an orbital frame taken from the chaser's orbit (6 mm at 200 m). The chaser's
    orbit stands in the state: see `OrbitTwoBody`.

    acceleration_density: m/s^1.5, white, per axis, of the relative motion; degree, order,
    third_bodies: of gravity, see `EarthBound`; max_step: s, the longest Runge-Kutta step.
    With thrust, the chaser's own orbit takes the same input, and draws what that misses for itself.
    """

    kind: ClassVar[str] = "relative_two_body"
    #: o does not turn.
    orbit: ClassVar[None] = None
    noises: ClassVar[tuple[str, ...]] = ("acceleration_density", "acceleration_density")
    kernel = staticmethod(kernel)
    failures = FAILURES

    acceleration_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0

    @property
    def advances(self) -> tuple[Block, ...]:
        return RELATIVE_POSITION, RELATIVE_VELOCITY

    @property
    def reads(self) -> tuple[Block, ...]:
        return CHASER_POSITION, CHASER_VELOCITY

    def constants(self) -> Array:
        own = [self.acceleration_density, self.max_step]
        return np.concatenate([self.sphere, own, self.earth])
