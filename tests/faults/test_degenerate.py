"""Geometry that no model can linearise, said by name; numbers beyond floats; starts without end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_makers import stereo
from examples import EXAMPLES
from passes import ZHANG
from relnav_factors.dynamics.eccentric_relative_motion import EccentricRelativeMotion
from relnav_factors.dynamics.euler_rotation import EulerRotation
from relnav_factors.dynamics.gyro_bias import GyroBias
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from relnav_factors.sensors.beacon_los import BeaconLineOfSight
from relnav_factors.sensors.earth_sensor import EarthSensor
from relnav_factors.sensors.gps_pseudorange import GpsPseudorange
from relnav_factors.sensors.laser_range_angles import LaserRangeAngles
from relnav_factors.sensors.star_tracker import StarTracker

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.draws import draw_block
from relnav_graph.core.conformance.examples import DynamicsExample, SensorExample, reads_of
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Block
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.estimators import run_estimator, try_estimator
from relnav_graph.maths.orbit import KeplerOrbit
from relnav_graph.runs.comparison import compare
from relnav_graph.runs.passes import open_pass
from relnav_graph.scenario.build import load_scenario

ONE = np.zeros(1, dtype=np.int64)
MODELS = [(kind, i) for kind, all_ in EXAMPLES.items() for i in range(len(all_))]
LASER = LaserRangeAngles(range_sigma=0.1, angle_sigma=1e-3, axes="orbital")


def placed(block: Block, size: float, rng: np.random.Generator) -> Array:
    """An attitude, or a vector of components of that size."""
    if block.manifold == "SO3":
        return draw_block(block, rng, "moderate")
    return size * np.where(rng.random(block.dim) < 0.5, -1.0, 1.0)


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-20, 1e12, 1e60, 1e200])
@pytest.mark.parametrize(("kind", "i"), MODELS)
def test_row_47_no_state_makes_a_kernel_fail_without_a_word(kind: str, i: int, size: float) -> None:
    """Finite numbers, or a GeometryError in words; never a kernel blamed for its geometry."""
    rng, example = np.random.default_rng(47), EXAMPLES[kind][i]
    model: Any = example.model
    if isinstance(example, SensorExample):
        ids, seen = model.observables(), example.draw(rng, "near")
        x = [placed(b, size, rng) for b in reads_of(model)]
        if numbered_of(model) is not None:
            ids = ONE
            seen, x = (*seen[:-1], seen[-1][None]), [*x[:-1], x[-1][None]]
        z = model.predict(ids, *seen)
        call, arguments = model.residual, (Measurement("s", 1.0, z, ids), *x)
    elif isinstance(example, DynamicsExample):
        x = [placed(b, size, rng) for b in model.advances + model.reads]
        u = np.array([[2.0, *np.full(sum(len(c) for c in model.inputs.values()), 0.01)]])
        call, arguments = model.transition, (1.0, u, *x)
    else:
        return
    try:
        call(*arguments)
    except GeometryError as error:
        assert "status" not in str(error)  # noqa: PT017


EARTH_FACING: dict[str, Any] = {"chaser_attitude": np.eye(3), "earth_sensor_bias": np.zeros(2)}
AT_ZERO: dict[str, tuple[Any, dict[str, Array], Array, str]] = {
    "laser": (LASER, {}, np.array([9.0, 0.1, 0.2]), "from the sensor to the target"),
    "beacon": (
        BeaconLineOfSight(points=np.zeros((1, 3)), sigma=1e-3),
        {},
        np.array([0.0, 0.0, 1.0]),
        "from the sensor to the beacon",
    ),
    "camera": (
        replace(stereo(), points=np.zeros((1, 3))),
        {},
        np.array([320.0, 240.0, 300.0, 240.0]),
        "from the camera to the point",
    ),
    "earth": (
        EarthSensor(sigma=1e-3),
        EARTH_FACING,
        np.array([0.1, 0.2]),
        "from the chaser to the Earth's centre",
    ),
    "gps": (
        GpsPseudorange(sigma=1.0),
        {"chaser_position": np.array([2e7, 0.0, 0.0])},
        np.array([2e7, 2e7, 0.0, 0.0]),
        "from the receiver to the satellite",
    ),
}


@pytest.mark.parametrize("name", AT_ZERO)
def test_row_47_the_length_that_is_zero_is_named(name: str) -> None:
    model, given, z, what = AT_ZERO[name]
    x = [given.get(b.name, np.eye(3) if b.manifold == "SO3" else np.zeros(3)) for b in model.reads]
    if name == "gps":
        x[1] = np.zeros(1)
    with pytest.raises(GeometryError, match=f"id 0 at t = 3.0 s: the distance {what} is zero"):
        model.residual(Measurement(name, 3.0, z[None], ONE), *x)
    far = [1e40 + v if v.ndim == 1 and len(v) == 3 else v for v in x]
    with pytest.raises(GeometryError, match=f"the distance {what} is beyond 1e"):
        model.residual(Measurement(name, 3.0, z[None], ONE), *far)


@pytest.mark.parametrize(
    ("model", "x", "what"),
    [
        (
            EccentricRelativeMotion(acceleration_density=1e-6, orbit=KeplerOrbit(7e6)),
            [np.array([-7e6, 0.0, 0.0]), np.zeros(3)],
            "the distance of the chaser from the centre of attraction is zero",
        ),
        (
            OrbitTwoBody(acceleration_density=1e-6),
            [np.zeros(3), np.zeros(3)],
            "the distance of the chaser from the Earth's centre is zero",
        ),
        (
            RelativeTwoBody(acceleration_density=1e-6),
            [np.array([7e6, 0.0, 0.0]), np.zeros(3), np.array([7e6, 0.0, 0.0]), np.zeros(3)],
            "the distance of the target from the Earth's centre is zero",
        ),
        (
            EulerRotation(torque_density=1e-6, inertia="full"),
            [np.eye(3), np.zeros(3), np.array([0, 0, 0, 400.0, 0])],
            "the inertia parameters are too large for any body",
        ),
    ],
)
def test_row_47_a_process_says_what_is_degenerate(model: Any, x: list[Array], what: str) -> None:
    with pytest.raises(GeometryError, match=what):
        model.transition(0.0, np.array([[1.0]]), *x)


def test_row_47_times_that_no_anomaly_belongs_to() -> None:
    model = EccentricRelativeMotion(acceleration_density=1e-6, orbit=KeplerOrbit(7e6))
    with pytest.raises(GeometryError, match="place on its orbit cannot be told"):
        model.transition(1e25, np.array([[1.0]]), np.ones(3), np.zeros(3))


def laser_problem(mean: Array) -> Problem:
    """The target at rest, 100 m ahead of a laser."""
    processes: dict[str, Any] = {"motion": WhiteNoiseAcceleration(acceleration_density=1e-4)}
    z = np.array([[100.0, 0.3, -0.2]])
    seen = [Measurement("laser", float(k), z, ONE) for k in range(5)]
    epochs = make_epochs(processes, seen, {})
    prior = Prior(np.array([*mean, 0.0, 0.0, 0.0]), np.diag([1e4] * 3 + [1.0] * 3))
    return Problem(processes, {"laser": LASER}, prior, epochs)


@pytest.mark.parametrize("kind", ["ekf", "iekf", "rts", "batch", "incremental", "fixed_lag"])
def test_row_47_a_prior_of_zero_ends_every_estimator_in_the_same_words(kind: str) -> None:
    track = try_estimator(kind, laser_problem(np.zeros(3)))
    assert track.status == "diverged"
    assert (
        "sensor 'laser' (laser_range_angles), id 0 at t = 0.0 s: the distance from the sensor to"
        " the target is zero"
    ) in track.message
    assert run_estimator(kind, laser_problem(np.array([-90.0, -20.0, 15.0]))).status == "ok"


# --- where to start ---------------------------------------------------------------------------

LASER_PASS = """
title = "a laser, and a star tracker that carries it"
estimators = ["ekf"]
time = { step = "1 s", epochs = 20 }
[processes.motion]
kind = "white_noise_acceleration"
acceleration_density = "1e-4 m/s^1.5"
[processes.chaser]
kind = "gyro_bias"
angle_random_walk_density = "1e-5 rad/sqrt(s)"
bias_random_walk_density = "1e-8 rad/s^1.5"
[sensors.laser]
kind = "laser_range_angles"
range_sigma = "0.1 m"
angle_sigma = "0.01 deg"
sensor_attitude = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
[sensors.stars]
kind = "star_tracker"
sigma = "0.01 deg"
sensor_attitude = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
[prior]
relative_position = { sigma = "1 km", mean = "measured" }
relative_velocity = { sigma = "1 m/s", mean = [0, 0, 0] }
chaser_attitude = { sigma = "90 deg", mean = "measured" }
gyro_bias = { sigma = "1e-4 rad/s", mean = [0, 0, 0] }
[inputs.gyro]
kind = "constant_input"
values = [0.001, 0, 0]
[truth]
kind = "own_models"
[truth.initial]
relative_position = ["-80 m", "300 m", "20 m"]
chaser_attitude = [1.0, -2.0, 0.5]
"""


def test_row_47_a_laser_and_a_star_tracker_tell_where_to_start(tmp_path: Path) -> None:
    """The laser's axes are the chaser's: its start takes the star tracker's."""
    file = tmp_path / "laser.toml"
    file.write_text(LASER_PASS)
    done = compare(load_scenario(file))
    truth, track = done.truths[0], done.tracks[0]
    assert truth is not None
    assert track.status == "ok", track.message
    r = track.layout.values(track.x)["relative_position"]
    assert np.linalg.norm(r[-1] - truth.values["relative_position"][-1]) < 0.5
    first = done.problems[0].prior.x[done.problems[0].layout.stored("relative_position")]
    assert np.linalg.norm(first - truth.values["relative_position"][0]) < 1.0


