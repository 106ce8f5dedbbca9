"""Loop closures: measurements between any two epochs, through static copies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closures import PAIRS, PositionChange, direct_solution, looped_problem

from relnav_graph.core.copies import closure_name
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.online.driver import online


def apart(track: Track, x: np.ndarray, P: np.ndarray) -> float:
    """Largest difference of a component from x (N, 6), in its sigmas of P (N, 6, 6)."""
    sigma = np.sqrt(np.diagonal(P, 0, 1, 2))
    return float((np.abs(track.x - x) / sigma).max())


def smoothed(kind: str, problem: object) -> Track:
    track = run_estimator(kind, problem)  # type: ignore[arg-type]
    return track if track.smoothed is None else track.smoothed


@pytest.mark.parametrize("kind", ["rts", "batch", "incremental", "isam2"])
def test_copies_give_what_direct_rows_give(kind: str) -> None:
    problem = looped_problem()
    x, P = direct_solution(problem)
    track = smoothed(kind, problem)
    assert apart(track, x, P) < 1e-6
    sigma = np.sqrt(np.diagonal(P, 0, 1, 2))
    found = np.sqrt(np.diagonal(track.P, 0, 1, 2))
    np.testing.assert_allclose(found, sigma, rtol=1e-6)
    without = smoothed(kind, looped_problem(()))
    assert apart(without, x, P) > 1.0, "the closures tell something"


@pytest.mark.parametrize("kind", ["ekf", "iekf", "incremental", "fixed_lag", "isam2"])
def test_the_newest_epoch_is_that_of_direct_rows(kind: str) -> None:
    """Whatever has left a window: the copies stay."""
    problem = looped_problem()
    x, P = direct_solution(problem)
    track = run_estimator(kind, replace(problem, window=4.0))
    sigma = np.sqrt(np.diag(P[-1]))
    np.testing.assert_allclose(track.x[-1], x[-1], rtol=0, atol=1e-6 * sigma.min())
    np.testing.assert_allclose(np.sqrt(np.diag(track.P[-1])), sigma, rtol=1e-6)


@pytest.mark.parametrize("kind", ["ekf", "incremental", "fixed_lag"])
def test_online_copies_are_made_as_their_epochs_come(kind: str) -> None:
    problem = looped_problem()
    engine = online(kind, replace(problem, epochs=(), window=4.0))
    for epoch in problem.epochs:
        kept = [m for m in epoch.measurements if not m.sensor.endswith(".copy")]
        found = engine.step(replace(epoch, measurements=tuple(kept)))
    whole = run_estimator(kind, replace(problem, window=4.0))
    np.testing.assert_allclose(found.x[:6], whole.x[-1], rtol=0, atol=1e-9)


def test_a_closure_to_an_epoch_that_is_not_there_is_named() -> None:
    problem = looped_problem()
    name = closure_name("loop", 5.0)
    early = Measurement(name, 5.0, np.zeros((1, 3)), np.zeros(1, np.int64))
    with pytest.raises(InputError, match=r"'loop\.5': .* expected one after its keyframe, 5\.0 s"):
        replace(
            problem,
            epochs=tuple(
                replace(e, measurements=(*e.measurements, early)) if e.t == 5.0 else e
                for e in problem.epochs
            ),
        )
    sensors = dict(problem.sensors)
    sensors["loop.5.copy"] = replace(sensors["loop.5.copy"], keyframe=5.5)  # type: ignore[type-var]
    bare = tuple(replace(e, measurements=e.measurements[:1]) for e in problem.epochs)
    looped = {n: s for n, s in sensors.items() if n in ("fix", "loop.5.copy")}
    prior = looped_problem(((5.0, 12.0),)).prior
    with pytest.raises(InputError, match=r"keyframe at 5\.5 s, where there is no epoch; the near"):
        replace(problem, sensors=looped, prior=prior, epochs=bare)


@pytest.mark.parametrize("kind", ["ekf", "incremental", "fixed_lag"])
def test_online_a_closure_without_a_copy_is_refused_and_nothing_changes(kind: str) -> None:
    problem = looped_problem()
    engine = online(kind, replace(problem, epochs=()))
    closure = Measurement(closure_name("loop", 5.0), 12.0, np.zeros((1, 3)), np.zeros(1, np.int64))
    for epoch in (e for e in problem.epochs if e.t < 5.0):
        engine.step(epoch)
    x, P = engine.x.copy(), engine.P.copy()
    inputs = {"motion": np.array([[8.0]])}
    with pytest.raises(InputError, match=r"'loop\.5' at t = 12\.0 s: closure: no epoch was there"):
        engine.step(Epoch(12.0, (closure,), inputs))
    np.testing.assert_array_equal(engine.x, x)
    np.testing.assert_array_equal(engine.P, P)
    assert engine.step(Epoch(12.0, (), inputs)).t == 12.0


def test_the_silence_of_closures_is_no_alarm_and_keeps_no_estimate_alive() -> None:
    problem = looped_problem(((0.0, 2.0), (0.0, 4.0), (0.0, 6.0)))
    engine = online("ekf", replace(problem, epochs=()))
    for epoch in problem.epochs[:10]:
        engine.step(epoch)
    status, message = engine.health(30.0)
    assert status == "DEGRADED"
    assert "fix: silent" in message
    assert "loop.0: silent" not in message
    assert engine.health(9.0 + 60.0)[0] == "LOST"


def test_pairs_share_the_copy_of_a_keyframe() -> None:
    problem = looped_problem()
    changes = [s for s in problem.sensors.values() if type(s) is PositionChange]
    assert len(changes) == len({a for a, _ in PAIRS}) == len(problem.layout.statics)
