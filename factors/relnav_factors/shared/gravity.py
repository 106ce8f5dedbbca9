"""Gravity of the Earth with zonal harmonics.

The field travels to the kernels as an array (5,): mu (m^3/s^2), equatorial radius (m),
J2, J3, J4; its axis is z of the inertial frame.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.constants import EARTH_RADIUS, MU_EARTH, ZONAL_EARTH
from relnav_graph.maths import dense

#: Highest degree of the zonal harmonics of a field; 0 for that of a sphere.
Degree = Literal[0, 2, 3, 4]
FIELD = 5


def earth_field(degree: int) -> Array:
    """The Earth's field up to a degree, (5,): mu (m^3/s^2), equatorial radius (m), J2, J3, J4."""
    zonal = [J if n <= degree else 0.0 for n, J in zip((2, 3, 4), ZONAL_EARTH, strict=True)]
    return np.array([MU_EARTH, EARTH_RADIUS, *zonal])


@jit
def _legendre(s: float) -> tuple[Array, Array]:
    """First and second derivatives of the Legendre polynomials P_0 to P_5 at s, (6,)."""
    first, second = np.zeros(6), np.zeros(6)
    first[1], first[2], first[3] = 1.0, 3 * s, 7.5 * s * s - 1.5
    first[4] = s * (17.5 * s * s - 7.5)
    first[5] = (s * s * (315 * s * s - 210) + 15) / 8
    second[2], second[3] = 3.0, 15 * s
    second[4] = 52.5 * s * s - 7.5
    second[5] = s * (157.5 * s * s - 52.5)
    return first, second


@jit
def zonal_gravity(p: Array, r_i: Array, lowest: int) -> tuple[Array, Array]:
    """Acceleration (3,), m/s^2, and its gradient (3, 3), 1/s^2, of the degrees from `lowest`.

    p: starts with the field (5,); r_i: (3,), m, from the Earth's centre in i.

    Each degree n of the force function, -mu J_n R^n r^-(n+1) P_n(s) with s = z / r, gives mu J_n
    R^n r^-(n+2) (P'_n+1(s) r_i / r - P'_n(s) z); J_0 = -1 is the sphere's (Vallado 2013, section
    8.6; written with P'_n+1 = (n + 1) P_n + s P'_n).
    """
    r = dense.norm(r_i)
    n_i, z_i, across = r_i / r, np.zeros(3), np.empty(3)
    z_i[2] = 1.0
    first, second = _legendre(n_i[2])
    for i in range(3):
        across[i] = z_i[i] - n_i[2] * n_i[i]  # r times the gradient of s
    g, G = np.zeros(3), np.zeros((3, 3))
    for n in range(lowest, 5):
        J = -1.0 if n == 0 else 0.0 if n == 1 else p[n]
        if J == 0.0:
            continue
        scale = p[0] * J * (p[1] / r) ** n / (r * r)
        for i in range(3):
            g[i] += scale * (first[n + 1] * n_i[i] - first[n] * z_i[i])
            G[i, i] += scale / r * first[n + 1]
            for j in range(3):
                radial = second[n + 1] * across[j] - (n + 3) * first[n + 1] * n_i[j]
                polar = second[n] * across[j] - (n + 2) * first[n] * n_i[j]
                G[i, j] += scale / r * (n_i[i] * radial - z_i[i] * polar)
    return g, G


@jit
def gravity_difference(p: Array, r_c: Array, r_tc: Array) -> tuple[Array, Array, Array]:
    """``g(r_c) - g(r_c - r_tc)`` (3,), m/s^2, and its Jacobians to r_tc and to r_c, (3, 3) each.

    p: starts with the field (5,); r_c, r_tc: (3,), m, in i.

    The sphere's part in Battin's form (1999, eq. 8.61), which loses no digits however small the
    separation; the harmonics' part is small enough to be subtracted.
    """
    r_t = dense.add_scaled_vector(r_c, r_tc, -1.0)
    s, q, distance2 = 0.0, 0.0, 0.0
    for i in range(3):
        s += r_c[i] ** 2
        q += r_tc[i] * (r_tc[i] - 2 * r_c[i])
        distance2 += r_t[i] ** 2
    q /= s
    stretch = q * (3 + q * (3 + q)) / (1 + (1 + q) ** 1.5)
    pull = p[0] / (distance2 * np.sqrt(distance2))
    out = dense.add_scaled_vector(zonal_gravity(p, r_c, 2)[0], zonal_gravity(p, r_t, 2)[0], -1.0)
    for i in range(3):
        out[i] -= pull * (r_tc[i] + stretch * r_c[i])
    _, G_c = zonal_gravity(p, r_c, 0)
    _, G_t = zonal_gravity(p, r_t, 0)
    return out, G_t, dense.add_scaled(G_c, G_t, -1.0)
