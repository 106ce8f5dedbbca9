"""Two-body motion, relative motion about any orbit, and frames."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from independent import ORBITS, integrate, integrated_two_body, length, start
from scipy.integrate import solve_ivp

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.errors import InputError
from relnav_graph.maths.frames import rtn_from_inertial, xiong_from_rtn
from relnav_graph.maths.orbit import (
    KeplerOrbit,
    chief_motion,
    frame_rotation,
    relative_transition,
    stumpff,
    two_body,
)

CLOSED = [name for name in ORBITS if name != "hyperbolic"]
#: Typical size of (r, v) in m and m/s, so that blocks of a transition compare as numbers.
SCALE = np.array([7e6] * 3 + [7e3] * 3)


def scaled(phi: Array) -> Array:
    return np.asarray(phi / SCALE[:, None] * SCALE)


# Stumpff's functions.


@pytest.mark.parametrize("z", [-30.0, -4.001, -3.999, -1.0, -1e-9, 0.0, 1e-9, 2.5, 3.999])
def test_stumpff_equals_its_series(z: float) -> None:
    want = [sum((-z) ** k / factorial(n + 2 * k) for k in range(60)) for n in range(6)]
    np.testing.assert_allclose(stumpff(z), want, rtol=1e-13)


@pytest.mark.parametrize("z", [4.001, 9.0, 40.0, 400.0])
def test_stumpff_recurrence_and_trigonometric_forms(z: float) -> None:
    """c_n = 1 / n! - z c_(n+2), and 2 c_2 = c_1(z / 4)^2."""
    c, quarter = stumpff(z), stumpff(z / 4)
    np.testing.assert_allclose(c[:2], [np.cos(z**0.5), np.sin(z**0.5) / z**0.5], atol=1e-15)
    for n in range(4):
        assert c[n] == pytest.approx(1 / factorial(n) - z * c[n + 2], abs=1e-14 * (1 + z))
    assert c[2] == pytest.approx(0.5 * quarter[1] ** 2, abs=1e-15)


@pytest.mark.parametrize("z", [-4.0, 4.0])
def test_stumpff_does_not_jump_where_the_method_changes(z: float) -> None:
    inside, outside = stumpff(z * (1 - 1e-15)), stumpff(z * (1 + 1e-15))
    np.testing.assert_allclose(inside, outside, rtol=0, atol=3e-14)


# Motion of the two bodies.


@pytest.mark.parametrize("name", ORBITS)
@pytest.mark.parametrize("dt", [-4000.0, 0.0, 1e-3, 10.0, 5000.0])
def test_two_body_agrees_with_integration(name: str, dt: float) -> None:
    r0, v0 = start(ORBITS[name])
    want = integrated_two_body(r0, v0, dt)
    r, v, _ = two_body(r0, v0, MU_EARTH, dt)
    np.testing.assert_allclose(r, want[:3], rtol=0, atol=2e-11 * length(want[:3]))
    np.testing.assert_allclose(v, want[3:], rtol=0, atol=2e-11 * length(want[3:]))


@pytest.mark.parametrize("name", ORBITS)
@pytest.mark.parametrize("dt", [0.1, 700.0, 5000.0])
def test_two_body_transition_agrees_with_the_variational_equations(name: str, dt: float) -> None:
    r0, v0 = start(ORBITS[name])

    def variational(t: float, y: Array) -> Array:
        r, phi = y[:3] * SCALE[0], y[6:].reshape(6, 6)
        n = length(r)
        gradient = MU_EARTH / n**3 * (3 * np.outer(r, r) / n**2 - np.eye(3))
        dynamics = np.zeros((6, 6))
        dynamics[:3, 3:], dynamics[3:, :3] = np.eye(3), gradient
        v_dot = -MU_EARTH * r / n**3
        flow = np.concatenate([y[3:6] * SCALE[3] / SCALE[0], v_dot / SCALE[3]])
        return np.concatenate([flow, (dynamics / SCALE[:, None] * SCALE @ phi).ravel()])

    y = integrate(
        variational, 0, dt, np.array([*(r0 / SCALE[0]), *(v0 / SCALE[3]), *np.eye(6).flat])
    )
    want = y[6:].reshape(6, 6)
    _, _, phi = two_body(r0, v0, MU_EARTH, dt)
    np.testing.assert_allclose(scaled(phi), want, rtol=0, atol=1e-10 * np.abs(want).max())


@pytest.mark.parametrize("name", ORBITS)
def test_two_body_transition_agrees_with_differences(name: str) -> None:
    r0, v0 = start(ORBITS[name])
    _, _, phi = two_body(r0, v0, MU_EARTH, 3000.0)
    y0, numeric = np.concatenate([r0, v0]), np.empty((6, 6))
    for j in range(6):
        step = np.zeros(6)
        step[j] = 1e-5 * SCALE[j]
        ahead, back = (
            np.concatenate(two_body((y0 + s * step)[:3], (y0 + s * step)[3:], MU_EARTH, 3000.0)[:2])
            for s in (1, -1)
        )
        numeric[:, j] = (ahead - back) / (2 * step[j])
    np.testing.assert_allclose(
        scaled(phi), scaled(numeric), rtol=0, atol=1e-6 * np.abs(scaled(phi)).max()
    )


@pytest.mark.parametrize("name", ORBITS)
@pytest.mark.parametrize("dt", [-2500.0, 1.0, 2500.0])
def test_two_body_transition_is_symplectic_and_invertible(name: str, dt: float) -> None:
    r0, v0 = start(ORBITS[name])
    r, v, phi = two_body(r0, v0, MU_EARTH, dt)
    r_back, v_back, inverse = two_body(r, v, MU_EARTH, -dt)
    J = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    phi, inverse = scaled(phi), scaled(inverse)
    size = np.abs(phi).max() ** 2
    np.testing.assert_allclose(phi.T @ J @ phi, J, rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(inverse @ phi, np.eye(6), rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(r_back, r0, rtol=0, atol=1e-11 * length(r0))
    np.testing.assert_allclose(v_back, v0, rtol=0, atol=1e-11 * length(v0))


@pytest.mark.parametrize("name", ORBITS)
def test_chief_motion_keeps_energy_and_angular_momentum(name: str) -> None:
    orbit = ORBITS[name]
    p, e, _, mu, _ = orbit.array()
    for t in np.linspace(-20000, 20000, 41):
        r, r_dot, theta, rate, rate_dot = chief_motion(orbit.array(), t)
        assert r**2 * rate == pytest.approx(np.sqrt(mu * p), rel=1e-12)
        energy = 0.5 * (r_dot**2 + (r * rate) ** 2) - mu / r
        assert energy == pytest.approx(-mu / (2 * orbit.semi_major_axis), rel=1e-10)
        assert r == pytest.approx(p / (1 + e * np.cos(theta)), rel=1e-10)
        assert r_dot == pytest.approx(np.sqrt(mu / p) * e * np.sin(theta), abs=1e-6)
        assert rate_dot == pytest.approx(-2 * r_dot * rate / r, rel=1e-12)


@pytest.mark.parametrize("name", ORBITS)
def test_chief_motion_is_that_of_two_body(name: str) -> None:
    orbit = ORBITS[name]
    r0, v0 = start(orbit, tilted=False)
    for t in (-900.0, 0.0, 1.0, 2000.0):
        r, v, _ = two_body(r0, v0, MU_EARTH, t)
        radius, r_dot, theta, rate, _ = chief_motion(orbit.array(), t)
        assert radius == pytest.approx(length(r), rel=1e-12)
        assert r_dot == pytest.approx(r @ v / length(r), abs=1e-8)
        along = np.array([np.cos(theta), np.sin(theta), 0])
        np.testing.assert_allclose(along, r / radius, rtol=0, atol=1e-12)
        assert rate == pytest.approx(np.cross(r, v)[2] / radius**2, rel=1e-12)


@pytest.mark.parametrize("name", CLOSED)
def test_the_orbit_closes_after_one_period(name: str) -> None:
    orbit = ORBITS[name]
    period = 2 * np.pi * np.sqrt(orbit.semi_major_axis**3 / MU_EARTH)
    r0, v0 = start(orbit)
    r, v, _ = two_body(r0, v0, MU_EARTH, period)
    np.testing.assert_allclose(r, r0, rtol=0, atol=1e-11 * length(r0))
    np.testing.assert_allclose(v, v0, rtol=0, atol=1e-11 * length(v0))
    ends = [chief_motion(orbit.array(), t) for t in (0.0, period)]
    np.testing.assert_allclose(ends[1][[0, 3]], ends[0][[0, 3]], rtol=1e-11)
    turn = (ends[1][2] - ends[0][2]) / (2 * np.pi)
    assert turn == pytest.approx(round(turn), abs=1e-11)


# Relative motion.


def clohessy_wiltshire(n: float, t: float) -> Array:
    """Clohessy and Wiltshire 1960, x radial, y transverse, z normal."""
    s, c = np.sin(n * t), np.cos(n * t)
    return np.array(
        [
            [4 - 3 * c, 0, 0, s / n, 2 / n * (1 - c), 0],
            [6 * (s - n * t), 1, 0, 2 / n * (c - 1), (4 * s - 3 * n * t) / n, 0],
            [0, 0, c, 0, 0, s / n],
            [3 * n * s, 0, 0, c, 2 * s, 0],
            [6 * n * (c - 1), 0, 0, -2 * s, 4 * c - 3, 0],
            [0, 0, -n * s, 0, 0, c],
        ]
    )


@pytest.mark.parametrize("t", [0.0, 1.0, 60.0, 2000.0, 20000.0])
def test_relative_transition_is_that_of_clohessy_and_wiltshire_on_a_circle(t: float) -> None:
    orbit = ORBITS["circular"]
    n = np.sqrt(MU_EARTH / orbit.semi_major_axis**3)
    want = scaled(clohessy_wiltshire(n, t))
    got = scaled(relative_transition(orbit.array(), 300.0, 300.0 + t))
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-12 * np.abs(want).max())


@pytest.mark.parametrize("name", ORBITS)
def test_relative_transition_obeys_the_equations_of_relative_motion(name: str) -> None:
    """Zhang et al. 2015, eq. 1, integrated with the equations of r and theta."""
    orbit = ORBITS[name]
    p = orbit.array()[0]
    t0, t1 = 200.0, 3200.0

    def equations(t: float, s: Array) -> Array:
        x, y, z, vx, vy, vz, r, r_dot, rate = s
        return np.array(
            [
                *(vx, vy, vz),
                x * rate**2 * (1 + 2 * r / p) + 2 * rate * (vy - y * r_dot / r),
                -2 * rate * (vx - x * r_dot / r) + y * rate**2 * (1 - r / p),
                -z * rate**2 * r / p,
                *(r_dot, r * rate**2 * (1 - r / p), -2 * r_dot * rate / r),
            ]
        )

    radius, r_dot, _, rate, _ = chief_motion(orbit.array(), t0)
    x0 = np.array([200.0, -150.0, 100.0, 0.3, -0.4, 0.2])
    y0 = np.array([*x0, radius, r_dot, rate])
    size = np.array([500.0] * 3 + [0.5] * 3 + [radius, 1e3, rate])
    result = solve_ivp(equations, (t0, t1), y0, "DOP853", rtol=1e-13, atol=1e-14 * size).y[:, -1]
    got = relative_transition(orbit.array(), t0, t1) @ x0
    np.testing.assert_allclose(got[:3], result[:3], rtol=0, atol=1e-9 * length(got[:3]))
    np.testing.assert_allclose(got[3:], result[3:6], rtol=0, atol=1e-9 * length(got[3:]))


@pytest.mark.parametrize("name", ORBITS)
def test_relative_transitions_compose(name: str) -> None:
    orbit = ORBITS[name].array()
    rng = np.random.default_rng(3)
    for a, b, c in rng.uniform(-4000, 4000, (20, 3)):
        ca, cb, ba = (scaled(relative_transition(orbit, *i)) for i in ((a, c), (b, c), (a, b)))
        size = np.abs(cb).max() * np.abs(ba).max()
        np.testing.assert_allclose(cb @ ba, ca, rtol=0, atol=1e-11 * size)
    np.testing.assert_allclose(scaled(relative_transition(orbit, 5.0, 5.0)), np.eye(6), atol=1e-14)


# Frames.


def test_frame_rotation_undoes_the_true_anomaly() -> None:
    orbit = ORBITS["low"]
    r0, v0 = start(orbit)
    (ra, va, _), (rb, vb, _) = (two_body(r0, v0, MU_EARTH, t) for t in (100.0, 900.0))
    R_ai, R_bi = rtn_from_inertial(ra, va), rtn_from_inertial(rb, vb)
    np.testing.assert_allclose(
        frame_rotation(orbit.array(), 100.0, 900.0), R_bi @ R_ai.T, rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(frame_rotation(np.zeros(4), 0.0, 900.0), np.eye(3))


def test_rtn_axes_are_radial_transverse_normal() -> None:
    rng = np.random.default_rng(4)
    for r_i, v_i in rng.normal(size=(50, 2, 3)) * np.array([[7e6], [7e3]]):
        R_oi = rtn_from_inertial(r_i, v_i)
        np.testing.assert_allclose(R_oi @ R_oi.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R_oi) == pytest.approx(1)
        np.testing.assert_allclose(R_oi @ r_i, np.array([length(r_i), 0, 0]), atol=1e-8)
        v_o = R_oi @ v_i
        assert v_o[1] > 0
        assert v_o[2] == pytest.approx(0, abs=1e-9)


def test_rtn_of_a_rectilinear_orbit_is_refused() -> None:
    with pytest.raises(InputError, match="parallel"):
        rtn_from_inertial(np.array([7e6, 0, 0]), np.array([-2.0, 0, 0]))
    with pytest.raises(InputError, match="parallel"):
        rtn_from_inertial(np.zeros(3), np.array([0.0, 7e3, 0]))


def test_xiong_frame_is_along_track_against_the_normal_to_nadir() -> None:
    radial, transverse, normal = np.eye(3)
    np.testing.assert_array_equal(xiong_from_rtn @ transverse, [1, 0, 0])
    np.testing.assert_array_equal(xiong_from_rtn @ normal, [0, -1, 0])
    np.testing.assert_array_equal(xiong_from_rtn @ radial, [0, 0, -1])
    assert np.linalg.det(xiong_from_rtn) == pytest.approx(1)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((7e6, 1.2), r"semi_major_axis 7000000\.0 m with eccentricity 1\.2"),
        ((-7e6, 0.2), r"semi_major_axis -7000000\.0 m with eccentricity 0\.2"),
        ((7e6, 1.0), r"eccentricity 1\.0"),
        ((0.0, 0.1), r"semi_major_axis 0\.0 m"),
        ((-7e6, 1.4, 2.6), r"true_anomaly 2\.6 rad is beyond the asymptote"),
        ((7e6, -0.1), r"KeplerOrbit\.eccentricity: found -0\.1"),
        ((np.nan, 0.1), r"KeplerOrbit\.semi_major_axis: found nan"),
        ((7e6, 0.1, np.inf), r"KeplerOrbit\.true_anomaly: found inf"),
        ((7e6, 0.1, 0.0, 0.0), r"KeplerOrbit\.mu: found 0\.0"),
    ],
)
def test_impossible_conics_are_refused_with_the_value(
    values: tuple[float, ...], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        KeplerOrbit(*values)
