"""Row 56: constants without a prior, never seen, seen once; closures to epochs that are gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closures import PAIRS, looped_problem
from passes import EXPERIMENTS

from relnav_graph.core.copies import closure_name
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.online.driver import online
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.schema import ScenarioError

KINDS = ["ekf", "iekf", "rts", "batch", "incremental", "fixed_lag", "isam2"]
MOUNT = ("camera_misalignment", "camera_displacement")


def short(*changes: str) -> Problem:
    scenario = load_scenario(EXPERIMENTS / "mounting.toml", ["time.epochs=6", *changes])
    return scenario.problem(scenario.simulate(0), 0)


def sigmas(track: Track, *names: str) -> np.ndarray:
    return np.concatenate([np.sqrt(np.diag(track.covariance(n)[-1])) for n in names])


def test_row_56_a_constant_without_a_prior_is_named() -> None:
    tables = dict(load_scenario(EXPERIMENTS / "mounting.toml", ["time.epochs=6"]).raw)
    tables["prior"] = {k: v for k, v in tables["prior"].items() if k not in MOUNT}
    with pytest.raises(ScenarioError) as raised:
        make_scenario(tables, "no prior")
    assert {path for path, _ in raised.value.problems} == {f"prior.{name}" for name in MOUNT}
    problem = short()
    prior = replace(problem.prior, x=problem.prior.x[:-3], P=problem.prior.P[:-3, :-3])
    with pytest.raises(InputError, match="a static block is read"):
        replace(problem, prior=prior)


@pytest.mark.parametrize("kind", KINDS)
def test_row_56_a_constant_that_is_never_seen_keeps_its_prior(kind: str) -> None:
    problem = short('sensors.camera.begin="100 s"')
    track = run_estimator(kind, problem)
    assert track.status == "ok"
    layout = problem.layout
    for name in MOUNT:
        mean = layout.value(problem.prior.x, name)
        np.testing.assert_allclose(track.value(name)[-1], mean, rtol=0, atol=1e-12)
        rows = layout.tangent(name)
        prior = np.sqrt(np.diag(problem.prior.P))[rows]
        np.testing.assert_allclose(sigmas(track, name), prior, rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_row_56_a_constant_that_is_seen_once_keeps_what_it_told(kind: str) -> None:
    problem = short('sensors.camera.begin="2 s"', 'sensors.camera.end="3 s"')
    assert sum(m.sensor == "camera" for e in problem.epochs for m in e.measurements) == 1
    track, never = run_estimator(kind, problem), short('sensors.camera.begin="100 s"')
    assert track.status == "ok"
    prior = sigmas(run_estimator(kind, never), *MOUNT)
    found = sigmas(track, *MOUNT)
    assert (found <= prior * (1 + 1e-9)).all()
    assert np.isfinite(found).all()
    assert found.min() < 0.999 * prior[found.argmin()]


@pytest.mark.parametrize("kind", ["ekf", "incremental", "fixed_lag", "isam2"])
def test_row_56_a_closure_to_an_epoch_that_has_left_the_window_is_taken(kind: str) -> None:
    """Its copy is a constant, and stays; nothing else would know that epoch any more."""
    problem = looped_problem()
    assert max(b - a for a, b in PAIRS) > 4.0
    track = run_estimator(kind, replace(problem, window=4.0))
    whole = run_estimator("batch", problem)
    sigma = np.sqrt(np.diag(whole.P[-1]))
    assert np.abs((track.x[-1] - whole.x[-1]) / sigma).max() < 1e-5


@pytest.mark.parametrize("kind", ["ekf", "incremental", "fixed_lag", "isam2"])
def test_row_56_a_closure_to_an_epoch_that_never_came_is_refused_by_name(kind: str) -> None:
    problem = looped_problem()
    engine = online(kind, replace(problem, epochs=()))
    engine.step(problem.epochs[0])
    inputs = {"motion": np.array([[12.0]])}
    x = engine.x.copy()
    with pytest.raises(InputError, match=r"'loop\.5' .* no epoch was there to be copied at 5\.0 s"):
        engine.step(replace(problem.epochs[12], inputs=inputs))
    np.testing.assert_array_equal(engine.x, x)
    kept = [m for m in problem.epochs[12].measurements if m.sensor != closure_name("loop", 5.0)]
    engine.step(replace(problem.epochs[12], inputs=inputs, measurements=tuple(kept)))
