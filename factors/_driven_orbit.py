"""Orbits under gravity and a measured specific force, in inertial axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.state import CHASER_ATTITUDE, GYRO_BIAS, Block

from ._gravity import FIELD, orbit_step
from ._strapdown import velocity_gained
from ._white_noise import add_integrated_white_noise, step_count
from .accelerometer_bias import Navigation, bias_block

Array = NDArray[np.float64]
# Columns of the sensitivities after those of the orbits: R_ic, gyro bias, accelerometer bias.
ATTITUDE, GYRO, FORCE, OTHERS = 0, 3, 6, 9


def driven_by(navigation: Navigation) -> tuple[Block, ...]:
    """The blocks that such an orbit reads, in the order of `drive`."""
    return CHASER_ATTITUDE, GYRO_BIAS, bias_block(navigation)


@jit
def _drift(p: Array, y: Array, S: Array, Q: Array, dt: float) -> tuple[Array, Array, Array]:
    """State, sensitivity and noise of the first craft after dt seconds of gravity alone."""
    steps = step_count(dt, p[FIELD + 1])
    own = np.empty((6, 6))
    for _ in range(steps):
        y, step = orbit_step(p, y, dt / steps)
        for i in range(6):
            for j in range(6):
                own[i, j] = step[i, j]
        Q = so3.propagate_covariance(own, Q)
        add_integrated_white_noise(Q, 0, p[FIELD] ** 2, dt / steps)
        S = so3.multiply(step, S)
    return y, S, Q


@jit
def drive(
    p: Array, u: Array, y: Array, R_ic: Array, b_g: Array, b_f: Array
) -> tuple[Array, Array, Array]:
    """y after an interval, its sensitivity to y, R_ic, b_g and b_f, (n, n + 9), and the
    covariance (6, 6) of the noise of its first six.

    y: (r_c, v_c) or (r_tc, v_tc, r_c, v_c), m and m/s; p: field, density of the velocity's
    random walk, longest step; u: rows (dt, w, f). In each row gravity acts first, then the
    measured force, as a velocity and half of it, times dt, as a displacement: what is left
    out is how gravity changes over that displacement.
    """
    n = y.shape[0]
    S, Q = np.zeros((n, n + OTHERS)), np.zeros((6, 6))
    for i in range(n):
        S[i, i] = 1.0
    to_R, to_g = so3.identity(3), np.zeros((3, 3))
    turn, kick = np.empty(3), np.empty((3, 9))
    for row in range(u.shape[0]):
        dt = u[row, 0]
        y, S, Q = _drift(p, y, S, Q, dt)
        dv, by_R, by_g, by_f, R_ic = velocity_gained(R_ic, u[row], b_g, b_f)
        so3.put(kick, 0, ATTITUDE, so3.multiply(by_R, to_R), 1.0)
        so3.put(kick, 0, GYRO, so3.add(by_g, so3.multiply(by_R, to_g), 1.0), 1.0)
        so3.put(kick, 0, FORCE, by_f, 1.0)
        for first in range(0, n, 6):
            for i in range(3):
                y[first + i] += 0.5 * dt * dv[i]
                y[first + 3 + i] += dv[i]
                for j in range(9):
                    S[first + i, n + j] += 0.5 * dt * kick[i, j]
                    S[first + 3 + i, n + j] += kick[i, j]
        for i in range(3):
            turn[i] = (u[row, 1 + i] - b_g[i]) * dt
        back = so3.transpose_multiply(so3.exp(turn), so3.identity(3))
        to_R = so3.multiply(back, to_R)
        to_g = so3.add(so3.multiply(back, to_g), so3.right_jacobian(turn), -dt)
    return y, S, Q
