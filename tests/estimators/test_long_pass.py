"""A pass smoothed in parts is the pass smoothed at once."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from passes import ZHANG, differences, sigmas, toy_measurements, toy_problem
from static_tracks import drifting_pass

from relnav_graph.core.problem import Problem
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.long_pass import smooth_long_pass
from relnav_graph.scenario.build import load_scenario


def _zhang() -> Problem:
    scenario = load_scenario(ZHANG, ["time.epochs=120"])
    return scenario.problem(scenario.simulate(2), 2)


@pytest.mark.parametrize(
    ("problem", "part"),
    [(_zhang, 50), (_zhang, 40), (lambda: toy_problem(toy_measurements()), 7)],
)
def test_parts_give_what_batch_gives(problem: object, part: int) -> None:
    """The gyro's bias and the inertia are seen by the whole pass only: what a part knows of
    them comes from all others, before and after."""
    whole: Problem = problem()  # type: ignore[operator]
    batch = run_estimator("batch", whole)
    assert batch.status == "ok", batch.message
    first = replace(whole, epochs=whole.epochs[:1])
    tracks = list(smooth_long_pass(first, iter(whole.epochs[1:]), part=part))[::-1]
    assert len(tracks) == -(-len(whole.epochs) // part)
    np.testing.assert_array_equal(np.concatenate([t.t for t in tracks]), batch.t)
    x, P = (np.concatenate([getattr(t, a) for t in tracks]) for a in ("x", "P"))
    sigma = sigmas(batch.P)
    assert np.abs(differences(whole.layout, batch.x, x) / sigma).max() < 1e-3
    assert np.abs((P - batch.P) / (sigma[:, :, None] * sigma[:, None, :])).max() < 1e-3


@pytest.mark.parametrize("part", [1, 5, 11])
def test_parts_share_the_value_of_a_constant(part: int) -> None:
    """The filter of each part ends with another value; the parts must not keep theirs."""
    problem, _ = drifting_pass(epochs=12)
    batch = run_estimator("batch", problem)
    sigma = sigmas(batch.covariance("range_drift"))[0]
    for track in smooth_long_pass(problem, part=part):
        assert (
            np.abs(track.value("range_drift") - batch.value("range_drift")[0]) < 1e-3 * sigma
        ).all()
        np.testing.assert_allclose(
            track.covariance("range_drift"),
            batch.covariance("range_drift")[:1].repeat(len(track.t), 0),
            rtol=1e-3,
        )
        r, rows = track.value("relative_position"), np.searchsorted(batch.t, track.t)
        assert np.abs(r - batch.value("relative_position")[rows]).max() < 1e-4


def test_memory_grows_by_little_more_than_the_trajectory() -> None:
    """A matrix of each part, kept by accident, would be 3 kB per epoch."""
    scenario = load_scenario(ZHANG, ["time.epochs=1500"])
    problem = scenario.problem(scenario.simulate(0), 0)
    peaks = []
    for count in (500, 1500):
        first = replace(problem, epochs=problem.epochs[:1])
        tracemalloc.start()
        for _ in smooth_long_pass(first, iter(problem.epochs[1:count]), part=50):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / 1000 < 2000
