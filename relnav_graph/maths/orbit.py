"""Two-body motion with universal variables: any conic, and its transition matrices.

An orbit travels to the kernels as an array (5,): semilatus rectum p (m), eccentricity, true
anomaly at the epoch (rad), mu (m^3/s^2), the epoch (s). Zeros stand for no orbit: a frame o
that does not rotate.

Sources: Battin 1999, ch. 4 (universal functions) and eqs. 9.84-9.87 (transition matrix);
Conway 1986 (Laguerre's method for Kepler's equation).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.constants import MU_EARTH
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity, check_fields

__all__ = ["KeplerOrbit", "chief_motion", "frame_rotation", "relative_transition", "two_body"]


@dataclass(frozen=True)
class KeplerOrbit:
    """Orbit of the target, known to the estimator.

    semi_major_axis: m, negative for a hyperbola; eccentricity; true_anomaly: rad, at the
    epoch; mu: m^3/s^2; epoch: s, the time, in the pass's clock, at which the anomaly holds.
    Raises InputError on a conic that does not exist.
    """

    semi_major_axis: Annotated[float, Quantity("m")]
    eccentricity: Annotated[float, Quantity("1", nonnegative=True)] = 0.0
    true_anomaly: Annotated[float, Quantity("rad")] = 0.0
    mu: Annotated[float, Quantity("m^3/s^2", positive=True)] = MU_EARTH
    epoch: Annotated[float, Quantity("s")] = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        a, e = self.semi_major_axis, self.eccentricity
        if not a * (1 - e * e) > 0:
            raise InputError(
                f"orbit: found semi_major_axis {a} m with eccentricity {e}, expected a > 0"
                " for an ellipse or a < 0 for a hyperbola"
            )
        if not 1 + e * np.cos(self.true_anomaly) > 0:
            raise InputError(f"orbit: true_anomaly {self.true_anomaly} rad is beyond the asymptote")

    def array(self) -> Array:
        """(5,), SI and rad, in the order that the head of this module says."""
        p = self.semi_major_axis * (1 - self.eccentricity**2)
        return np.array([p, self.eccentricity, self.true_anomaly, self.mu, self.epoch])

    def revolutions(self, t: float) -> float:
        """How many revolutions time t, s, is from the epoch, of either sign.

        On a hyperbola, which has none: how often it would go round at perigee, with the radius
        and the speed there.
        """
        a, e = self.semi_major_axis, self.eccentricity
        perigee = a * (1 - e)
        rate = np.sqrt(self.mu / a) / a if e < 1 else np.sqrt(self.mu * (1 + e) / perigee) / perigee
        return float((t - self.epoch) * rate / (2 * np.pi))


def orbit_array(orbit: KeplerOrbit | None) -> Array:
    """The orbit as kernels take it; zeros for None: a frame o that does not rotate.

    Returns (5,), SI and rad, in the order that the head of this module says.
    """
    return np.zeros(5) if orbit is None else orbit.array()


@jit
def stumpff(z: float) -> Array:
    """Stumpff functions c_0 to c_5, ``c_n(z) = sum over k of (-z)^k / (n + 2 k)!``.

    z: the square of the change of eccentric anomaly, rad^2; below 0 on a hyperbola. Returns (6,).
    """
    c = np.empty(6)
    if abs(z) < 4.0:  # for larger |z| the closed forms lose at most two digits to cancellation
        for n in (4, 5):
            term = 1 / 24.0 if n == 4 else 1 / 120.0
            c[n] = term
            for k in range(1, 20):
                term *= -z / ((n + 2 * k - 1) * (n + 2 * k))
                c[n] += term
                if abs(term) < 1e-20:
                    break
        c[3], c[2] = 1 / 6.0 - z * c[5], 0.5 - z * c[4]
        c[1], c[0] = 1.0 - z * c[3], 1.0 - z * c[2]
        return c
    s = np.sqrt(abs(z))
    if z > 0:
        c[0], c[1] = np.cos(s), np.sin(s) / s
    else:
        c[0], c[1] = np.cosh(s), np.sinh(s) / s
    c[2], c[3] = (1 - c[0]) / z, (1 - c[1]) / z
    c[4], c[5] = (0.5 - c[2]) / z, (1 / 6.0 - c[3]) / z
    return c


@jit
def _universal_anomaly(r0: float, sigma0: float, alpha: float, s: float) -> float:
    """The universal anomaly chi, m^(1/2): ``r0 U1 + sigma0 U2 + U3 = s``. Laguerre, n = 5.

    ``U_n = chi^n c_n(alpha chi^2)``. r0: radius, m; sigma0: ``r0 . v0 / sqrt(mu)``, m^(1/2);
    alpha: 1 / semi-major axis, 1/m; s: ``sqrt(mu) dt``, m^(3/2).
    """
    chi = s * alpha if alpha > 0 else s / r0
    for _ in range(60):
        c = stumpff(alpha * chi * chi)
        u1, u2, u3 = chi * c[1], chi**2 * c[2], chi**3 * c[3]
        f = r0 * u1 + sigma0 * u2 + u3 - s
        slope = r0 * c[0] + sigma0 * u1 + u2
        curve = sigma0 * c[0] + (1 - alpha * r0) * u1
        root = np.sqrt(abs(16 * slope * slope - 20 * f * curve))
        step = 5 * f / (slope + (root if slope > 0 else -root))
        chi -= step
        if abs(step) <= 1e-6 * abs(chi):  # cubic convergence: chi is now exact to rounding
            break
    return chi


@jit
def two_body(r0: Array, v0: Array, mu: float, dt: float) -> tuple[Array, Array, Array]:
    """Position and velocity after dt in an inertial frame, and their transition matrix.

    r0: (3,), m; v0: (3,), m/s; mu: m^3/s^2; dt: s. Returns r (3,), m; v (3,), m/s; and
    ``d(r, v) / d(r0, v0)`` (6, 6), SI. Battin 1999, eqs. 4.84 and 9.84-9.87.
    """
    n0 = dense.norm(r0)
    root = np.sqrt(mu)
    sigma0 = (r0[0] * v0[0] + r0[1] * v0[1] + r0[2] * v0[2]) / root
    alpha = 2 / n0 - (v0[0] ** 2 + v0[1] ** 2 + v0[2] ** 2) / mu
    chi = _universal_anomaly(n0, sigma0, alpha, root * dt)
    c = stumpff(alpha * chi * chi)
    u1, u2 = chi * c[1], chi**2 * c[2]
    u4, u5 = chi**4 * c[4], chi**5 * c[5]
    n1 = n0 * c[0] + sigma0 * u1 + u2
    f, g = 1 - u2 / n0, (n0 * u1 + sigma0 * u2) / root
    ft, gt = -root * u1 / (n0 * n1), 1 - u2 / n1
    r, v, dr, dv = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        r[i], v[i] = f * r0[i] + g * v0[i], ft * r0[i] + gt * v0[i]
        dr[i], dv[i] = r[i] - r0[i], v[i] - v0[i]
    cc = (3 * u5 - chi * u4 - root * dt * u2) / root
    phi = np.zeros((6, 6))
    for i in range(3):
        for j in range(3):
            phi[i, j] = (
                n1 / mu * dv[i] * dv[j] + (n0 * (1 - f) * r[i] * r0[j] + cc * v[i] * r0[j]) / n0**3
            )
            phi[i, 3 + j] = (
                n0 / mu * (1 - f) * (dr[i] * v0[j] - dv[i] * r0[j]) + cc / mu * v[i] * v0[j]
            )
            phi[3 + i, 3 + j] = (
                n0 / mu * dv[i] * dv[j] + (n0 * (1 - f) * r[i] * r0[j] - cc * r[i] * v0[j]) / n1**3
            )
            # F_t (r v^T - v r^T) r = F_t (r (v . r) - v r^2): no matrix product needed.
            swing = r[i] * (v[0] * r[0] + v[1] * r[1] + v[2] * r[2]) - v[i] * n1 * n1
            phi[3 + i, j] = (
                -dv[i] * r0[j] / n0**2
                - r[i] * dv[j] / n1**2
                + ft * (-r[i] * r[j] / n1**2 + swing * dv[j] / (mu * n1))
                - mu * cc / (n1 * n0) ** 3 * r[i] * r0[j]
            )
        phi[i, i] += f
        phi[i, 3 + i] += g
        phi[3 + i, i] += ft
        phi[3 + i, 3 + i] += gt
    return r, v, phi


@jit
def chief_motion(orbit: Array, t: float) -> Array:
    """Motion of the target along its orbit at time t.

    orbit: (5,), see the head of this module; t: s. Returns (5,): radius r (m), r' (m/s), true
    anomaly (rad), its rate (rad/s) and acceleration (rad/s^2); zeros where there is no orbit.
    """
    p, e, theta0, mu = orbit[0], orbit[1], orbit[2], orbit[3]
    out = np.zeros(5)
    if mu == 0.0:
        return out
    t -= orbit[4]
    r0 = p / (1 + e * np.cos(theta0))
    h = np.sqrt(mu * p)
    radial0 = mu / h * e * np.sin(theta0)
    root = np.sqrt(mu)
    sigma0 = r0 * radial0 / root
    alpha = (1 - e * e) / p
    chi = _universal_anomaly(r0, sigma0, alpha, root * t)
    c = stumpff(alpha * chi * chi)
    u1, u2 = chi * c[1], chi**2 * c[2]
    radius = r0 * c[0] + sigma0 * u1 + u2
    f, g = 1 - u2 / r0, (r0 * u1 + sigma0 * u2) / root
    # Position in the axes (radial, transverse) of the epoch.
    turned = np.arctan2(g * h / r0, f * r0 + g * radial0)
    out[0] = radius
    out[1] = root * (sigma0 * c[0] + (1 - alpha * r0) * u1) / radius
    out[2] = theta0 + turned
    out[3] = h / radius**2
    out[4] = -2 * out[1] * out[3] / radius
    return out


@jit
def frame_rotation(orbit: Array, t0: float, t1: float) -> Array:
    """``R_o1o0``: takes components in o at t0 to components in o at t1.

    orbit: (5,), see the head of this module; t0, t1: s. Returns (3, 3).
    """
    turn = chief_motion(orbit, t1)[2] - chief_motion(orbit, t0)[2]
    return so3.exp(np.array([0.0, 0.0, -turn]))


@jit
def relative_transition(orbit: Array, t0: float, t1: float) -> Array:
    """Transition matrix of the separation (r_tc_o, r_tc_o') from t0 to t1, in closed form.

    orbit: (5,), see the head of this module; t0, t1: s. Returns (6, 6), for m and m/s.

    It solves the equations of relative motion on an orbit of any eccentricity, linear in the
    separation: the two-body transition matrix seen from the rotating frame o. At eccentricity
    0 it is that of Clohessy and Wiltshire. r_tc_o' is the derivative in the rotating frame.
    """
    motion0, motion1 = chief_motion(orbit, t0), chief_motion(orbit, t1)
    r0 = np.array([motion0[0], 0.0, 0.0])
    v0 = np.array([motion0[1], motion0[0] * motion0[3], 0.0])
    _, _, phi = two_body(r0, v0, orbit[3], t1 - t0)
    turn = so3.exp(np.array([0.0, 0.0, motion0[2] - motion1[2]]))
    out = np.zeros((6, 6))
    for i in range(3):
        for j in range(6):
            for k in range(3):
                out[i, j] += turn[i, k] * phi[k, j]
                out[3 + i, j] += turn[i, k] * phi[3 + k, j]
    for i in range(6):  # inertial to rotating derivative: v_i = r' + w x r, w = (0, 0, th')
        out[i, 0] += out[i, 4] * motion0[3]
        out[i, 1] -= out[i, 3] * motion0[3]
    for j in range(6):
        out[3, j] += motion1[3] * out[1, j]
        out[4, j] -= motion1[3] * out[0, j]
    return out
