"""Compiled integration of two craft and a rigid target, in an inertial frame.

The state y (19,), SI: r_ti_i position of the target (0:3), its velocity v_ti_i (3:6),
d_tc_i position of the chaser minus that of the target (6:9), its inertial derivative
(9:12), q_it as q_wxyz (12:16), w_ti_t (16:19).
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import INDICES, MATRIX, VECTOR

__all__ = ["STATE_SIZE", "integrate"]


STATE_SIZE = 19

# Butcher 1964, sixth order in seven stages. The equations do not contain the time, so the
# nodes are not needed.
_A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 3, 0, 0, 0, 0, 0],
        [0, 2 / 3, 0, 0, 0, 0],
        [1 / 12, 1 / 3, -1 / 12, 0, 0, 0],
        [-1 / 16, 9 / 8, -3 / 16, -3 / 8, 0, 0],
        [0, 9 / 8, -3 / 8, -3 / 4, 1 / 2, 0],
        [9 / 44, -9 / 11, 63 / 44, 18 / 11, 0, -16 / 11],
    ]
)
_B = np.array([11 / 120, 0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120])


@jit
def _orbits(mu: float, y: Array, acceleration: Array, out: Array) -> None:
    """Two-body motion of the target and, exactly, of the chaser relative to it.

    With r_c^2 = r_t^2 (1 + q) and f = (1 + q)^(3/2) - 1, the difference of the two
    gravities is -mu / r_c^3 (d - f r_t), where f is written so that nothing cancels; the
    difference of two positions of 7e6 m would leave an error of 1e-9 m at each step.
    Battin 1999, eqs. 8.60-8.62.
    """
    s = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
    q = 0.0
    for i in range(3):
        q += y[6 + i] * (2 * y[i] + y[6 + i])
    q /= s
    ratio = (1 + q) * np.sqrt(1 + q)  # (r_c / r_t)^3
    f = q * (3 + q * (3 + q)) / (1 + ratio)
    g = mu / (s * np.sqrt(s))
    for i in range(3):
        out[i] = y[3 + i]
        out[3 + i] = -g * y[i]
        out[6 + i] = y[9 + i]
        out[9 + i] = -g / ratio * (y[6 + i] - f * y[i]) + acceleration[i]


@jit
def _rotation(inertia: Array, y: Array, angular_acceleration: Array, out: Array) -> None:
    """Kinematics of q_it and Euler's equations about principal axes.

    The first is linear in q, so the length of q, which drifts by rounding, does no harm.
    """
    a, b, c, d = y[12], y[13], y[14], y[15]
    wx, wy, wz = y[16], y[17], y[18]
    out[12] = -0.5 * (b * wx + c * wy + d * wz)
    out[13] = 0.5 * (a * wx + c * wz - d * wy)
    out[14] = 0.5 * (a * wy + d * wx - b * wz)
    out[15] = 0.5 * (a * wz + b * wy - c * wx)
    jx, jy, jz = inertia
    out[16] = (jy - jz) * wy * wz / jx + angular_acceleration[0]
    out[17] = (jz - jx) * wz * wx / jy + angular_acceleration[1]
    out[18] = (jx - jy) * wx * wy / jz + angular_acceleration[2]


@jit
def _step(mu: float, inertia: Array, disturbance: Array, h: float, y: Array, k: Array) -> None:
    """Advance y by h in place; k (8, 19) is scratch space, its last row the stage."""
    stage = k[7]
    for s in range(7):
        for i in range(STATE_SIZE):
            change = 0.0
            for j in range(s):
                change += _A[s, j] * k[j, i]
            stage[i] = y[i] + h * change
        _orbits(mu, stage, disturbance[3:6], k[s])
        _rotation(inertia, stage, disturbance[0:3], k[s])
    for i in range(STATE_SIZE):
        change = 0.0
        for s in range(7):
            change += _B[s] * k[s, i]
        y[i] += h * change


@jit_loop(VECTOR, VECTOR, INDICES, VECTOR, MATRIX, MATRIX, ahead=False)
def integrate(
    p: Array, y0: Array, counts: Indices, h: Array, disturbance: Array, out: Array
) -> None:
    """The state after each of N intervals, by a fixed-step Runge-Kutta method of order 6.

    p (4,): mu (m^3/s^2), principal moments (kg m^2); y0 (19,) start; counts (N,) steps in
    each interval, and h (N,) their length, s; disturbance (sum of counts, 6), held over
    its step: angular acceleration of the target (t-components, rad/s^2) and acceleration
    of the chaser (i-components, m/s^2); out (N, 19) is filled.
    """
    y = y0.copy()
    k = np.empty((8, STATE_SIZE))
    row = 0
    for n in range(counts.shape[0]):
        for _ in range(counts[n]):
            give_way(row)
            _step(p[0], p[1:4], disturbance[row], h[n], y, k)
            row += 1
        for i in range(STATE_SIZE):  # `out[n] = y` takes 2 s more to compile
            out[n, i] = y[i]
