"""The target's orbit in the state: its motion, what reads it, and what cannot be told of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from example_makers import ESTIMATED, gyro_model
from passes import EXPERIMENTS
from plain_physics import PAIR
from relnav_factors.dynamics.eccentric_relative_motion import EccentricRelativeMotion
from relnav_factors.dynamics.euler_rotation import EulerRotation
from relnav_factors.dynamics.planar_orbit import PlanarOrbit
from scipy.integrate import solve_ivp
from test_physics import ORBIT, angle_between, lasting

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.catalogue import ORBIT as BLOCKS
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.build import load_scenario

SCENARIO = EXPERIMENTS / "zhang2015_orbit.toml"
MODEL = PlanarOrbit(acceleration_density=1e-6, orbit=ESTIMATED)
RELATIVE = EccentricRelativeMotion(acceleration_density=1e-9, orbit=ESTIMATED, max_step=1.0)
GYRO = gyro_model(1e-6, 1e-9, orbit=ESTIMATED)
TUMBLE = EulerRotation(torque_density=1e-9, orbit=ESTIMATED)
PERIOD = 2 * np.pi * np.sqrt(PAIR.semi_major_axis**3 / MU_EARTH)


def values_of(y: Array) -> list[Array]:
    return [y[i : i + 1].copy() for i in range(4)]


def orbit_of(truth: Any, n: int) -> list[Array]:
    return [truth[b.name][n] for b in BLOCKS]


@pytest.mark.parametrize(
    "y0",
    [[7.2e6, 0.0, 0.3, 1.03e-3], [6.84e6, 250.0, -2.0, 1.2e-3], [7e6, -3000.0, 1.0, 1.7e-3]],
    ids=["ellipse", "eccentric", "hyperbola"],
)
def test_motion_is_that_of_an_independent_propagator(y0: list[float]) -> None:
    """The equations in print, integrated by scipy; in one interval and in many."""

    def slope(t: float, y: Array) -> list[float]:
        return [y[1], y[0] * y[3] ** 2 - MU_EARTH / y[0] ** 2, y[3], -2 * y[1] * y[3] / y[0]]

    start, end = np.array(y0), 3000.0
    size = np.array([start[0], start[0] * start[3], 1.0, start[3]])
    want = solve_ivp(slope, (0, end), start, "DOP853", rtol=3e-14, atol=1e-12 * size).y[:, -1]
    for count in (1, 300):
        values: Sequence[Array] = values_of(start)
        for _ in range(count):
            values = MODEL.propagate(0.0, lasting(end / count), *values)
        np.testing.assert_allclose((np.concatenate(values) - want) / size, 0, rtol=0, atol=1e-9)


def test_the_truth_counts_whole_turns_as_the_process_does() -> None:
    """From an epoch before the pass, in intervals of 0.7 of an orbit."""
    times = 0.7 * PERIOD * np.arange(6)
    truth = PAIR.simulate(times, np.random.default_rng(0)).values
    np.testing.assert_allclose(truth["orbit_angle"][0], 0.3, rtol=0, atol=1e-14)
    for n in range(5):
        got = MODEL.propagate(0.0, lasting(times[n + 1] - times[n]), *orbit_of(truth, n))
        size = np.array([7e6, 7e3, 1.0, 1e-3])
        off = np.concatenate(got) - np.concatenate(orbit_of(truth, n + 1))
        assert np.abs(off / size).max() < 1e-9
    assert truth["orbit_angle"][-1, 0] > 3 * 2 * np.pi


def test_what_reads_it_moves_as_about_the_same_orbit_when_known() -> None:
    truth = PAIR.simulate(np.array([0.0, 900.0]), np.random.default_rng(0)).values
    y, t, u = orbit_of(truth, 0), 0.0, lasting(900.0)
    known: dict[str, Any] = {"orbit": ORBIT}
    r, v = truth["relative_position"][0], truth["relative_velocity"][0]
    apart = EccentricRelativeMotion(acceleration_density=1e-9, max_step=1.0, **known)
    for got, want in zip(
        RELATIVE.propagate(t, u, r, v, *y), apart.propagate(t, u, r, v), strict=True
    ):
        assert np.linalg.norm(got - want) < 1e-9 * np.linalg.norm(want)
    R, w, k = (truth[n][0] for n in ("target_attitude", "target_rate", "inertia_parameters"))
    free = EulerRotation(torque_density=1e-9, **known)
    got, want = TUMBLE.propagate(t, u, R, w, k, *y)[0], free.propagate(t, u, R, w, k)[0]
    assert angle_between(got, want) < 1e-9
    turn, b, R = np.array([[900.0, 1e-3, -2e-3, 3e-3]]), np.zeros(3), truth["chaser_attitude"][0]
    got = GYRO.propagate(t, turn, R, b, *y)[0]
    want = gyro_model(1e-6, 1e-9, **known).propagate(t, turn, R, b)[0]
    assert angle_between(got, want) < 1e-9
    assert angle_between(got, truth["chaser_attitude"][1]) < 1e-9


READERS: dict[str, tuple[Any, list[Array], Array]] = {
    "relative": (RELATIVE, [PAIR.relative_position, PAIR.relative_velocity], lasting(40.0)),
    "gyro": (GYRO, [np.eye(3), np.zeros(3)], np.array([[40.0, 1e-3, 2e-3, 3e-3]])),
    "tumble": (TUMBLE, [np.eye(3), np.array([0.01, 0.02, 0.03]), np.zeros(2)], lasting(40.0)),
}


@pytest.mark.parametrize("name", READERS)
def test_nothing_relative_depends_on_the_angle(name: str) -> None:
    """A gauge freedom of the angle alone: attitudes and motion in o stay exactly as they are."""
    model, x, u = READERS[name]
    y = values_of(np.array([7.1e6, 120.0, 0.4, 1.05e-3]))
    turned = [*y[:2], y[2] + 2.0, y[3]]
    at, F, _ = model.transition(0.0, u, *x, *y)
    for one, other in zip(at, model.propagate(0.0, u, *x, *turned), strict=True):
        np.testing.assert_array_equal(one, other)
    assert not F[:, -2].any()
    assert all(F[:, -k].any() for k in (1, 3, 4))


@pytest.mark.parametrize("name", [*READERS, "orbit"])
def test_an_orbit_without_a_radius_is_said_to_be_none(name: str) -> None:
    model, x, u = {**READERS, "orbit": (MODEL, [], lasting(40.0))}[name]
    with pytest.raises(GeometryError, match="the estimated orbit of the target is none"):
        model.propagate(0.0, u, *x, *values_of(np.array([-7e6, 0.0, 0.0, 1e-3])))


def test_the_angle_stays_what_it_was_said_to_be() -> None:
    """Beacons and a gyro see no direction at rest."""
    scenario = load_scenario(SCENARIO, ["time.epochs=40"])
    problem = scenario.problem(scenario.simulate(0), 0)
    track = run_estimator("batch", problem)
    assert track.status == "ok"
    angle, prior = (
        track.value("orbit_angle")[0],
        problem.layout.value(problem.prior.x, "orbit_angle"),
    )
    np.testing.assert_allclose(angle, prior, rtol=0, atol=1e-10)
    np.testing.assert_allclose(track.covariance("orbit_angle")[0], 1e-8, rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (['processes.relative_orbit.gravity="linear"'], "found 'linear' and an estimated orbit"),
        (
            [
                'sensors.stars={kind="star_tracker", sigma="0.01 deg", inclination="0 deg",'
                ' raan="0 deg", argument_of_perigee="0 deg"}'
            ],
            r"sensor 'stars' \(star_tracker\): found an orbit that is estimated",
        ),
    ],
)
def test_what_cannot_be_is_refused(settings: list[str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_scenario(SCENARIO, settings)


def test_an_orbit_that_is_known_is_no_state() -> None:
    with pytest.raises(InputError, match="planar_orbit: found an orbit that is known"):
        PlanarOrbit(acceleration_density=1e-6, orbit=ORBIT)


def test_an_orbit_that_nothing_advances_is_no_constant() -> None:
    with pytest.raises(InputError, match="found no process that advances orbit_angle"):
        load_scenario(EXPERIMENTS / "zhang2015.toml", ["orbit.estimated=true"])