def test_row_47_a_vision_attitude_tells_where_to_start() -> None:
    scenario = load_scenario(
        ZHANG.parent / "hu2019.toml",
        ["time.epochs=5", 'prior.target_attitude.mean="measured"'],
    )
    run = open_pass(scenario, 3)
    start = run.problem.layout.value(run.problem.prior.x, "target_attitude")
    truth = run.recording.truth
    assert truth is not None
    off = truth.values["target_attitude"][0].T @ start
    assert np.arccos(np.clip((np.trace(off) - 1) / 2, -1, 1)) < 0.05


# --- loops that end ---------------------------------------------------------------------------


@pytest.mark.parametrize("size", ["1e199", "-1e199", "1e154", "1e5", "400"])
def test_row_46_huge_inertia_parameters_end_with_an_error(size: str) -> None:
    scenario = load_scenario(
        ZHANG.parent / "hu2019.toml",
        ["time.epochs=3", f"prior.inertia_matrix_parameters.mean=[0,0,0,{size},0]"],
    )
    track = compare(scenario, ["ekf"]).tracks[0]
    assert track.status == "diverged"
    assert "inertia parameters are too large" in track.message


@pytest.mark.parametrize(
    "assignment",
    [
        "processes.target.max_step='1e-300 s'",
        "processes.target.max_step='1e-9 s'",
        "processes.relative_orbit.max_step='5e-324 s'",
        "truth.max_step='1e-300 s'",
        "truth.max_step='1e-6 s'",
    ],
)
def test_row_46_steps_without_end_are_refused_with_a_hint(assignment: str) -> None:
    with pytest.raises(InputError, match=r"max_step: .*at most 100000 steps .*another unit"):
        load_scenario(ZHANG, [assignment])


