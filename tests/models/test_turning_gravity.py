"""Harmonics that turn with the Earth, Sun and Moon: against the truth's own formulation, against an
independent library, against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from against_brahe import (
    coefficients_apart,
    gravity_apart,
    needs_brahe,
    orbits_apart,
    tides_apart,
    transition_apart,
)
from independent import FIELD, PLACES, pull, sphere
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody
from relnav_factors.shared.earth import earth_numbers, earth_pull
from relnav_factors.shared.gravity import earth_field, zonal_gravity

from relnav_graph.constants import MU_THIRD
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.maths.earth import third_body, turns
from relnav_graph.sim.truths.earth_gravity import TurningEarth, pines_gravity

CLOCK = AbsoluteTime("2021-07-17T00:00:00 TT")


@pytest.mark.parametrize(("degree", "order"), [(2, 0), (2, 2), (6, 0), (20, 5), (20, 20), (60, 60)])
def test_both_formulations_agree_and_at_the_poles_too(degree: int, order: int) -> None:
    C, S = FIELD.upto(degree, order)
    for r in PLACES:
        want = pines_gravity(C, S, FIELD.gm, FIELD.radius, r)
        g, _ = pull(r, degree, order)
        # Rounding of the sphere's pull, which the one has and the other has not.
        np.testing.assert_allclose(g, want - sphere(r), rtol=1e-12, atol=1e-13)


@needs_brahe
def test_an_independent_library_gives_the_same() -> None:
    assert coefficients_apart() == 0.0
    assert max(gravity_apart(20), gravity_apart(60)) < 5e-14
    assert tides_apart() < 2e-11


@needs_brahe
@pytest.mark.parametrize("third_bodies", ["none", "ours"])
def test_orbits_are_those_of_an_independent_library(third_bodies: str) -> None:
    apart = orbits_apart(third_bodies)
    assert apart["position"] < 1e-4
    assert apart["velocity"] < 1e-7
    assert apart["relative position"] < 1e-5
    assert apart["relative velocity"] < 1e-8
    assert apart["true position"] < 1e-4


@needs_brahe
def test_orbits_with_another_sun_and_moon_are_nearly_the_same() -> None:
    """Series of arcminutes: without any Sun and Moon, 5 m would be missing."""
    apart = orbits_apart("own")
    assert max(apart["position"], apart["true position"]) < 2e-2
    assert apart["relative position"] < 2e-4


@needs_brahe
def test_the_transition_matrix_is_that_of_differences_of_its_orbits() -> None:
    assert transition_apart() < 1e-8


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_zonals_are_those_that_do_not_turn(degree: int) -> None:
    """Of another tide system and by another route: J2 differs in the eleventh digit."""
    g, G = pull(PLACES[0], degree, 0)
    want, slope = zonal_gravity(earth_field(degree), PLACES[0], 2)
    np.testing.assert_allclose(g, want, rtol=1e-10)
    np.testing.assert_allclose(G, slope, rtol=1e-9, atol=1e-19)


@pytest.mark.parametrize("bodies", [(), ("sun", "moon")])
def test_the_gradient_is_that_of_differences(bodies: tuple[str, ...]) -> None:
    earth = earth_numbers(20, 20, bodies, CLOCK)
    for r in PLACES:
        _, G = earth_pull(earth, 4e4, r)
        h = 1e-6 * float(np.linalg.norm(r))
        steps = [
            (earth_pull(earth, 4e4, r + h * e)[0] - earth_pull(earth, 4e4, r - h * e)[0]) / (2 * h)
            for e in np.eye(3)
        ]
        scale = float(np.abs(G).max())
        np.testing.assert_allclose(np.array(steps).T, G, rtol=0, atol=1e-6 * scale)
        np.testing.assert_allclose(G, G.T, rtol=0, atol=1e-12 * scale)
        assert abs(np.trace(G)) < 1e-12 * scale


@pytest.mark.parametrize("t", [-86400.0, 0.0, 12345.6, 20.3 * 86400, 32 * 86400.0])
def test_axes_and_bodies_between_nodes_are_those_of_their_series(t: float) -> None:
    r, at = PLACES[0], np.array([t])
    R_ie = turns(CLOCK.begin, at, None)[0][0]
    still, _ = earth_pull(earth_numbers(20, 20, (), CLOCK), t, r)
    np.testing.assert_allclose(still, R_ie @ pull(R_ie.T @ r, 20, 20)[0], rtol=0, atol=1e-13)
    for name, mu in MU_THIRD.items():
        g, _ = earth_pull(earth_numbers(20, 20, (name,), CLOCK), t, r)
        s = third_body(name, CLOCK.begin, at)[0]
        away = s - r
        want = mu * (away / np.linalg.norm(away) ** 3 - s / np.linalg.norm(s) ** 3)
        np.testing.assert_allclose(g - still, want, rtol=1e-5, atol=1e-13)
        assert float(np.abs(want).max()) > 1e-7


def test_both_processes_fly_as_the_truth_does() -> None:
    """Ten minutes over a pole, two craft 200 km apart, with all that pulls."""
    options: dict[str, Any] = {
        "degree": 60,
        "order": 60,
        "third_bodies": ("sun", "moon"),
        "clock": CLOCK,
        "acceleration_density": 1e-6,
    }
    r_t, v_t = np.array([1.2e6, 3e5, 6.75e6]), np.array([7.4e3, 2e2, -1.2e3])
    r_tc, v_tc = np.array([-1.9e5, 2e3, 3e4]), np.array([30.0, 5.0, 200.0])
    y = np.concatenate([r_t, v_t, r_t + r_tc, v_t + v_tc])
    earth = TurningEarth(60, 60, ("sun", "moon"), CLOCK)
    want = earth.fly(y, np.zeros(6), 5000.0, 1.0, 600)
    u = np.array([[400.0], [200.0]])
    r_c, v_c = OrbitTwoBody(**options, max_step=5.0).propagate(5000.0, u, y[6:9], y[9:])
    np.testing.assert_allclose(r_c, want[6:9], rtol=0, atol=1e-4)
    np.testing.assert_allclose(v_c, want[9:], rtol=0, atol=1e-6)
    model = RelativeTwoBody(**options, max_step=5.0)
    found, _ = model.propagate(5000.0, u, r_tc, v_tc, y[6:9], y[9:])
    np.testing.assert_allclose(found, want[6:9] - want[:3], rtol=0, atol=1e-4)
    # And the time counts: an hour later the same start ends elsewhere.
    later, _ = model.propagate(8600.0, u, r_tc, v_tc, y[6:9], y[9:])
    assert float(np.linalg.norm(later - found)) > 0.1


def test_a_field_that_does_not_turn_is_as_before() -> None:
    for degree in (0, 2, 3, 4):
        model = OrbitTwoBody(acceleration_density=1e-6, degree=degree, clock=CLOCK)
        np.testing.assert_array_equal(model.constants(), [*earth_field(degree), 0.0, 1e-6, 10.0])


@pytest.mark.parametrize("t", [-86401.0, 32 * 86400.0 - 5.0])
def test_row_59_times_that_the_earth_is_not_known_for(t: float) -> None:
    model = OrbitTwoBody(acceleration_density=1e-6, degree=20, order=20, clock=CLOCK)
    with pytest.raises(GeometryError, match=r"from 1 day before \[time\] epoch to 32 days after"):
        model.propagate(t, np.array([[10.0]]), PLACES[0], np.array([5e3, 5e3, 0.0]))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"degree": 61, "order": 2}, "degree: found 61, expected 0 to 60, as EGM2008 has"),
        ({"degree": 4, "order": 5}, "order: found 5, expected 0 to the degree, 4"),
        ({"degree": 1}, "degree: found 1"),
        ({"degree": -2}, "degree: found -2"),
        ({"third_bodies": ("mars",)}, "third_bodies: found 'mars', expected sun or moon"),
    ],
)
def test_row_59_fields_that_there_are_not(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        RelativeTwoBody(acceleration_density=1e-6, clock=CLOCK, **options)


@pytest.mark.parametrize(
    "options", [{"degree": 2, "order": 1}, {"degree": 6}, {"third_bodies": ("moon",)}]
)
def test_row_59_what_turns_needs_the_time(options: dict[str, Any]) -> None:
    model = OrbitTwoBody(acceleration_density=1e-6, **options)
    assert model.undated
    with pytest.raises(InputError, match=r"expected \[time\] epoch"):
        model.propagate(0.0, np.array([[10.0]]), PLACES[0], np.array([5e3, 5e3, 0.0]))
