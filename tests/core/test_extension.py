"""New models in one file, `toy_model.py`, run everywhere with no edit elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from passes import ESTIMATORS, differences, sigmas, stored
from scipy.special import chdtri
from toy_model import RANGE_DRIFT, DriftingRange, ThermalDrift

from relnav_graph.arrays import Array
from relnav_graph.cli.main import main
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording, Track, Truth
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

SCENARIO = """
title = "a laser ranger that drifts with its temperature"

[time]
step = "2 s"
epochs = 40

[processes.motion]
kind = "white_noise_acceleration"
acceleration_density = "1 mm/s^1.5"

[processes.electronics]
kind = "toy_model:ThermalDrift"
time_constant = "1 min"
density = "2 mm/sqrt(s)"

[sensors.ranger]
kind = "toy_model:DriftingRange"
points = [[2, 0, 0], [-2, 0, 1], [0, 2, -1], [0, -2, 0], [1, 1, 2]]
sigma = "5 mm"

[prior]
relative_position = { sigma = "1 m" }
relative_velocity = { sigma = "2 cm/s" }
range_drift = { sigma = "20 cm", mean = [0] }

[truth]
kind = "own_models"

[truth.initial]
relative_position = [9, -6, 4]
relative_velocity = [-0.02, 0.01, 0]
range_drift = [0.15]
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("toy") / "toy.toml"
    out.write_text(SCENARIO, "utf-8")
    return out


@pytest.fixture(scope="module")
def scenario(path: Path) -> Scenario:
    return load_scenario(path)


def _pass(scenario: Scenario, run: int) -> tuple[Recording, Problem]:
    recording = scenario.simulate(0, run)
    return recording, scenario.problem(recording, 0, run)


def _last_error(track: Track, truth: Truth | None) -> Array:
    assert truth is not None
    return np.asarray(differences(track.layout, track.x, stored(track.layout, truth))[-1])


def test_the_state_is_made_of_built_in_and_new_blocks(scenario: Scenario) -> None:
    names = [b.name for b in scenario.layout]
    assert names == ["relative_position", "relative_velocity", "range_drift"]
    assert scenario.layout.block("range_drift") is RANGE_DRIFT
    assert isinstance(scenario.processes["electronics"], ThermalDrift)
    assert isinstance(scenario.sensors["ranger"], DriftingRange)


def test_jacobians_equal_differences_also_far_from_zero_residual() -> None:
    rng = np.random.default_rng(1)
    sensor = DriftingRange(points=rng.normal(size=(4, 3)), sigma=0.01)
    drift = ThermalDrift(time_constant=30.0, density=0.01)
    layout, step = Layout(sensor.reads), 1e-5
    for _ in range(20):
        x = rng.normal(size=4) * [5, 5, 5, 1]
        m = Measurement("ranger", 0.0, rng.normal(size=(4, 1)), np.arange(4))
        columns = []
        for d in step * np.eye(4):
            r = [
                sensor.residual(m, *layout.values(layout.retract(x, s)).values())[0]
                for s in (d, -d)
            ]
            columns.append((r[0] - r[1]) / (2 * step))
        H = np.hstack(sensor.residual(m, *layout.values(x).values())[1])
        np.testing.assert_allclose(H, np.array(columns).T, atol=1e-8)
        _, F, _ = drift.transition(0.0, np.array([[7.0]]), x[3:])
        ends = [drift.propagate(0.0, np.array([[7.0]]), x[3:] + s)[0] for s in (step, -step)]
        np.testing.assert_allclose(F, [(ends[0] - ends[1]) / (2 * step)], atol=1e-9)


