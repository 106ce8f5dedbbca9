"""Truth of a chaser that thrusts: by physics, not by the models of the estimators."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from passes import EXPERIMENTS
from scipy.integrate import solve_ivp

from relnav_graph.arrays import Array
from relnav_graph.constants import EARTH_RADIUS, MU_EARTH, ZONAL_EARTH
from relnav_graph.core.catalogue import GYRO_BIAS, GYRO_DRIFT
from relnav_graph.core.state import Layout
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.runs.closed_loop import fly_all
from relnav_graph.scenario.build import load_scenario
from relnav_graph.sim.control.rendezvous import Rendezvous
from relnav_graph.sim.passes import biases_as_in
from relnav_graph.sim.truths.powered_dynamics import gravity
from relnav_graph.sim.truths.powered_orbits import PoweredOrbits

YANG = EXPERIMENTS / "yang2016.toml"
QUIET = PoweredOrbits(
    semi_major_axis=6.878e6,
    inclination=0.9,
    relative_position=np.array([100.0, -5e4, 2e3]),
    relative_velocity=np.array([1.0, 0.5, -2.0]),
    mass=1500.0,
    max_thrust=50.0,
)
REGULATOR = Rendezvous(
    semi_major_axis=6.878e6,
    goal=np.array([0.0, -2e3, 0.0]),
    mass=1500.0,
    max_thrust=50.0,
    position_scale=1e3,
    velocity_scale=10.0,
    thrust_scale=5.0,
)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def potential(r: Array) -> float:
    """Of the Earth with J2, J3, J4, by Legendre's polynomials (Vallado 2013, eq. 8-19)."""
    d = float(np.linalg.norm(r))
    s, sizes = r[2] / d, [1.0]
    polynomials = [0.0, 0.0, 1.5 * s**2 - 0.5, 2.5 * s**3 - 1.5 * s]
    polynomials.append((35 * s**4 - 30 * s**2 + 3) / 8)
    for n, J in zip((2, 3, 4), ZONAL_EARTH, strict=True):
        sizes.append(-J * (EARTH_RADIUS / d) ** n * polynomials[n])
    return MU_EARTH / d * sum(sizes)


def test_gravity_is_the_gradient_of_the_potential() -> None:
    for seed in range(20):
        r = np.random.default_rng(seed).normal(size=3)
        r *= 7e6 / np.linalg.norm(r)
        h, e = 50.0, np.eye(3)
        slope = [
            (8 * (potential(r + h * a) - potential(r - h * a)))
            - (potential(r + 2 * h * a) - potential(r - 2 * h * a))
            for a in e
        ]
        np.testing.assert_allclose(gravity(r), np.array(slope) / (12 * h), atol=2e-9)


def test_orbits_are_those_of_another_integrator_with_a_thrust_held() -> None:
    flight, thrust = QUIET.fly(0.0, rng()), np.array([10.0, -20.0, 30.0])
    y0 = QUIET.craft(0.0)

    def slope(_: float, y: Array) -> Array:
        pushed = gravity(y[6:9].copy()) + thrust / 1500.0
        return np.concatenate([y[3:6], gravity(y[0:3].copy()), y[9:12], pushed])

    for k in range(100):
        flight.advance(6.0 * (k + 1), thrust, {})
    y = solve_ivp(slope, (0.0, 600.0), y0, "DOP853", rtol=1e-13, atol=1e-6).y[:, -1]
    values = flight.values()
    np.testing.assert_allclose(values["chaser_position"], y[6:9], atol=1e-3)
    np.testing.assert_allclose(values["relative_velocity"], y[9:12] - y[3:6], atol=1e-6)


def test_a_thrust_is_cut_and_other_commands_are_refused() -> None:
    one, other = QUIET.fly(0.0, rng()), QUIET.fly(0.0, rng())
    one.advance(10.0, np.array([0.0, 500.0, 0.0]), {})
    other.advance(10.0, np.array([0.0, 50.0, 0.0]), {})
    np.testing.assert_array_equal(
        one.values()["chaser_velocity"], other.values()["chaser_velocity"]
    )
    for bad in (np.zeros(2), np.full(3, np.nan)):
        with pytest.raises(InputError, match="found command"):
            one.advance(20.0, bad, {})
    with pytest.raises(InputError, match="cannot drive the input 'velocity'"):
        one.advance(20.0, None, {"velocity": np.array([10.0, 20.0])})
    with pytest.raises(InputError, match=r"inputs\.gyro: samples do not cover"):
        one.advance(30.0, None, {"gyro": np.array([10.0, 20.0])})


def test_inputs_lead_from_attitude_to_attitude_and_from_velocity_to_velocity() -> None:
    """With a wobble of 0.01 deg: the turns of all samples multiply to that of the interval, and
    the force's sum in i is the thrust's."""
    truth = replace(QUIET, wobble=2e-4, wobble_period=5.0)
    flight, thrust = truth.fly(0.0, rng()), np.array([10.0, -20.0, 30.0])
    edges = np.linspace(0.0, 2.0, 101)
    before = flight.values()["chaser_attitude"]
    means = flight.advance(2.0, thrust, {"gyro": edges, "accelerometer": edges})
    R, gained = before.copy(), np.zeros(3)
    for w, f in zip(means["gyro"], means["accelerometer"], strict=True):
        gained += R @ so3.exp(0.01 * w) @ f * 0.02
        R = R @ so3.exp(0.02 * w)
    assert np.abs(so3.log(R.T @ flight.values()["chaser_attitude"])).max() < 1e-6
    np.testing.assert_allclose(gained, thrust / 1500.0 * 2.0, atol=1e-9)


