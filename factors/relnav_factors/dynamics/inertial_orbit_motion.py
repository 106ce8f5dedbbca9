"""Orbit of the chaser itself, its own acceleration measured by strapdown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_factors.dynamics.accelerometer_bias import Navigation
from relnav_factors.shared.driven_orbit import DrivenOrbit, add_drifts, drive, put_drifts
from relnav_factors.shared.gravity import Degree
from relnav_factors.shared.orbit_steps import FAILURES, orbit_status
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_POSITION, CHASER_VELOCITY
from relnav_graph.core.state import Block
from relnav_graph.maths import dense


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``r_c'' = R_ic (f - b_f) + g(r_c)``, see `drive`.

    p (9,): see `DrivenOrbit.constants`. u (rows, 7): dt (s), w_ci_c (rad/s), f in c (m/s^2). x
    (21,): r_c_i (m), v_c_i (m/s), R_ic row by row, b_g (rad/s), b_f (m/s^2), and 3 more of each
    that drifts. x_next (6,): r_c_i, v_c_i. F (6, 15), and 3 columns more of each, Q (6, 6), SI.
    """
    y = np.empty(6)
    for i in range(6):
        y[i] = x[i]
    R_ic, b_g, b_f = dense.matrix_at(x, 6), dense.vector_at(x, 15), dense.vector_at(x, 18)
    add_drifts(p, x, 21, b_g, b_f)
    first = y.copy()
    y, S, noise = drive(p, u, y, R_ic, b_g, b_f)
    status = orbit_status(first, y, S)
    if status != 0:
        return status
    dense.put_vector(x_next, 0, y)
    dense.put_block(F, 0, 0, S, 1.0)
    put_drifts(p, F, 9, 15)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class InertialOrbitMotion(DrivenOrbit):
    """r_c'' = R_ic (f - b_f) + g(r_c) + white: the absolute navigation of Yang et al. 2016.

    Fields: of `DrivenOrbit`.
    """

    kind: ClassVar[str] = "inertial_orbit_motion"
    kernel = staticmethod(kernel)
    failures = FAILURES

    degree: Degree = 4
    navigation: Navigation = "absolute"

    @property
    def advances(self) -> tuple[Block, ...]:
        return CHASER_POSITION, CHASER_VELOCITY
