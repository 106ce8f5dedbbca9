"""Zonal gravity against its potential, and orbits about an oblate Earth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import legendre
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody
from relnav_factors.shared.gravity import earth_field, gravity_difference, zonal_gravity

from relnav_graph.arrays import Array
from relnav_graph.constants import EARTH_RADIUS, MU_EARTH, ZONAL_EARTH
from relnav_graph.maths.orbit import two_body

PLACE = np.array([2.1e6, -5.3e6, 4.4e6])


def force_function(r_i: Array, degree: int) -> float:
    """mu / r (1 - sum J_n (R / r)^n P_n(sin latitude)); Vallado 2013, eq. 8-19."""
    r = float(np.linalg.norm(r_i))
    c = [1.0, 0.0, *(-J * (EARTH_RADIUS / r) ** n for n, J in enumerate(ZONAL_EARTH, 2))]
    return float(MU_EARTH / r * legendre.legval(r_i[2] / r, c[: degree + 1]))


@pytest.mark.parametrize("degree", [0, 2, 3, 4])
def test_gravity_is_the_gradient_of_the_force_function(degree: int) -> None:
    g, _ = zonal_gravity(earth_field(degree), PLACE, 0)
    h = 300.0
    want = [
        (force_function(PLACE + h * e, degree) - force_function(PLACE - h * e, degree)) / (2 * h)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(g, want, rtol=1e-7, atol=1e-8)
    # Each degree is more than what the comparison can see.
    if degree:
        before = zonal_gravity(earth_field(degree - 1 if degree > 2 else 0), PLACE, 0)[0]
        assert np.abs(g - before).max() > 2e-6


def test_gradient_is_symmetric_and_without_trace() -> None:
    """Laplace's equation."""
    _, G = zonal_gravity(earth_field(4), PLACE, 0)
    np.testing.assert_allclose(G, G.T, atol=1e-20)
    assert abs(np.trace(G)) < 1e-20


@pytest.mark.parametrize("degree", [0, 4])
def test_difference_is_that_of_two_gravities_however_close(degree: int) -> None:
    field, away = earth_field(degree), np.array([3e5, -2e5, 4e5])
    want = zonal_gravity(field, PLACE, 0)[0] - zonal_gravity(field, PLACE - away, 0)[0]
    np.testing.assert_allclose(gravity_difference(field, PLACE, away)[0], want, rtol=1e-12)
    close = 1e-9 * away
    middle = zonal_gravity(field, PLACE - 0.5 * close, 0)[1] @ close
    got = gravity_difference(field, PLACE, close)[0]
    np.testing.assert_allclose(got, middle, rtol=1e-11, atol=1e-17)


def circular(radius: float, inclination: float) -> tuple[Array, Array]:
    speed = np.sqrt(MU_EARTH / radius)
    v = speed * np.array([0.0, np.cos(inclination), np.sin(inclination)])
    return np.array([radius, 0.0, 0.0]), v


def test_orbit_is_that_of_two_bodies() -> None:
    r, v = circular(7e6, 0.9)
    model = OrbitTwoBody(acceleration_density=1e-6, max_step=5.0)
    got_r, got_v = model.propagate(0.0, np.array([[600.0]]), r, 1.1 * v)
    want_r, want_v, _ = two_body(r, 1.1 * v, MU_EARTH, 600.0)
    np.testing.assert_allclose(got_r, want_r, atol=1e-3)
    np.testing.assert_allclose(got_v, want_v, atol=1e-6)


def test_oblateness_turns_the_node() -> None:
    """-3/2 n J2 (R / p)^2 cos i, to first order in J2 (Vallado 2013, eq. 9-37)."""
    radius, inclination = 7e6, 0.9
    r, v = circular(radius, inclination)
    n = np.sqrt(MU_EARTH / radius**3)
    T = 10 * 2 * np.pi / n
    model = OrbitTwoBody(acceleration_density=1e-6, degree=2, max_step=20.0)
    r, v = model.propagate(0.0, np.array([[T]]), r, v)
    normal = np.cross(r, v)
    node = np.arctan2(normal[0], -normal[1])
    want = -1.5 * n * ZONAL_EARTH[0] * (EARTH_RADIUS / radius) ** 2 * np.cos(inclination) * T
    assert node == pytest.approx(want, rel=0.02)


def test_relative_motion_is_the_difference_of_two_orbits() -> None:
    r_c, v_c = circular(7e6, 0.9)
    r_tc, v_tc = np.array([-2e3, 5e3, 1e3]), np.array([1.0, -2.0, 0.5])
    u = np.array([[300.0]])
    absolute = OrbitTwoBody(acceleration_density=1e-6, degree=4)
    relative = RelativeTwoBody(acceleration_density=1e-6, degree=4)
    chaser = absolute.propagate(0.0, u, r_c, v_c)
    target = absolute.propagate(0.0, u, r_c - r_tc, v_c - v_tc)
    got = relative.propagate(0.0, u, r_tc, v_tc, r_c, v_c)
    np.testing.assert_allclose(got[0], chaser[0] - target[0], atol=1e-7)
    np.testing.assert_allclose(got[1], chaser[1] - target[1], atol=1e-10)
