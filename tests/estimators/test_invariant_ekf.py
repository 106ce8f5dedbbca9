"""The filter with the error of the group of poses: its error, and what that is good for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from example_makers import BEACONS, MOUNTED, gyro_model
from passes import EXPERIMENTS
from relnav_factors.dynamics.body_velocity import BodyVelocity
from relnav_factors.sensors.stereo_point import StereoPointCartesian
from scipy.linalg import expm

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import (
    GYRO_BIAS,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION_T,
    RELATIVE_VELOCITY_T,
)
from relnav_graph.core.conformance.draws import draw_block
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError, ModelError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.invariant_ekf import GroupError, InvariantEkf
from relnav_graph.maths import so3
from relnav_graph.scenario.build import load_scenario, make_scenario

LAYOUT = Layout((RELATIVE_ATTITUDE, RELATIVE_POSITION_T, RELATIVE_VELOCITY_T, GYRO_BIAS))
ERROR = GroupError(LAYOUT)


def states(count: int, layout: Layout = LAYOUT) -> list[Array]:
    rng = np.random.default_rng(3)
    draws = [{b.name: draw_block(b, rng, "moderate") for b in layout} for _ in range(count)]
    return [layout.pack(values) for values in draws]


def group(x: Array) -> Array:
    """The matrix (5, 5) of attitude, position and velocity."""
    X = np.eye(5)
    X[:3, :3] = LAYOUT.value(x, "relative_attitude")
    X[:3, 3], X[:3, 4] = (LAYOUT.value(x, f"relative_{n}") for n in ("position", "velocity"))
    return X


def test_a_step_is_an_exponential_on_the_left_and_its_slope_is_right() -> None:
    rng = np.random.default_rng(1)
    for x in states(10):
        xi = rng.normal(size=LAYOUT.dim)
        algebra = np.zeros((5, 5))
        algebra[:3, :3], algebra[:3, 3], algebra[:3, 4] = so3.skew(xi[:3]), xi[3:6], xi[6:9]
        moved = ERROR.moved(x, xi)
        np.testing.assert_allclose(group(moved), expm(algebra) @ group(x), rtol=0, atol=1e-11)
        np.testing.assert_array_equal(
            LAYOUT.value(moved, "gyro_bias"), LAYOUT.value(x, "gyro_bias") + xi[9:]
        )
        columns = [
            (LAYOUT.local(x, ERROR.moved(x, h)) - LAYOUT.local(x, ERROR.moved(x, -h))) / 2e-6
            for h in 1e-6 * np.eye(LAYOUT.dim)
        ]
        np.testing.assert_allclose(ERROR.slope(x), np.array(columns).T, rtol=0, atol=1e-6)


POSE = Layout((RELATIVE_ATTITUDE, RELATIVE_POSITION_T))


def test_rows_of_known_points_do_not_depend_on_the_estimate() -> None:
    """In axes that do not turn with it: -[X x] phi + rho of each point X."""
    camera = StereoPointCartesian(points=BEACONS, sigma=np.full(3, 0.01), pose="target", **MOUNTED)
    ids, error = np.arange(len(BEACONS)), GroupError(POSE)
    for x in states(10, POSE):
        R, r = POSE.values(x).values()
        z = camera.predict(ids, *(POSE.value(x, b.name) for b in camera.reads))
        blocks = camera.residual(Measurement(t=0.0, sensor="camera", z=z, ids=ids), R, r)[1]
        rows = (np.hstack(blocks) @ error.slope(x)).reshape(-1, 3, 6)
        R_ts = R @ MOUNTED["sensor_attitude"]
        for row, X in zip(rows, BEACONS, strict=True):
            want = np.hstack([so3.skew(X), -np.eye(3)])
            np.testing.assert_allclose(R_ts @ row, want, rtol=0, atol=1e-10)


def test_the_error_stays_as_it_is_between_measurements() -> None:
    """Wherever the estimate is, and however gyro and velocity say that it moves."""
    rng, error = np.random.default_rng(2), GroupError(POSE)
    turning: Any = gyro_model(1e-4, 0.0, attitude="relative_attitude")
    moving = BodyVelocity(velocity_density=np.full(3, 0.1), pose="target")
    for x in states(10, POSE):
        R, r = POSE.values(x).values()
        v, w = rng.normal(size=(20, 3)), 0.1 * rng.normal(size=(20, 3))
        dt = np.full((20, 1), 0.5)
        (R_next,), F_R, _ = turning.transition(0.0, np.hstack([dt, w]), R, np.zeros(3))
        (r_next,), F_r, _ = moving.transition(0.0, np.hstack([dt, v, w]), r, R)
        F = np.zeros((6, 6))
        F[:3, :3], F[3:, 3:], F[3:, :3] = F_R[:, :3], F_r[:, :3], F_r[:, 3:6]
        end = POSE.pack({"relative_attitude": R_next, "relative_position": r_next})
        got = np.linalg.solve(error.slope(end), F @ error.slope(x))
        np.testing.assert_allclose(got, np.eye(6), rtol=0, atol=1e-10)


#: A chaser that circles known points at 5 m and does not know its attitude to 30 deg.
CIRCLE: dict[str, Any] = {
    "title": "circle",
    "time": {"step": "0.5 s", "epochs": 61},
    "processes": {
        "attitude": {
            "kind": "gyro_bias",
            "attitude": "relative_attitude",
            "angle_random_walk_density": 1e-3,
        },
        "translation": {"kind": "body_velocity", "pose": "target", "velocity_density": 0.01},
    },
    "sensors": {
        "camera": {
            "kind": "stereo_point_cartesian",
            "pose": "target",
            "points": BEACONS.tolist(),
            "sigma": ["5 mm", "5 mm", "5 mm"],
            "sensor_attitude": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
        }
    },
    "prior": {
        "relative_attitude": {"sigma": "30 deg"},
        "relative_position": {"sigma": "1 m"},
        "gyro_bias": {"sigma": 0.01},
    },
    "truth": {"kind": "own_models", "initial": {"relative_position": [0.0, -5.0, 0.0]}},
    "inputs": {
        "gyro": {"kind": "constant_input", "values": [0.0, 0.0, 0.02]},
        "velocity": {"kind": "constant_input", "values": [0.1, 0.0, 0.0]},
    },
}


def last_angle(track: Track, truth: Any) -> float:
    """Error of the attitude over the last third of a pass, RMS, rad."""
    block, count = RELATIVE_ATTITUDE, len(track.t) // 3
    d = block.local(truth.values[block.name], track.value(block.name))[-count:]
    return float(np.sqrt((d**2).sum(axis=1).mean()))


def test_it_converges_from_where_the_plain_filter_does_not() -> None:
    scenario = make_scenario(CIRCLE, "circle")
    found: dict[str, list[float]] = {"ekf": [], "invariant_ekf": []}
    for run in range(8):
        recording = scenario.simulate(0, run)
        problem = scenario.problem(recording, 0, run)
        for kind, angles in found.items():
            angles.append(np.degrees(last_angle(run_estimator(kind, problem), recording.truth)))
    plain, mine = (np.array(angles) for angles in found.values())
    assert (mine < plain).all()
    assert plain.max() > 5
    assert mine.max() < 1.2


def test_known_well_it_is_the_plain_filter_online_as_well() -> None:
    near = {
        "relative_attitude": {"sigma": "0.01 deg"},
        "relative_position": {"sigma": "1 mm"},
        "gyro_bias": {"sigma": 1e-5},
    }
    scenario = make_scenario({**CIRCLE, "prior": near}, "circle")
    problem = scenario.problem(scenario.simulate(0), 0)
    ekf, mine = (run_estimator(kind, problem) for kind in ("ekf", "invariant_ekf"))
    assert mine.status == "ok"
    for block in problem.layout:
        sigma = np.sqrt(np.diagonal(ekf.covariance(block.name), axis1=1, axis2=2))
        apart = block.local(ekf.value(block.name), mine.value(block.name))
        assert np.abs(apart / sigma).max() < 0.05
        assert np.abs(apart).max() > 0
    engine = InvariantEkf().engine(problem)
    state = engine.begin()
    for epoch in problem.epochs:
        state = engine.advance(state, epoch)
    last = {b.name: mine.value(b.name)[-1] for b in problem.layout}
    np.testing.assert_allclose(state.x, problem.layout.pack(last), rtol=0, atol=1e-12)


def test_a_pose_relative_to_o_is_refused_and_so_is_what_is_considered() -> None:
    scenario = load_scenario(EXPERIMENTS / "zhang2015.toml", ["time.epochs=3"])
    with pytest.raises(ModelError, match="expected relative_attitude R_tc"):
        run_estimator("invariant_ekf", scenario.problem(scenario.simulate(0), 0))
    prior = {**CIRCLE["prior"], "gyro_bias": {"sigma": 0.01, "considered": True}}
    scenario = make_scenario({**CIRCLE, "prior": prior}, "circle")
    with pytest.raises(InputError, match="expected none for an invariant filter"):
        run_estimator("invariant_ekf", scenario.problem(scenario.simulate(0), 0))