def test_the_chaser_looks_at_the_earth() -> None:
    values = QUIET.fly(0.0, rng()).values()
    down = -values["chaser_position"] / np.linalg.norm(values["chaser_position"])
    np.testing.assert_allclose(values["chaser_attitude"][:, 2], down, atol=1e-12)
    assert values["chaser_attitude"][:, 1] @ values["chaser_velocity"] == pytest.approx(0, abs=1e-8)


def test_noise_does_not_depend_on_the_command() -> None:
    truth = replace(QUIET, acceleration_sigma=1e-5, frequency_density=0.1, earth_sensor_sigma=1e-3)
    one, other = truth.fly(0.0, rng()), truth.fly(0.0, rng())
    for k in range(5):
        one.advance(k + 1.0, None, {})
        other.advance(k + 1.0, np.full(3, 20.0), {})
    for name in ("clock_bias", "clock_drift", "earth_sensor_drift"):
        np.testing.assert_array_equal(one.values()[name], other.values()[name])


def test_clock_is_a_random_walk_and_its_integral() -> None:
    truth = replace(QUIET, clock_drift=1.0, frequency_density=0.5, max_step=100.0)
    ends = []
    for seed in range(400):
        flight = truth.fly(0.0, np.random.default_rng(seed))
        flight.advance(4.0, None, {})
        ends.append([*flight.values()["clock_bias"] - 4.0, *flight.values()["clock_drift"] - 1.0])
    found = np.cov(np.array(ends).T)
    expected = 0.25 * np.array([[64 / 3, 8.0], [8.0, 4.0]])
    np.testing.assert_allclose(found, expected, rtol=0.25)


def test_the_regulator_brings_the_chaser_to_two_kilometres() -> None:
    """With its place known exactly: from 50 km, with the thrust at its bound at first."""
    truth = replace(QUIET, relative_velocity=np.zeros(3), max_step=10.0)
    flight, sizes = truth.fly(0.0, rng()), []
    for k in range(900):
        thrust = REGULATOR.command(10.0 * k, flight.values(), {})
        sizes.append(np.linalg.norm(thrust))
        flight.advance(10.0 * (k + 1), thrust, {})
    assert max(sizes) == pytest.approx(50.0)
    assert sizes[-1] < 0.5
    assert np.linalg.norm(flight.values()["relative_position"]) == pytest.approx(2e3, abs=10.0)


BIASES = {
    "accelerometer_bias": (1e-3, 1e-4),
    "gyro_bias": (np.radians(3.5 / 3600), np.radians(0.15 / 3600)),
    "earth_sensor_bias": (np.radians(0.05), np.radians(0.005)),
}


def test_the_biases_of_yang2016_do_not_decay() -> None:
    """As printed: a constant for three hours, and a drift about it that has its sigma throughout.
    In steps of ten seconds, which changes nothing of what the instruments' errors are."""
    slow = [f'inputs.{name}.period="10 s"' for name in ("gyro", "accelerometer")]
    settings = ['time.step="10 s"', "time.epochs=1081", 'sensors.earth_sensor.period="10 s"']
    scenario = load_scenario(YANG, [*settings, *slow])
    truths = [scenario.simulate(seed).truth for seed in range(4)]
    for bias, (constant, sigma) in BIASES.items():
        values = [truth.values for truth in truths if truth is not None]
        assert len(values) == 4
        for own in values:
            np.testing.assert_array_equal(own[bias], np.full_like(own[bias], constant))
        drifts = np.array([own[bias.replace("_bias", "_drift")] for own in values])
        thirds = np.split(drifts[:, :1080], 3, axis=1)
        for third in thirds:
            whole = constant + third
            assert np.abs(whole.mean() - constant) < sigma
            assert 0.4 * sigma < np.sqrt((third**2).mean()) < 1.6 * sigma


def test_a_state_without_drifts_has_biases_as_a_whole() -> None:
    values = {"gyro_bias": np.ones(3), "gyro_drift": np.full(3, 0.25), "clock_drift": np.ones(1)}
    divided, whole = Layout([GYRO_BIAS, GYRO_DRIFT]), Layout([GYRO_BIAS])
    np.testing.assert_array_equal(biases_as_in(divided, values)["gyro_bias"], np.ones(3))
    np.testing.assert_array_equal(biases_as_in(whole, values)["gyro_bias"], np.full(3, 1.25))


@cache
def loop_figures(period: str) -> dict[str, float]:
    """Of 40 epochs flown by a filter: rows that the epochs keep, and errors at the end."""
    settings = [f'inputs.{n}.period="{period}"' for n in ("gyro", "accelerometer")]
    scenario = load_scenario(YANG, ["time.epochs=40", *settings])
    filtered, smoothed = fly_all(scenario, ["ekf", "rts"], 0)
    rows = [u.shape[0] for e in filtered.problem.epochs for u in e.inputs.values()]
    assert smoothed.problem is filtered.problem
    assert filtered.track.status == smoothed.track.status == "ok"
    return {"rows": max(rows), "values": float(sum(rows))}


def test_what_is_kept_of_a_flight_does_not_grow_with_the_rate_of_the_inputs() -> None:
    slow, fast = loop_figures("0.5 s"), loop_figures("0.01 s")
    assert slow["rows"] == fast["rows"] == 1
    assert slow["values"] == fast["values"]
