"""Two-body motion with universal variables: any conic, and its transition matrices.

An orbit travels to the kernels as an array (5,): semilatus rectum p (m), eccentricity, true
anomaly at the epoch (rad), mu (m^3/s^2), the epoch (s). Zeros stand for no orbit: a frame o
that does not rotate; zeros but for mu for one that is estimated, and stands in the state.

Sources: Battin 1999, ch. 4 (universal functions) and eqs. 9.84-9.87 (transition matrix);
Conway 1986 (Laguerre's method for Kepler's equation); tests/faults/test_orbits.py holds all of
it against 50 digits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
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
    """Orbit of the target, known to the estimator unless it is estimated.

    semi_major_axis: m, negative for a hyperbola; eccentricity; true_anomaly: rad, at the
    epoch; mu: m^3/s^2; epoch: s, the time, in the pass's clock, at which the anomaly holds;
    estimated: its motion in its plane stands in the state (`relnav_graph.core.catalogue.ORBIT`),
    and estimators take mu alone from here. Raises InputError on a conic that does not exist.
    """

    semi_major_axis: Annotated[float, Quantity("m")]
    eccentricity: Annotated[float, Quantity("1", nonnegative=True)] = 0.0
    true_anomaly: Annotated[float, Quantity("rad")] = 0.0
    mu: Annotated[float, Quantity("m^3/s^2", positive=True)] = MU_EARTH
    epoch: Annotated[float, Quantity("s")] = 0.0
    estimated: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        check_fields(self)
        a, e = self.semi_major_axis, self.eccentricity
        if not 0 < a * (1 - e) * (1 + e) < np.inf:
            raise InputError(
                f"orbit: found semi_major_axis {a} m with eccentricity {e}, expected a > 0"
                " for an ellipse or a < 0 for a hyperbola"
            )
        if not 1 + e * np.cos(self.true_anomaly) > 0:
            raise InputError(f"orbit: true_anomaly {self.true_anomaly} rad is beyond the asymptote")

    def array(self) -> Array:
        """(5,), SI and rad, in the order that the head of this module says."""
        if self.estimated:
            return np.array([0.0, 0.0, 0.0, self.mu, 0.0])
        a, e = Fraction(self.semi_major_axis), Fraction(self.eccentricity)
        p = float(a * (1 - e * e))  # rounded once: 1 - e^2 loses digits as e nears 1
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
def _half(alpha: float, chi: float) -> tuple[float, float, float]:
    """U_0 and U_1 at half of chi, and U_3 at chi: the others follow from these without loss.

    ``U_n = chi^n c_n(alpha chi^2)``. alpha: 1 / semi-major axis, 1/m; chi: m^(1/2). Returns
    numbers without unit, in m^(1/2) and in m^(3/2).
    """
    z, root = alpha * chi * chi, np.sqrt(abs(alpha))
    angle = 0.5 * root * chi
    if alpha > 0.0:
        c, s = np.cos(angle), np.sin(angle) / root
    elif alpha < 0.0:
        c, s = np.cosh(angle), np.sinh(angle) / root
    else:
        c, s = 1.0, 0.5 * chi
    if abs(z) > 1.0:
        return c, s, (chi - 2 * s * c) / alpha
    series = 1.0
    for k in range(8, 0, -1):
        series = 1.0 - series * z * (1.0 / ((2 * k + 2) * (2 * k + 3)))
    return c, s, chi * chi * chi * series / 6


@jit
def _bracket(r0: float, sigma0: float, alpha: float, s: float) -> tuple[float, float, float]:
    """Bounds of the universal anomaly, and where to begin, m^(1/2).

    r0, sigma0, alpha, s: as of `universal_anomaly`, s > 0.

    s is the integral of the radius over chi. On an ellipse ``r = a (1 - e cos E)`` bounds it; else
    it is least for the stretch chi about perigee: ``s > chi^3 / 24``. It begins with one step of
    Laguerre's from chi = 0, far out on a hyperbola with ``e sinh F = M + e sinh F_0 + psi`` of
    the largest psi = chi / sqrt(a).
    """
    root = np.sqrt(abs(alpha))
    mean, sigma, rest = s * root * root * root, sigma0 * root, 1 - alpha * r0
    begin = 5 * s / (r0 + np.sqrt(abs(16 * r0 * r0 + 20 * s * sigma0)))
    if alpha > 0.0:
        spread = np.sqrt(rest * rest + sigma * sigma) + 1e-9 * (1 + mean)
        low, high = max(mean - sigma - spread, 0.0) / root, (mean - sigma + spread) / root
    else:
        low, high = 0.0, 1.001 * (24 * s) ** (1 / 3)
        if root * high > 1.0:
            e = np.sqrt(max(rest * rest - sigma * sigma, 1.0))
            far = np.arcsinh((mean + sigma + root * high) / e) - np.arcsinh(sigma / e)
            begin = min(begin, far / root)
    return low, high, min(max(begin, low), high)


@jit
def universal_anomaly(r0: float, sigma0: float, alpha: float, s: float) -> float:
    """The universal anomaly chi, m^(1/2), of Kepler's equation ``r0 U1 + sigma0 U2 + U3 = s``.

    r0: radius, m; sigma0: ``r0 . v0 / sqrt(mu)``, m^(1/2); alpha: 1 / semi-major axis, 1/m; s:
    ``sqrt(mu) dt``, m^(3/2), on an ellipse that of less than a turn. NaN where these are not
    finite or belong to no orbit.

    Laguerre's method, n = 5, between bounds that every step tightens: one that would leave them,
    or is no shorter than half the last but one, halves them instead. The left side rises with the
    radius as its slope, so that this cannot end anywhere but at the root.
    """
    if s == 0.0:
        return 0.0
    sign = 1.0 if s > 0.0 else -1.0
    s, sigma0 = abs(s), sign * sigma0
    low, high, chi = _bracket(r0, sigma0, alpha, s)
    last = before = high - low
    for _ in range(200):
        c, h, u3 = _half(alpha, chi)
        u1, u2 = 2 * h * c, 2 * h * h
        u0 = 1 - alpha * u2
        f = r0 * u1 + sigma0 * u2 + u3 - s
        low, high = (chi, high) if f <= 0.0 else (low, chi)  # NaN: beyond what floats hold
        slope = r0 * u0 + sigma0 * u1 + u2
        curve = sigma0 * u0 + (1 - alpha * r0) * u1
        step = 5 * f / (slope + np.sqrt(abs(16 * slope * slope - 20 * f * curve)))
        if abs(step) <= 1e-7 * chi:  # of third order: the next step is below rounding
            return float(sign * (chi - step))
        if not (low < chi - step < high and abs(step) < 0.5 * before):
            step = chi - (low + 0.5 * (high - low))
        before, last = last, abs(step)
        chi -= step
    return np.nan


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
    s, whole = root * dt, 0.0
    if alpha > 0.0:
        turn = 2 * np.pi / (alpha * np.sqrt(alpha))
        if abs(s) > 0.5 * turn:
            whole = np.rint(s / turn)
            s -= whole * turn
    chi = universal_anomaly(n0, sigma0, alpha, s)
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
    cc = 3 * u5 - chi * u4 - s * u2
    if whole != 0.0:  # what grows with the turns: the period depends on the energy
        cc -= 6 * np.pi * whole / (alpha * alpha * np.sqrt(alpha))
    cc /= root
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
def _product(a: float, b: float) -> tuple[float, float]:
    """a b, rounded, and what the rounding took away (Dekker 1971)."""
    big_a, big_b = 134217729.0 * a, 134217729.0 * b
    a1, b1 = big_a - (big_a - a), big_b - (big_b - b)
    a2, b2 = a - a1, b - b1
    out = a * b
    return out, ((a1 * b1 - out) + a1 * b2 + a2 * b1) + a2 * b2


@jit
def mean_anomaly_since(orbit: Array, t: float) -> float:
    """``n t`` less whole turns, rad, on an ellipse: as exact as the numbers of the orbit allow.

    orbit: (5,), see the head of this module; t: s since its epoch. NaN where n t has no digits
    left for an angle.

    A rounding of n would count a thousandfold: by n t, and by how fast a perigee is passed. So all
    roundings of ``n^2 = mu (1 - e^2)^3 / p^3`` and of n t are carried along.
    """
    p, e, mu = orbit[0], orbit[1], orbit[3]
    square, d_square = _product(e, e)
    x = 1 - square
    dx = ((1 - x) - square) - d_square
    q = x / p  # 1 / a
    back, d_back = _product(q, p)
    dq = ((x - back) - d_back + dx) / p
    q2, d2 = _product(q, q)
    d2 += 2 * q * dq
    q3, d3 = _product(q2, q)
    d3 += d2 * q + q2 * dq
    n2, dn2 = _product(mu, q3)
    dn2 += mu * d3
    n = np.sqrt(n2)
    back, d_back = _product(n, n)
    dn = ((n2 - back) - d_back + dn2) / (2 * n)
    angle, d_angle = _product(n, t)
    whole = np.rint(angle / (2 * np.pi))
    if not abs(whole) < 1e15:
        return np.nan
    turned, d_turned = _product(whole, 2 * np.pi)
    rest = 2.4492935982947064e-16  # 2 pi less the number np.pi * 2
    return float((angle - turned) - d_turned + d_angle + dn * t - whole * rest)


@jit
def chief_motion(orbit: Array, t: float) -> Array:
    """Motion of the target along its orbit at time t.

    orbit: (5,), see the head of this module; t: s. Returns (5,): radius r (m), r' (m/s), true
    anomaly (rad), its rate (rad/s) and acceleration (rad/s^2); zeros where there is no orbit, NaN
    where floats cannot tell: times of 1e15 turns.

    Lengths are counted in |a| and times so that mu is 1. With U_0 and U_1 at half the universal
    anomaly, ``A = r0 U_0 + sigma0 U_1`` and ``B = sqrt(p) U_1`` are the square root of the
    position as a complex number, times sqrt(r0), in the axes of the epoch (Levi-Civita 1920): no
    digits are lost to differences.
    """
    p, e, theta0, mu = orbit[0], orbit[1], orbit[2], orbit[3]
    out = np.zeros(5)
    if mu == 0.0:
        return out
    t -= orbit[4]
    x = (1 - e) * (1 + e)
    alpha, p_a = (1.0 if x > 0.0 else -1.0), abs(x)
    a = p / p_a
    n = np.sqrt(mu / a) / a
    c, s = np.cos(0.5 * theta0), np.sin(0.5 * theta0)
    below = (1 + e) * c * c + (1 - e) * s * s  # 1 + e cos(theta0)
    r0, sigma0 = p_a / below, np.sqrt(p_a) * e * 2 * s * c / below
    since = mean_anomaly_since(orbit, t) if x > 0.0 else n * t
    chi = universal_anomaly(r0, sigma0, alpha, since)
    c, s, _ = _half(alpha, chi)
    along, across = r0 * c + sigma0 * s, np.sqrt(p_a) * s
    radius = (along * along + across * across) / r0
    outward = sigma0 * (1 - 2 * alpha * s * s) + (1 - alpha * r0) * 2 * s * c
    out[0] = a * radius
    out[1] = n * a * outward / radius
    out[2] = theta0 + 2 * np.arctan2(across, along)
    out[3] = n * np.sqrt(p_a) / (radius * radius)
    out[4] = -2 * out[1] * out[3] / out[0]
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