def test_process_noise_composes() -> None:
    """Two short intervals make one long one; a row per sub-interval does the same."""
    drift = ThermalDrift(time_constant=30.0, density=0.01)
    x = np.array([0.4])
    (middle,), F1, Q1 = drift.transition(0.0, np.array([[7.0]]), x)
    (end,), F2, Q2 = drift.transition(7.0, np.array([[13.0]]), middle)
    (once,), F, Q = drift.transition(0.0, np.array([[7.0], [13.0]]), x)
    np.testing.assert_allclose(end, once, rtol=1e-12)
    np.testing.assert_allclose(F2 @ F1, F, rtol=1e-12)
    np.testing.assert_allclose(F2 @ Q1 @ F2.T + Q2, Q, rtol=1e-12)


def test_impossible_geometry_and_unknown_ids_are_named() -> None:
    sensor = DriftingRange(points=np.zeros((1, 3)), sigma=0.01)
    m = Measurement("ranger", 3.0, np.ones((1, 1)), np.array([0]))
    with pytest.raises(GeometryError, match=r"id 0 at t = 3\.0 s: the chaser stands on the refl"):
        sensor.residual(m, np.zeros(3), np.zeros(1))
    with pytest.raises(InputError, match="found id 7, expected 0 to 0"):
        sensor.observation_data(np.array([7]))


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_every_estimator_runs_the_new_models_and_learns_the_drift(
    scenario: Scenario, kind: str
) -> None:
    recording, problem = _pass(scenario, 0)
    track = run_estimator(kind, problem)
    assert track.status == "ok", track.message
    assert track.rejected == {"ranger": 0}
    sigma = np.sqrt(track.covariance("range_drift")[-1, 0, 0])
    assert sigma < 0.05  # a quarter of the prior
    n = track.layout.dim
    e, P = _last_error(track, recording.truth), track.P[-1]
    assert e @ np.linalg.solve(P, e) < chdtri(n, 1e-4)


@pytest.mark.parametrize("kind", ["iekf", "batch"])
def test_errors_are_as_large_as_predicted(scenario: Scenario, kind: str) -> None:
    runs = 12
    total = 0.0
    for run in range(runs):
        recording, problem = _pass(scenario, run)
        track = run_estimator(kind, problem)
        e, P = _last_error(track, recording.truth), track.P[-1]
        total += float(e @ np.linalg.solve(P, e))
    assert chdtri(7 * runs, 0.99) < total < chdtri(7 * runs, 0.01)


def test_smoothers_agree_and_know_more_than_filters(scenario: Scenario) -> None:
    _, problem = _pass(scenario, 3)
    tracks = {kind: run_estimator(kind, problem) for kind in ESTIMATORS}
    smoothed, batch = tracks["incremental"].smoothed, tracks["batch"]
    assert smoothed is not None
    sigma = sigmas(batch.P)
    assert np.abs((smoothed.x - batch.x) / sigma).max() < 1e-3
    np.testing.assert_allclose(smoothed.P, batch.P, rtol=1e-3, atol=1e-9)
    filtered = sigmas(tracks["iekf"].P)
    assert (sigma[:-1] <= 1.02 * filtered[:-1]).all()
    assert sigma[0, 6] < 0.75 * filtered[0, 6]


def test_command_line_runs_it_and_a_data_set_keeps_it(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Simulated, written, read back and smoothed: the new sensor's table and block too."""
    folder, out = tmp_path / "data", tmp_path / "out"
    with pytest.raises(SystemExit, match="0"):
        main(["compare", str(path), "-e", "batch", "--seed", "4", "--json"])
    direct = json.loads(capsys.readouterr().out)["estimators"]["batch"]["states"]
    with pytest.raises(SystemExit, match="0"):
        main(["simulate", str(path), "--seed", "4", "-o", str(folder)])
    assert (folder / "ranger.csv").read_text().startswith("t_s,id,range_m\n")
    with pytest.raises(SystemExit, match="0"):
        main(["smooth", str(folder), "-o", str(out), "--json", "--trust"])
    stored = json.loads(capsys.readouterr().out)["estimators"]["batch"]["states"]
    assert direct["range_drift"]["unit"] == "m"
    assert stored == direct