def test_row_46_steps_without_end_are_refused_in_python_too() -> None:
    """A model that is called by itself, and an epoch far from the last."""
    model = EulerRotation(torque_density=1e-6, inertia="known", known_inertia=np.eye(3))
    with pytest.raises(InputError, match="euler_rotation: found max_step = 1 s for an interval"):
        model.transition(0.0, np.array([[1e9]]), np.eye(3), np.zeros(3))
    prior = Prior(np.array([*np.eye(3).ravel(), 0, 0, 0]), np.eye(6))
    processes: dict[str, Any] = {"target": model}
    epochs = make_epochs(processes, [], {}, np.array([0.0, 1e9]))
    with pytest.raises(InputError, match=r"process 'target' \(euler_rotation\) from 0.0 s to"):
        Problem(processes, {}, prior, epochs)


@pytest.mark.parametrize("name", ["relative_position", "relative_velocity", "target_rate"])
def test_row_46_a_truth_beyond_floats_is_refused_by_name(name: str) -> None:
    scenario = load_scenario(ZHANG, ["time.epochs=3", f"truth.{name}=[2e202, 1e202, 0.0]"])
    with (
        np.errstate(all="ignore"),
        pytest.raises(InputError, match=r"truth: \w+ is not finite at t = .*too large"),
    ):
        open_pass(scenario, 0)


# --- one orbit for all ------------------------------------------------------------------------


@pytest.mark.parametrize("other", [None, KeplerOrbit(7.2e6, 0.05, 1e-9)])
@pytest.mark.parametrize("name", ["chaser", "target", "relative_orbit"])
def test_row_41_models_of_different_orbits_are_refused(name: str, other: KeplerOrbit) -> None:
    scenario = load_scenario(ZHANG)
    processes: dict[str, Any] = dict(scenario.processes)
    if name == "relative_orbit":
        other = other or KeplerOrbit(7.3e6)
    processes[name] = replace(processes[name], orbit=other)
    prior = Prior(scenario.layout.identity, np.eye(scenario.layout.dim))
    with pytest.raises(InputError, match=f"process '{name}' .* has .*one orbit for all") as error:
        Problem(processes, scenario.sensors, prior, ())
    assert sum(f"process {n!r}" in str(error.value) for n in processes) == 2


def test_row_41_a_sensor_among_the_stars_beside_an_orbit_is_refused() -> None:
    """With an o at rest they go together; the sensor is named."""
    processes: dict[str, Any] = {
        "motion": EccentricRelativeMotion(acceleration_density=1e-6, orbit=KeplerOrbit(7e6)),
    }
    walks: dict[str, Any] = {"angle_random_walk_density": 1e-4, "bias_random_walk_density": 1e-6}
    gyro: Any = GyroBias(**walks)
    stars: dict[str, Any] = {"stars": StarTracker(sigma=np.full(3, 1e-3))}
    turning = {**processes, "gyro": replace(gyro, orbit=KeplerOrbit(7e6))}
    prior = Prior(np.array([*[0.0] * 6, *np.eye(3).ravel(), 0, 0, 0]), np.eye(12))
    with pytest.raises(InputError, match=r"sensor 'stars' \(star_tracker\) has no orbit"):
        Problem(turning, stars, prior, ())
    Problem({"gyro": gyro}, stars, Prior(prior.x[6:], np.eye(6)), ())
