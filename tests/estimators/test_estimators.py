"""Gaps, outliers, impossible geometry, divergence: what every estimator does with them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import pytest
from passes import (
    ESTIMATORS,
    FIX,
    PRIOR,
    PROCESSES,
    RANGER,
    SENSORS,
    ZHANG,
    beyond_digits,
    differences,
    rows_of,
    sigmas,
    stored,
    toy_measurements,
    toy_problem,
)
from relnav_factors.dynamics.gyro_bias import GyroBias
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from relnav_factors.sensors.stereo_point import StereoPoint
from scipy.special import chdtri
from toy_model import RANGE_DRIFT

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track
from relnav_graph.errors import GeometryError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.gauss_newton import Solution, solve
from relnav_graph.estimators.incremental import IncrementalSmoother, SmootherState
from relnav_graph.linear.assembly import Assembly
from relnav_graph.scenario.build import load_scenario

GATE = 1 - 1e-6


def _moved(found: Track, reference: Track) -> float:
    """Largest distance between two tracks, in sigmas."""
    return float(np.abs((found.x - reference.x) / sigmas(reference.P)).max())


# --- gaps ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_epochs_without_measurements_are_bridged(kind: str) -> None:
    """Sigma grows over the gap and comes back after it; a smoother knows both sides."""
    gap = [m for m in toy_measurements() if not 10 < m.t < 20]
    track = run_estimator(kind, toy_problem(gap))
    assert track.status == "ok", track.message
    assert np.isfinite(track.x).all()
    assert track.rejected == {"fix": 0, "ranger": 0}
    sigma = np.sqrt(track.P[:, 0, 0])
    if track.kind == "filtered":
        assert (np.diff(sigma[10:20]) > 0).all()
        assert sigma[20] < 0.8 * sigma[19]
    for row in rows_of(track):
        if row.kind == "smoothed":
            sigma = np.sqrt(row.P[:, 0, 0])
            assert sigma[11:20].argmax() in range(2, 7)  # the middle of the gap is worst


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_no_measurement_at_all_leaves_the_prior(kind: str) -> None:
    track = run_estimator(kind, toy_problem([]))
    assert track.status == "degraded"  # nothing but the prior: no estimate to trust
    assert "not one observation" in track.message
    np.testing.assert_allclose(track.x[0], PRIOR.x)
    np.testing.assert_allclose(track.P[0], PRIOR.P, atol=1e-12)
    assert track.P[-1, 0, 0] > PRIOR.P[0, 0]


# --- outliers --------------------------------------------------------------------------------


def _with_outlier(many: float) -> list[Measurement]:
    """One range of epoch 15 is off by that many sigmas."""
    out, offset = [], np.array([[0.0], [many * RANGER.sigma], [0.0]])
    for m in toy_measurements():
        if m.sensor == "ranger" and m.t == 15.0:
            out.append(replace(m, z=m.z + offset))
        else:
            out.append(m)
    return out


@pytest.mark.parametrize("kind", ESTIMATORS)
@pytest.mark.parametrize("many", [100.0, 1e6])
def test_gate_rejects_and_counts_an_outlier(kind: str, many: float) -> None:
    gates = {"ranger": GATE}
    clean = run_estimator(kind, toy_problem(toy_measurements(), gates=gates))
    track = run_estimator(kind, toy_problem(_with_outlier(many), gates=gates))
    for row, reference in zip(rows_of(track), rows_of(clean), strict=True):
        assert reference.rejected == {"fix": 0, "ranger": 0}
        assert row.rejected == {"fix": 0, "ranger": 1}
        assert row.status == "ok"
        assert _moved(row, reference) < 0.5


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_without_a_gate_an_outlier_is_used(kind: str) -> None:
    clean = run_estimator(kind, toy_problem(toy_measurements()))
    for gates in ({}, {"fix": GATE}):  # a gate on another sensor is no gate on this one
        track = run_estimator(kind, toy_problem(_with_outlier(100.0), gates=gates))
        for row, reference in zip(rows_of(track), rows_of(clean), strict=True):
            assert row.rejected["ranger"] == 0
            assert _moved(row, reference) > 3


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_losing_most_of_a_sensor_is_degraded(kind: str) -> None:
    bad = [
        replace(m, z=m.z + 5.0) if m.sensor == "fix" and m.t > 8 else m for m in toy_measurements()
    ]
    track = run_estimator(kind, toy_problem(bad, gates={"fix": 0.999}))
    assert track.status == "degraded"
    assert "21 of 30 observations of fix rejected" in track.message


# --- impossible geometry ------------------------------------------------------------------------

CAMERA = StereoPoint(
    points=np.array([[1.0, 0, 0], [0, 1, 0], [-1, -1, 0.5], [0.3, 0, -20]]),
    pose="target",
    fu=500.0,
    fv=500.0,
    cu=320.0,
    cv=240.0,
    baseline=0.2,
    pixel_sigma=np.full(4, 0.5),
)
#: R_tc is the identity: the camera at z = -5 m sees the first three points, not the fourth.
POSE = np.eye(3), np.array([0.0, 0.0, -5.0])


def _camera_problem(behind_at: set[int]) -> Problem:
    processes: dict[str, Any] = {
        "attitude": GyroBias(
            attitude="relative_attitude",
            angle_random_walk_density=np.array(1e-3),
            bias_random_walk_density=np.array(1e-6),
        ),
        "motion": WhiteNoiseAcceleration(acceleration_density=0.001, pose="target"),
    }
    rng = np.random.default_rng(2)
    ids = np.arange(3)
    measurements = []
    for k in range(12):
        z = CAMERA.predict(ids, *POSE) + 0.5 * rng.normal(size=(3, 4))
        m = Measurement("camera", float(k), z, ids)
        if k in behind_at:  # a wrong match
            z = np.vstack([z, [[320.0, 240.0, 300.0, 240.0]]])
            m = Measurement("camera", float(k), z, np.arange(4))
        measurements.append(m)
    gyro = InputSeries("gyro", np.array([0.0]), np.array([11.0]), np.zeros((1, 3)))
    epochs = make_epochs(processes, measurements, {"gyro": gyro})
    x = np.concatenate([np.eye(3).ravel(), np.zeros(3), POSE[1], np.zeros(3)])
    P = np.diag([0.01] * 3 + [1e-8] * 3 + [0.01] * 3 + [1e-4] * 3)
    sensors: dict[str, Any] = {"camera": CAMERA}
    return Problem(processes, sensors, Prior(x, P), epochs)


def test_model_raises_on_a_point_behind_the_camera() -> None:
    m = Measurement("camera", 7.0, np.zeros((1, 4)), np.array([3]))
    with pytest.raises(GeometryError, match=r"id 3 at t = 7\.0 s: the point is behind the camera"):
        CAMERA.residual(m, *POSE)
    with pytest.raises(GeometryError, match="id 3 at depth -15 m"):
        CAMERA.predict(np.array([3]), *POSE)


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_estimator_skips_and_counts_a_point_behind_the_camera(kind: str) -> None:
    """The rest of the epoch is used: the estimate is that without the impossible rows."""
    track = run_estimator(kind, _camera_problem({0, 4, 5}))
    reference = run_estimator(kind, _camera_problem(set()))
    for row, expected in zip(rows_of(track), rows_of(reference), strict=True):
        assert row.status == "ok", row.message
        assert row.rejected == {"camera": 3}
        assert expected.rejected == {"camera": 0}
        np.testing.assert_allclose(row.x, expected.x, atol=1e-12)
        np.testing.assert_allclose(row.P, expected.P, atol=1e-15)


# --- divergence -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [k for k in ESTIMATORS if k not in ("ukf", "iukf")])
def test_divergence_is_a_status_and_a_nan_tail(kind: str) -> None:
    """A prior of 10 km against fixes of 0.1 mm: no covariance can carry both. Its root, which the
    unscented filters carry instead, can."""
    track = run_estimator(kind, beyond_digits())
    for row in rows_of(track):
        assert row.status == "diverged"
        assert row.message
        assert row.x.shape == (6, 6)
        assert np.isnan(row.x[1:]).all()
        assert np.isnan(row.P[1:]).all()
    if track.kind == "filtered":
        assert np.isfinite(track.x[0]).all()
        assert "t = 1.0 s" in track.message


@jit
def runaway_kernel(
    p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array
) -> int:
    """d' = d / second, until the electronics burn."""
    growth = np.exp(u[:, 0].sum())
    if abs(growth * x[0]) > 1e3:
        return 1
    x_next[0] = growth * x[0]
    F[0, 0] = growth
    Q[0, 0] = 1e-6
    return 0


