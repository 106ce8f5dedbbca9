"""Row 58: an estimate that is wrong and says ok bears a caution; one that is right does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scripts import loaded

from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.gauss_newton import solve
from relnav_graph.estimators.second_look import SECOND_LOOK, second_look
from relnav_graph.linear.assembly import Assembly
from relnav_graph.runs.comparison import Comparison, compare_pass
from relnav_graph.runs.passes import Pass, open_pass
from relnav_graph.scoring.metrics import with_smoothed

SCRIPT = Path(__file__).parents[2] / "experiments" / "random_problems.py"


def script() -> ModuleType:
    return loaded(SCRIPT)


def problem(number: int) -> Pass:
    """One of the random problems of seed 1."""
    random = script()
    rng = np.random.default_rng(1)
    for _ in range(number):
        random.variant(rng)
    return open_pass(random.ZHANG, assignments=random.variant(rng))


def words(found: Comparison, name: str) -> list[str]:
    return [c["name"] for c in found.summary["estimators"][name]["cautions"]]


@pytest.mark.parametrize("number", [328, 479, 490])
def test_row_58_a_wrong_batch_that_says_ok_is_doubted(number: int) -> None:
    """Its best fit is not the truth's solution, and lies sigmas from it: more than 5 times the
    squared error that it states. Whoever estimates the same pass is told."""
    opened = problem(number)
    found = compare_pass(opened, ["iekf", "batch"])
    batch, truth = found.track("batch"), opened.recording.truth
    assert batch.status == "ok"
    assert script().error(batch, truth) > 5
    assert words(found, "batch")[0] == SECOND_LOOK
    assert words(found, "iekf")
    assert "sigma" in batch.cautions[0].text


def test_row_58_the_look_is_the_same_each_time_and_in_the_graph() -> None:
    opened = problem(479)
    found = compare_pass(opened, ["batch", "incremental"])
    again = compare_pass(opened, ["batch"])
    assert found.track("batch").cautions == again.track("batch").cautions
    rows = with_smoothed(found.tracks)
    assert rows["incremental"].cautions == rows["incremental_smoothed"].cautions
    assert words(found, "incremental_smoothed")[0] == SECOND_LOOK


def test_row_58_a_wrong_filter_is_told_by_the_smoother() -> None:
    """The filter of a problem whose batch estimate is right."""
    opened = problem(200)
    found = compare_pass(opened, ["iekf", "batch"])
    truth = opened.recording.truth
    iekf, batch = found.tracks
    assert (iekf.status, batch.status) == ("ok", "ok")
    assert script().error(iekf, truth) > 5
    assert script().error(batch, truth) < 2
    assert words(found, "iekf")[0] in ("distance", "overconfident")
    assert words(found, "batch") == []


def test_row_58_covariances_that_rounding_has_spoilt_leave_the_estimate_as_it_is() -> None:
    problem_ = problem(201).problem
    assembly = Assembly.of(problem_)
    track = run_estimator("batch", problem_)
    solution = solve(assembly, problem_.prior, track.x, np.ones(assembly.observations))
    found = solution.conditionals.marginals()
    spoilt = replace(found, P=found.P.copy())
    spoilt.P[0, 1, 1] = -spoilt.P[0, 1, 1]
    (caution,) = second_look(assembly, problem_.prior, solution, spoilt)
    assert caution.name == SECOND_LOOK
    assert "no second look could be taken" in caution.text
    assert second_look(assembly, problem_.prior, solution, found) == ()


@pytest.mark.parametrize("number", [201, 203, 206, 208, 222])
def test_row_58_what_is_right_is_given_no_caution(number: int) -> None:
    opened = problem(number)
    found = compare_pass(opened, ["iekf", "batch"])
    assert found.summary["cautions"] == []
