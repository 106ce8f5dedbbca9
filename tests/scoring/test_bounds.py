"""Bounds: exact where theory is exact, and what consistent estimators come close to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from passes import ZHANG, linear_problem

from relnav_graph.core.track import Truth
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.bounds import bounds, true_trajectory


@pytest.mark.parametrize(("bound", "estimator"), [("filtered", "ekf"), ("smoothed", "rts")])
def test_on_a_linear_pass_the_bound_is_the_estimators_covariance(
    bound: str, estimator: str
) -> None:
    problem = linear_problem(0.02)
    somewhere = np.zeros((len(problem.epochs), problem.layout.size))
    found = getattr(bounds(problem, somewhere), bound)
    track = run_estimator(estimator, problem)
    np.testing.assert_allclose(found.P, track.P, rtol=1e-7, atol=1e-12)
    assert found.kind == track.kind


def test_along_the_truth_it_is_what_estimators_say_of_themselves() -> None:
    scenario = load_scenario(ZHANG, ("time.epochs=60",))
    recording = scenario.simulate(5)
    problem = scenario.problem(recording, 5)
    found = bounds(problem, true_trajectory(problem, recording.truth))
    for track, bound in (("iekf", found.filtered), ("batch", found.smoothed)):
        P = run_estimator(track, problem).P
        ratio = np.sqrt(np.einsum("kii->ki", P[30:]) / np.einsum("kii->ki", bound.P[30:]))
        assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
        assert np.abs(ratio - 1).max() < 0.2


def test_a_truth_that_lacks_something_gives_no_trajectory() -> None:
    scenario = load_scenario(ZHANG, ("time.epochs=5",))
    recording = scenario.simulate(5)
    truth, problem = recording.truth, scenario.problem(recording, 5)
    assert truth is not None
    fewer = {k: v for k, v in truth.values.items() if k != "gyro_bias"}
    for wrong, words in (
        (None, "no truth"),
        (replace(truth, values=fewer), "gyro_bias"),
        (Truth(truth.t + 0.5, truth.values), "every epoch"),
        (replace(truth, values={**fewer, "gyro_bias": np.full((5, 3), np.nan)}), "every epoch"),
    ):
        with pytest.raises(InputError, match=words):
            true_trajectory(problem, wrong)
    x = true_trajectory(problem, truth)
    np.testing.assert_array_equal(problem.layout.value(x, "gyro_bias"), truth.values["gyro_bias"])