@dataclass(frozen=True)
class Runaway(DynamicsModel):
    kind: ClassVar[str] = "toy_runaway"
    kernel = staticmethod(runaway_kernel)
    failures = {1: "the electronics burn"}

    @property
    def advances(self) -> tuple[Block, ...]:
        return (RANGE_DRIFT,)


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_a_state_that_cannot_be_propagated_is_divergence(kind: str) -> None:
    prior = Prior(PRIOR.x + 0.5 * np.eye(7)[6], PRIOR.P)
    processes: dict[str, Any] = {"motion": PROCESSES["motion"], "electronics": Runaway()}
    epochs = make_epochs(processes, [], {}, np.arange(12.0))
    track = run_estimator(kind, Problem(processes, SENSORS, prior, epochs))
    for row in rows_of(track):
        assert row.status == "diverged"
        assert "the electronics burn" in row.message
        assert np.isnan(row.x[-1]).all()
    if track.kind == "filtered":
        assert np.isfinite(track.x[:7]).all()


# --- convergence, repetition, immutability ---------------------------------------------------


@pytest.mark.parametrize("run", range(4))
def test_batch_converges_from_a_poor_prior(run: int) -> None:
    """Attitude of the target off by tens of degrees, rate and inertia unknown. It ends at a
    stationary point, which is not above the one that is found from the truth itself."""
    settings = ("time.epochs=30", 'prior.target_attitude.sigma="15 deg"')
    scenario = load_scenario(ZHANG, settings)
    recording = scenario.simulate(0, run)
    problem = scenario.problem(recording, 0, run)
    track = run_estimator("batch", problem)
    assert track.status == "ok", track.message
    layout = problem.layout
    assert recording.truth is not None
    xs = stored(layout, recording.truth)
    assembly = Assembly(layout, problem.processes, problem.sensors, problem.epochs)
    weights = np.ones(assembly.observations)
    found = solve(assembly, problem.prior, track.x, weights, tolerance=1e-6)
    d = differences(layout, track.x, found.x)
    assert np.abs(d / sigmas(track.P)).max() < 0.02
    assert found.cost < solve(assembly, problem.prior, xs, weights).cost + 1e-3
    e = layout.local(track.x[-1], xs[-1])
    assert e @ np.linalg.solve(track.P[-1], e) < chdtri(layout.dim, 1e-4)


