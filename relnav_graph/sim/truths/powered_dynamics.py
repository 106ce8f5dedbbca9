"""Compiled truth of two craft under gravity with J2, J3 and J4 and accelerations held constant.

The state y (12,), SI: position and velocity of the target, then of the chaser, both inertial
and from the Earth's centre. Nothing here is shared with the models of the estimators: the
harmonics are those of Vallado 2013, eqs. 8-30 to 8-32 of each degree in Cartesian form, the
integrator is Kutta's 3/8 rule.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit
from relnav_graph.constants import EARTH_RADIUS, MU_EARTH, ZONAL_EARTH
from relnav_graph.maths import dense, so3

__all__ = ["fly_orbits", "gravity", "sample_attitude"]

_J2, _J3, _J4 = ZONAL_EARTH


@jit
def gravity(r: Array) -> Array:
    """Acceleration (3,), m/s^2, at r (3,), m from the Earth's centre, both in i."""
    x, y, z = r[0], r[1], r[2]
    r2 = x * x + y * y + z * z
    d = np.sqrt(r2)
    mu = MU_EARTH / (r2 * d)
    u2 = z * z / r2
    e = EARTH_RADIUS / d
    a2, a3, a4 = 1.5 * _J2 * e**2, 2.5 * _J3 * e**3, 0.625 * _J4 * e**4
    s = z / d
    level = -a2 * (1 - 5 * u2) - a3 * s * (3 - 7 * u2) + a4 * (3 - 42 * u2 + 63 * u2 * u2)
    out = np.empty(3)
    out[0] = mu * x * (-1 + level)
    out[1] = mu * y * (-1 + level)
    out[2] = mu * (
        z * (-1 - a2 * (3 - 5 * u2) + a4 * (15 - 70 * u2 + 63 * u2 * u2))
        - a3 * d * (6 * u2 - 7 * u2 * u2 - 0.6)
    )
    return out


@jit
def _slope(y: Array, held: Array) -> Array:
    out = np.empty(12)
    for first in (0, 6):
        g = gravity(dense.vector_at(y, first))
        for i in range(3):
            out[first + i] = y[first + 3 + i]
            out[first + 3 + i] = g[i] + held[first // 2 + i]
    return out


@jit
def fly_orbits(y: Array, held: Array, h: float, steps: int) -> Array:
    """The state y (12,) after `steps` steps of h seconds.

    held (6,): constant accelerations of target and chaser besides gravity, m/s^2, in i.
    """
    for n in range(steps):
        give_way(n)
        k1 = _slope(y, held)
        k2 = _slope(y + h / 3 * k1, held)
        k3 = _slope(y + h * (k2 - k1 / 3), held)
        k4 = _slope(y + h * (k1 - k2 + k3), held)
        y = y + h / 8 * (k1 + 3 * k2 + 3 * k3 + k4)
    return y


@jit
def _attitude(R: Array, rate: Array, wobble: Array, since: float, t: float) -> Array:
    """R_ic: a steady turn of `since` seconds from R, then a wobble of small angles."""
    turn, angle = np.empty(3), np.empty(3)
    phase = wobble[1] * t
    for i in range(3):
        turn[i] = rate[i] * since
    angle[0], angle[1] = wobble[0] * np.sin(phase), wobble[0] * np.cos(phase)
    angle[2] = 0.5 * wobble[0] * np.sin(2 * phase)
    return dense.matmul(dense.matmul(R, so3.exp(turn)), so3.exp(angle))


@jit
def sample_attitude(
    R: Array, rate: Array, wobble: Array, edges: Array, force_i: Array
) -> tuple[Array, Array]:
    """Means of w_ci_c (n, 3), rad/s, and of the specific force in c (n, 3) between edges
    (n + 1,), s, of a force constant in i: the turn of each sample, and the force seen from
    the attitude of its middle.

    R: the steady part of the attitude at the first edge, rate: its w_ci_c; wobble: amplitude,
    rad, and angular frequency, rad/s.
    """
    n = edges.shape[0] - 1
    rates, forces = np.empty((n, 3)), np.empty((n, 3))
    before = _attitude(R, rate, wobble, 0.0, edges[0])
    for k in range(n):
        dt = edges[k + 1] - edges[k]
        middle = _attitude(R, rate, wobble, edges[k] + 0.5 * dt - edges[0], edges[k] + 0.5 * dt)
        after = _attitude(R, rate, wobble, edges[k + 1] - edges[0], edges[k + 1])
        turned = so3.log(dense.transposed_matmul(before, after))
        seen = dense.transposed_matvec(middle, force_i)
        for i in range(3):
            rates[k, i], forces[k, i] = turned[i] / dt, seen[i]
        before = after
    return rates, forces


@jit
def wobbled(R: Array, wobble: Array, t: float) -> Array:
    """R_ic (3, 3) at time t, s: the steady attitude R (3, 3) with the wobble added.

    wobble (2,): amplitude, rad, and rate of its phase, rad/s.
    """
    return _attitude(R, np.zeros(3), wobble, 0.0, t)
