"""Compiled truth of two craft about an Earth that turns, with its harmonics, and Sun and Moon.

Nothing here is shared with the models of the estimators but the numbers of the field, and ERFA:
the harmonics are those of Pines 1973 (AIAA J. 11, 1508), in direction cosines and derived Legendre
functions, which know no pole either; the Earth's axes are computed at each time, not interpolated;
the integrator is Kutta's 3/8 rule.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit
from relnav_graph.constants import MU_THIRD
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.maths import dense
from relnav_graph.maths.earth import third_body, turns
from relnav_graph.maths.geopotential import geopotential

Field = tuple[float, float]  # GM, m^3/s^2, and radius, m

__all__ = ["TurningEarth", "pines_gravity"]


@jit
def pines_gravity(C: Array, S: Array, gm: float, radius: float, r_e: Array) -> Array:
    """Acceleration (3,), m/s^2, at r_e (3,), m from the Earth's centre, in Earth-fixed axes.

    C, S: (n + 1, n + 1), fully normalised, by degree and order; gm: m^3/s^2; radius: m.
    """
    top = C.shape[0] - 1
    r = dense.norm(r_e)
    s, t, u = r_e[0] / r, r_e[1] / r, r_e[2] / r
    A = np.zeros((top + 1, top + 2))  # derived Legendre functions
    A[0, 0] = 1.0
    for n in range(1, top + 1):
        A[n, n] = A[n - 1, n - 1] * np.sqrt(3.0 if n == 1 else 1.0 + 0.5 / n)
        A[n, n - 1] = u * np.sqrt(2.0 * n + 1.0) * A[n - 1, n - 1]
        for m in range(n - 1):
            d = 1.0 * (n - m) * (n + m)
            before = (2.0 * n + 1) * (n + m - 1) * (n - m - 1) / ((2.0 * n - 3) * d)
            A[n, m] = u * np.sqrt((4.0 * n * n - 1) / d) * A[n - 1, m]
            A[n, m] -= np.sqrt(before) * A[n - 2, m]
    along, out = 0.0, np.zeros(3)
    c, w, c_before, w_before = 1.0, 0.0, 0.0, 0.0  # of (s + i t)^m and of m - 1
    for m in range(top + 1):
        for n in range(m, top + 1):
            scale = (radius / r) ** n
            slope = A[n, m + 1] * np.sqrt((n - m) * (n + m + 1) * (0.5 if m == 0 else 1.0))
            here = C[n, m] * c + S[n, m] * w
            out[0] += scale * m * A[n, m] * (C[n, m] * c_before + S[n, m] * w_before)
            out[1] += scale * m * A[n, m] * (S[n, m] * c_before - C[n, m] * w_before)
            out[2] += scale * slope * here
            along -= scale * here * ((n + m + 1) * A[n, m] + u * slope)
        c, w, c_before, w_before = s * c - t * w, s * w + t * c, c, w
    for i in range(3):
        out[i] = gm / (r * r) * (out[i] + along * r_e[i] / r)
    return out


@jit
def _slope(
    y: Array, held: Array, R_ie: Array, bodies: Array, mu: Array, C: Array, S: Array, field: Field
) -> Array:
    out = np.empty(12)
    for first in (0, 6):
        r = dense.vector_at(y, first)
        g = dense.matvec(
            R_ie, pines_gravity(C, S, field[0], field[1], dense.transposed_matvec(R_ie, r))
        )
        for k in range(2):
            if mu[k] > 0.0:
                away = dense.add_scaled_vector(bodies[k], r, -1.0)
                near, far = mu[k] / dense.norm(away) ** 3, mu[k] / dense.norm(bodies[k]) ** 3
                for i in range(3):
                    g[i] += near * away[i] - far * bodies[k, i]
        for i in range(3):
            out[first + i] = y[first + 3 + i]
            out[first + 3 + i] = g[i] + held[first // 2 + i]
    return out


@jit
def _fly(
    y: Array,
    held: Array,
    h: float,
    R_ie: Array,
    bodies: Array,
    mu: Array,
    C: Array,
    S: Array,
    field: Field,
) -> Array:
    """The state y (12,) after steps of h seconds; R_ie (3 steps + 1, 3, 3) and bodies (..., 2, 3):
    at each third of a step."""
    for n in range(0, R_ie.shape[0] - 1, 3):
        give_way(n)
        k1 = _slope(y, held, R_ie[n], bodies[n], mu, C, S, field)
        k2 = _slope(y + h / 3 * k1, held, R_ie[n + 1], bodies[n + 1], mu, C, S, field)
        k3 = _slope(y + h * (k2 - k1 / 3), held, R_ie[n + 2], bodies[n + 2], mu, C, S, field)
        k4 = _slope(y + h * (k1 - k2 + k3), held, R_ie[n + 3], bodies[n + 3], mu, C, S, field)
        y = y + h / 8 * (k1 + 3 * k2 + 3 * k3 + k4)
    return y


class TurningEarth:
    """Gravity of the Earth as it turns, to a degree and order, and of third bodies.

    Raises InputError on a field that there is not, or on a clock that cannot be used.
    """

    def __init__(
        self, degree: int, order: int, third_bodies: tuple[str, ...], clock: AbsoluteTime
    ) -> None:
        field = geopotential()
        self._clock = clock
        self._C, self._S = field.upto(degree, order)
        self._field = field.gm, field.radius
        self._mu = np.array([mu if n in third_bodies else 0.0 for n, mu in MU_THIRD.items()])

    def fly(self, y: Array, held: Array, t: float, h: float, steps: int) -> Array:
        """The state y (12,), SI, of target and chaser after `steps` steps of h seconds from time t.

        held (6,): constant accelerations of both besides gravity, m/s^2, in i.
        Raises InputError on times that the Earth's orientation is not known for.
        """
        times = t + h / 3 * np.arange(3 * steps + 1, dtype=np.float64)
        R_ie, _ = turns(self._clock.begin, times, self._clock.table)
        bodies = np.zeros((len(times), 2, 3))
        for k, name in enumerate(MU_THIRD):
            if self._mu[k] > 0:
                bodies[:, k] = third_body(name, self._clock.begin, times)
        R_ie = np.ascontiguousarray(R_ie)
        return _fly(y, held, h, R_ie, bodies, self._mu, self._C, self._S, self._field)
