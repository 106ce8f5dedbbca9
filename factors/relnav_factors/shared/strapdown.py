"""Strapdown inertial data: turns and velocity gained over a sample, and many samples as one.

A sample is a row (dt, w, f): its length in s, and the means of w_ci_c, rad/s, and of the
specific force in axes of c, m/s^2. The axes turn while the force acts, so a sample's velocity
is resolved in those of its middle, Exp(w dt / 2) f dt = f dt + w x f dt^2 / 2 + ...: the
rotation (sculling) term of Savage 1998 (Journal of Guidance 21-2), eq. 7.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.maths import dense, so3

#: Table of a gyro: the mean of w_ci_c over each sample.
GYRO_COLUMNS = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
#: Table of an accelerometer: the mean of the specific force over each sample, in axes of c.
FORCE_COLUMNS = ("fx_m_s2", "fy_m_s2", "fz_m_s2")
STRAPDOWN_INPUTS: Mapping[str, tuple[str, ...]] = {
    "gyro": GYRO_COLUMNS,
    "accelerometer": FORCE_COLUMNS,
}
#: Samples are taken together up to this turn, rad: the corrections for biases that come
#: afterwards hold the rate and the force of one row constant.
LARGEST_TURN = 0.1


@jit
def velocity_gained(
    R_ic: Array, row: Array, b_g: Array, b_f: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Velocity gained over a sample, ``R_ic Exp(w dt / 2) f dt`` without the biases, in i.

    R_ic: (3, 3) at the start; row: (7,): dt (s), w_ci_c (rad/s), f in c (m/s^2); b_g: (3,), rad/s;
    b_f: (3,), m/s^2. Returns the velocity (3,), m/s; its Jacobians (3, 3) to R_ic (a right
    perturbation, rad), to b_g and to b_f; and R_ic (3, 3) at the end.
    """
    dt = row[0]
    half, force = np.empty(3), np.empty(3)
    for i in range(3):
        half[i] = 0.5 * (row[1 + i] - b_g[i]) * dt
        force[i] = (row[4 + i] - b_f[i]) * dt
    ahead = so3.exp(half)
    R_im = dense.matmul(R_ic, ahead)
    to_attitude = dense.matmul(R_ic, so3.skew(dense.matvec(ahead, force)))
    to_half = dense.matmul(dense.matmul(R_im, so3.skew(force)), so3.right_jacobian(half))
    zero = np.zeros((3, 3))
    return (
        dense.matvec(R_im, force),
        dense.add_scaled(zero, to_attitude, -1.0),
        dense.add_scaled(zero, to_half, 0.5 * dt),
        dense.add_scaled(zero, R_im, -dt),
        dense.matmul(R_im, ahead),
    )


@jit
def _one(u: Array, first: int, last: int, out: Array) -> None:
    """Rows first to last - 1 of u as one row `out`: the constant rate and force that turn
    and accelerate as much."""
    width = u.shape[1]
    turned, gained, length = dense.identity(3), np.zeros(3), 0.0
    half, force = np.empty(3), np.zeros(3)
    for row in range(first, last):
        dt = u[row, 0]
        length += dt
        for i in range(3):
            half[i] = 0.5 * u[row, 1 + i] * dt
            if width > 4:
                force[i] = u[row, 4 + i] * dt
        ahead = so3.exp(half)
        middle = dense.matmul(turned, ahead)
        gained = dense.add_scaled_vector(gained, dense.matvec(middle, force), 1.0)
        turned = dense.matmul(middle, ahead)
    angle = so3.log(so3.project(turned))
    for i in range(3):
        half[i] = 0.5 * angle[i]
    gained = dense.transposed_matvec(so3.exp(half), gained)
    out[0] = length
    for i in range(3):
        out[1 + i] = angle[i] / length
        if width > 4:
            out[4 + i] = gained[i] / length


@jit
def condense(u: Array, largest: float) -> Array:
    """Consecutive rows merged into few: each turns by about `largest`, rad, at most.

    u: (rows, 4): dt (s), w (rad/s), or (rows, 7): with f (m/s^2) too. Returns fewer rows alike.
    """
    out, rows, first, angle = np.empty(u.shape), 0, 0, 0.0
    for row in range(u.shape[0]):
        own = dense.norm(u[row, 1:4]) * u[row, 0]
        if row > first and angle + own > largest:
            _one(u, first, row, out[rows])
            rows, first, angle = rows + 1, row, 0.0
        angle += own
    _one(u, first, u.shape[0], out[rows])
    kept = np.empty((rows + 1, u.shape[1]))
    for row in range(rows + 1):
        for j in range(u.shape[1]):
            kept[row, j] = out[row, j]
    return kept
