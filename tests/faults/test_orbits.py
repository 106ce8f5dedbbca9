"""Orbits far from their epoch, and far out: against values of 50 digits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpf

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.maths.orbit import (
    KeplerOrbit,
    chief_motion,
    frame_rotation,
    relative_transition,
    two_body,
)

EPS = float(np.finfo(float).eps)
CENTURY = 100 * 365.25 * 86400


def exact(orbit: Array, t: float) -> tuple[Any, Any, Any, Any]:
    """Radius, true anomaly, slope d(anomaly) / d(n t) and n t, to 50 digits, of an orbit (4,)."""
    p, e, theta, mu, epoch, t = (mpf(float(v)) for v in (*orbit, t))
    t -= epoch
    x = 1 - e * e
    a = p / abs(x)
    n, root = mp.sqrt(mu / a**3), mp.sqrt(abs(1 - e) / (1 + e))
    if x > 0:
        first = 2 * mp.atan2(root * mp.sin(theta / 2), mp.cos(theta / 2))
        mean = first - e * mp.sin(first) + n * t
        mean -= 2 * mp.pi * mp.nint(mean / (2 * mp.pi))
        low, high = mean - 1, mean + 1
    else:
        first = 2 * mp.atanh(root * mp.tan(theta / 2))
        mean = e * mp.sinh(first) - first + n * t
        high = mp.asinh(abs(mean) / (e - 1)) + 1
        low = -high

    def at(y: Any) -> tuple[Any, Any]:
        """Mean anomaly and its slope, the radius, of an eccentric one."""
        if x > 0:
            return y - e * mp.sin(y), 1 - e * mp.cos(y)
        return e * mp.sinh(y) - y, e * mp.cosh(y) - 1

    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if at(middle)[0] > mean else (middle, high)
    for _ in range(4):
        value, radius = at(low)
        low -= (value - mean) / radius
    radius = at(low)[1]
    if x > 0:
        anomaly = 2 * mp.atan2(mp.sin(low / 2), root * mp.cos(low / 2))
    else:
        anomaly = 2 * mp.atan(mp.tanh(low / 2) / root)
    return a * radius, anomaly, mp.sqrt(abs(x)) / radius**2, n * t


def apart(a: float, b: Any) -> float:
    """The angle between two anomalies, rad, whole turns aside."""
    d = mpf(float(a)) - b
    return abs(float(d - 2 * mp.pi * mp.nint(d / (2 * mp.pi))))


def ellipse(rng: np.random.Generator) -> KeplerOrbit:
    e = rng.choice([rng.uniform(0, 0.99), 0.0, 0.9, 0.99])
    theta = rng.choice([rng.uniform(-np.pi, np.pi), 0.0, np.pi])
    return KeplerOrbit(10 ** rng.uniform(6.8, 8) / (1 - e), float(e), float(theta))


def hyperbola(rng: np.random.Generator) -> KeplerOrbit:
    """About the Earth, the Sun, a comet or a boulder."""
    e = float(1 + 10 ** rng.uniform(-2, np.log10(299)))
    theta = 0.999 * rng.uniform(-1, 1) * np.arccos(-1 / e)
    mu = float(rng.choice([MU_EARTH, 1.327e20, 667.0, 1e-6]))
    return KeplerOrbit(-(10 ** rng.uniform(2, 8)) / (e - 1), e, float(theta), mu)


def period(orbit: KeplerOrbit) -> float:
    return float(2 * np.pi * np.sqrt(orbit.semi_major_axis**3 / orbit.mu))


def position_error(orbit: KeplerOrbit, t: float) -> tuple[float, float]:
    """Error of the position beside the distance, and that distance in perigee radii."""
    got, (r, anomaly, _, _) = chief_motion(orbit.array(), t), exact(orbit.array(), t)
    perigee = orbit.array()[0] / (1 + orbit.eccentricity)
    off = np.hypot(float((mpf(float(got[0])) - r) / r), apart(got[2], anomaly))
    return float(off), float(r) / perigee


@pytest.fixture(autouse=True)
def fifty_digits() -> Any:
    with mp.workdps(50):
        yield


def test_row_39_ellipses_within_a_revolution() -> None:
    """Half of the times near a perigee, where the anomaly runs fastest."""
    rng = np.random.default_rng(39)
    for _ in range(100):
        orbit = ellipse(rng)
        e, T = orbit.eccentricity, period(orbit)
        E = 2 * np.arctan(np.sqrt((1 - e) / (1 + e)) * np.tan(orbit.true_anomaly / 2))
        perigee = -(E - e * np.sin(E)) / (2 * np.pi) * T
        near = perigee + rng.choice([-1, 1]) * 10 ** rng.uniform(-9, -2) * T
        for t in (rng.uniform(-T, T), near):
            got, (r, anomaly, slope, _) = chief_motion(orbit.array(), t), exact(orbit.array(), t)
            assert apart(got[2], anomaly) < 1e-12, (orbit, t)
            assert got[0] == pytest.approx(float(r), rel=1e-12)
            assert got[3] == pytest.approx(float(slope) * 2 * np.pi / T, rel=2e-12)


def test_row_39_ellipses_over_a_century() -> None:
    rng = np.random.default_rng(40)
    for _ in range(100):
        orbit, t = ellipse(rng), rng.choice([-1, 1]) * CENTURY ** rng.uniform(0.5, 1)
        got, (_, anomaly, slope, turned) = chief_motion(orbit.array(), t), exact(orbit.array(), t)
        limit = 4 * EPS * (1 + abs(float(turned))) * float(slope)
        assert apart(got[2], anomaly) < max(limit, 1e-12), (orbit, t)


def test_row_39_hyperbolas_and_flybys() -> None:
    """Far out, too: a century from the Earth is 1e6 perigee radii and more."""
    rng = np.random.default_rng(41)
    near = 0
    for _ in range(100):
        orbit, t = hyperbola(rng), rng.choice([-1, 1]) * CENTURY ** rng.uniform(0, 1)
        error, distance = position_error(orbit, t)
        near += distance < 1e3
        assert error < 1e-9, (orbit, t, distance)
    assert near > 20


@pytest.mark.parametrize("e", [1 - 1e-3, 1 - 1e-9, 1 - 1e-14, 1 + 1e-14, 1 + 1e-9, 1 + 1e-3])
@pytest.mark.parametrize("mu", [MU_EARTH, 1e-6])
def test_row_39_next_to_a_parabola(e: float, mu: float) -> None:
    orbit = KeplerOrbit(7e6 / (1 - e), e, 0.4, mu)
    for t in np.geomspace(1e-3, CENTURY, 12):
        for sign in (-1, 1):
            _, _, slope, turned = exact(orbit.array(), sign * t)
            limit = 4 * EPS * (1 + abs(float(turned))) * float(slope) if e < 1 else 0.0
            assert position_error(orbit, sign * t)[0] < max(limit, 1e-11), (t, sign)


@pytest.mark.parametrize("t", [0.0, 1e9, 1.8e9])
def test_row_39_motion_over_ten_seconds_is_the_same_at_any_time(t: float) -> None:
    """GPS and Unix seconds: the orbit given for that time, and one given for t = 0."""
    orbit = KeplerOrbit(4.0e7, 0.7, 0.5)
    at = float(exact(orbit.array(), t)[1])
    there = KeplerOrbit(4.0e7, 0.7, at)
    for f, size in ((relative_transition, 1.0), (frame_rotation, 1.0)):
        got, want = f(orbit.array(), t, t + 10.0), f(there.array(), 0.0, 10.0)
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("turns", [0.4, 3.3, -3.3, 700.0])
def test_row_39_transition_matrix_over_many_revolutions(turns: float) -> None:
    """Against differences of two_body itself, whose position is held against `exact` above."""
    p, e, _, mu, _ = KeplerOrbit(4.0e7, 0.3).array()
    r, v = np.array([p / (1 + e), 0, 0]), np.array([0, np.sqrt(mu / p) * (1 + e), 0])
    t = turns * period(KeplerOrbit(4.0e7, 0.3))
    scale = np.array([4e7] * 3 + [4e3] * 3)
    y, phi = np.array([*r, *v]), two_body(r, v, mu, t)[2]
    for j in range(6):
        step = np.zeros(6)
        step[j] = 1e-7 * scale[j] / (1 + abs(turns))
        ahead, back = (
            np.concatenate(two_body((y + s)[:3], (y + s)[3:], mu, t)[:2]) for s in (step, -step)
        )
        slope = (ahead - back) / (2 * step[j])
        size = np.abs(phi / scale[:, None] * scale).max()
        np.testing.assert_allclose(
            slope / scale * scale[j], phi[:, j] / scale * scale[j], rtol=0, atol=1e-6 * size
        )


def test_row_39_two_body_far_out_on_a_hyperbola() -> None:
    rng = np.random.default_rng(42)
    for _ in range(50):
        orbit = hyperbola(rng)
        p, e, theta, mu, _ = orbit.array()
        axes = np.array([[np.cos(theta), np.sin(theta), 0], [-np.sin(theta), np.cos(theta), 0]])
        radial, across = (
            np.sqrt(mu / p) * e * np.sin(theta),
            np.sqrt(mu / p) * (1 + e * np.cos(theta)),
        )
        far = 1e3 * p / (1 + e)
        t = rng.choice([-1, 1]) * far / np.hypot(radial, across)
        r, v, phi = two_body(
            p / (1 + e * np.cos(theta)) * axes[0], radial * axes[0] + across * axes[1], mu, t
        )
        motion = chief_motion(orbit.array(), t)
        along = np.array([np.cos(motion[2]), np.sin(motion[2]), 0])
        np.testing.assert_allclose(r / motion[0], along, rtol=0, atol=1e-9)
        assert np.isfinite(phi).all()
        assert r @ v / motion[0] == pytest.approx(motion[1], rel=1e-9)


def test_row_39_what_floats_cannot_tell_is_nan() -> None:
    orbit = KeplerOrbit(7e6, 0.1)
    for t in (1e300, -1e300, np.inf, np.nan):
        assert np.isnan(chief_motion(orbit.array(), t)[:3]).any()
