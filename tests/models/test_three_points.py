"""The frame of three points: its axes, its covariance, what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS
from relnav_factors.sensors.three_point_attitude import ThreePointAttitude, frame_of, frame_slopes

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.numeric import differences
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.maths import so3
from relnav_graph.runs.passes import simulated_pass
from relnav_graph.scenario.build import load_scenario
from relnav_graph.sim.sensors import Timing, measure_once

POINTS = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.3, 0.9, 0.0]])
PLACE = np.array([1.0, -2.0, 15.0])


def sensor(**options: Any) -> ThreePointAttitude:
    given: dict[str, Any] = {"triangle": POINTS, "origin": PLACE, "seen_from": "fixed"} | options
    return ThreePointAttitude(sigma=np.array([0.006, 0.004, 0.012]), **given)


def test_the_frame_is_that_of_the_points_whatever_the_attitude() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        R = so3.exp(rng.normal(size=3))
        axes, sides = frame_of((PLACE + POINTS @ R.T)[None])
        np.testing.assert_allclose(axes[0], R, atol=1e-14)
        np.testing.assert_allclose(sides[0], [1.2, 0.3, 0.9], atol=1e-14)


def test_turns_of_the_frame_agree_with_differences() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        points = rng.normal(size=(3, 3))
        axes = frame_of(points[None])[0][0]

        def turn(d: Array, points: Array = points, axes: Array = axes) -> Array:
            moved = frame_of((points + d.reshape(3, 3))[None])[0][0]
            return so3.log(np.ascontiguousarray(axes.T @ moved))

        numeric = differences(turn, np.full(9, 1e-6))
        slopes = frame_slopes(points[None])[0]
        np.testing.assert_allclose(slopes, numeric, atol=1e-8 * np.abs(numeric).max())


def test_the_attitude_has_the_covariance_of_the_scattered_points() -> None:
    """As simulated: nine independent errors, of which the covariance of three angles follows."""
    s, rng, R_it = sensor(), np.random.default_rng(2), so3.exp(np.array([0.3, -1.0, 0.7]))
    x, white = (np.ascontiguousarray(R_it),), []
    for _ in range(4000):
        m = measure_once("s", s, Timing(), 0.0, x, rng)
        assert m is not None
        e = -s.residual(m, *x)[0]
        white.append(np.linalg.solve(np.linalg.cholesky(s.noise(m)[0]), e))
    found = np.cov(np.array(white).T)
    np.testing.assert_allclose(found, np.eye(3), atol=5 * np.sqrt(2 / 4000))
    # About the longest side, x, what counts is the depth of P3 across it.
    assert m is not None
    sigmas = np.degrees(np.sqrt(np.diag(s.noise(m)[0])))
    assert 0.2 < sigmas.min() < sigmas.max() < 1.5


def test_row_47_points_on_a_line_make_no_frame() -> None:
    line = np.array([[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [2.0, 1e-9, 5.0]])
    m = Measurement("s", 1.0, line.reshape(1, 9), np.zeros(1, np.int64))
    with pytest.raises(InputError, match="expected three not on a line"):
        sensor().residual(m, np.eye(3))
    with pytest.raises(InputError, match="expected columns"):
        sensor().accept(line)
    for wrong in (POINTS[[0, 2, 1]], line, -POINTS):
        with pytest.raises(InputError, match="make the frame t"):
            sensor(triangle=wrong)
    with pytest.raises(InputError, match="triangle: found none"):
        sensor(triangle=None).predict(np.zeros(1, np.int64), np.eye(3))


def test_the_front_end_is_as_good_as_the_attitude_that_it_makes() -> None:
    """hu2019 by its points: consistent, and about as good as with 0.5 deg about each axis."""
    path, nees = EXPERIMENTS / "hu2019_points.toml", []
    scenario = load_scenario(path, ["time.epochs=101"])
    for seed in range(8):
        found = simulated_pass(scenario, seed)
        track = run_estimator("batch", found.problem)
        assert track.status == "ok"
        assert found.recording.truth is not None
        true = found.recording.truth.values["target_attitude"]
        e = np.array(
            [
                so3.log(np.ascontiguousarray(a.T @ b))
                for a, b in zip(track.value("target_attitude"), true, strict=True)
            ]
        )
        P = track.covariance("target_attitude")
        nees.append(np.einsum("ki,kij,kj->k", e, np.linalg.inv(P), e).mean() / 3)
    assert 0.5 < np.mean(nees) < 1.6
