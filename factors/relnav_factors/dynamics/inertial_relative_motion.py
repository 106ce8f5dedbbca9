"""Relative motion in inertial axes, the chaser's own acceleration measured by strapdown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_factors.dynamics.accelerometer_bias import Navigation
from relnav_factors.shared.driven_orbit import OTHERS, DrivenOrbit, add_drifts, drive, put_drifts
from relnav_factors.shared.gravity import Degree
from relnav_factors.shared.orbit_steps import FAILURES, orbit_status
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


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``r_tc'' = R_ic (f - b_f) + g(r_c) - g(r_c - r_tc)``, see `drive`.

    p (9,): see `DrivenOrbit.constants`. u (rows, 7): dt (s), w_ci_c (rad/s), f in c (m/s^2). x
    (27,): r_tc_i (m), v_tc_i (m/s), R_ic row by row, b_g (rad/s), b_f (m/s^2), r_c_i, v_c_i, and 3
    more of each that drifts. x_next (6,): r_tc_i, v_tc_i. F (6, 21), and 3 columns more of each, Q
    (6, 6), SI.
    """
    y = np.empty(12)
    for i in range(6):
        y[i], y[6 + i] = x[i], x[21 + i]
    R_ic, b_g, b_f = dense.matrix_at(x, 6), dense.vector_at(x, 15), dense.vector_at(x, 18)
    add_drifts(p, x, 27, b_g, b_f)
    first = y.copy()
    y, S, noise = drive(p, u, y, R_ic, b_g, b_f)
    status = orbit_status(first, y, S)
    if status != 0:
        return status
    for i in range(6):
        x_next[i] = y[i]
        for j in range(6):
            F[i, j], F[i, 6 + OTHERS + j] = S[i, j], S[i, 6 + j]
        for j in range(OTHERS):
            F[i, 6 + j] = S[i, 12 + j]
    put_drifts(p, F, 9, 21)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class InertialRelativeMotion(DrivenOrbit):
    """r_tc'' = R_ic (f - b_f) + g(r_c) - g(r_c - r_tc) + white; o is i and does not rotate.

    Yang et al. 2016, with the exact difference of two gravities in place of its gradient. f is
    what the chaser's accelerometer measures, its thrust above all; the target flies freely.
    Fields: of `DrivenOrbit`.
    """

    kind: ClassVar[str] = "inertial_relative_motion"
    kernel = staticmethod(kernel)
    failures = FAILURES
    besides = (CHASER_POSITION, CHASER_VELOCITY)

    degree: Degree = 2
    navigation: Navigation = "relative"

    @property
    def advances(self) -> tuple[Block, ...]:
        return RELATIVE_POSITION, RELATIVE_VELOCITY