@pytest.mark.parametrize("run", range(4))
def test_solver_converges_from_the_truth(run: int) -> None:
    """The best start that there is, in a valley that is narrow and bent: the first full
    step raises the cost, and the next ones are quadratic."""
    scenario = load_scenario(ZHANG, ("time.epochs=30",))
    recording = scenario.simulate(0, run)
    problem = scenario.problem(recording, 0, run)
    assert recording.truth is not None
    xs = stored(problem.layout, recording.truth)
    assembly = Assembly(problem.layout, problem.processes, problem.sensors, problem.epochs)
    found = solve(assembly, problem.prior, xs, np.ones(assembly.observations))
    assert found.distance < 0.1
    assert found.iterations < 30


def _arrays(problem: Problem) -> list[bytes]:
    out = [problem.prior.x.tobytes(), problem.prior.P.tobytes()]
    for epoch in problem.epochs:
        out += [u.tobytes() for u in epoch.inputs.values()]
        out += [a.tobytes() for m in epoch.measurements for a in (m.z, m.ids)]
    out += [p.constants().tobytes() for p in problem.processes.values()]
    out += [s.constants().tobytes() for s in problem.sensors.values()]
    return out


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_same_seed_same_bits_and_the_problem_stays(kind: str) -> None:
    tracks = []
    for _ in range(2):
        scenario = load_scenario(ZHANG, ("time.epochs=15",))
        problem = scenario.problem(scenario.simulate(5), 5)
        before = _arrays(problem)
        tracks.append(run_estimator(kind, problem))
        again = run_estimator(kind, problem)
        assert _arrays(problem) == before
        assert again.x.tobytes() == tracks[-1].x.tobytes()
    for a, b in zip(rows_of(tracks[0]), rows_of(tracks[1]), strict=True):
        assert a.x.tobytes() == b.x.tobytes()
        assert a.P.tobytes() == b.P.tobytes()
    other = load_scenario(ZHANG, ("time.epochs=15",))
    different = run_estimator(kind, other.problem(other.simulate(6), 6))
    assert different.x.tobytes() != tracks[0].x.tobytes()


def test_a_problem_cannot_be_changed() -> None:
    problem = toy_problem(toy_measurements())
    with pytest.raises(AttributeError):
        problem.prior = PRIOR  # type: ignore[misc]
    with pytest.raises(TypeError):
        problem.sensors["fix"] = FIX  # type: ignore[index]
    with pytest.raises(ValueError, match="read-only"):
        RANGER.points[0, 0] = 1.0


def test_incremental_relinearises_on_a_geometric_schedule(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each relinearisation takes the whole history; that their number grows only with the
    logarithm of it is what keeps the cost of a step flat."""
    at: list[int] = []
    relinearize = IncrementalSmoother._relinearized

    def counted(
        self: IncrementalSmoother, s: SmootherState, tolerance: float
    ) -> tuple[SmootherState, Assembly, Solution]:
        at.append(s.count)
        return relinearize(self, s, tolerance)

    monkeypatch.setattr(IncrementalSmoother, "_relinearized", counted)
    fixes = [m for m in toy_measurements(200) if m.sensor == "fix"]
    epochs = make_epochs(PROCESSES, fixes, {})
    smoother = IncrementalSmoother(Problem(PROCESSES, SENSORS, PRIOR, epochs), 1.5)
    for epoch in epochs:
        smoother.step(epoch)
    assert at[:4] == [1, 2, 3, 5]
    assert all(b / a >= 1.5 - 1e-9 for a, b in pairwise(at))
    assert all(b <= 1.5 * a + 1 for a, b in pairwise(at))
    assert 1.5 * at[-1] + 1 > 200
    assert sum(at) < 3.5 * 200  # ratio / (ratio - 1) epochs relinearised for each new one
