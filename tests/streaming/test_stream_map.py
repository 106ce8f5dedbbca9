"""A stream of a target without a model: points come as they are seen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from streams import changed, feed, lines_of, session_of

from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

INSPECTION = Path(__file__).parents[2] / "experiments" / "inspection.toml"
SHORT = ["time.epochs=40", "truth.map.count=12", "truth.target_rate=[0.01, 0.07, 0.01]"]


@pytest.fixture(scope="module")
def inspection() -> tuple[Scenario, list[str]]:
    """A faster tumble, of a quarter turn in 22 s."""
    scenario = load_scenario(INSPECTION, SHORT)
    return scenario, lines_of(scenario)


def test_a_line_has_the_points_seen_so_far(inspection: tuple[Scenario, list[str]]) -> None:
    scenario, lines = inspection
    out = feed(session_of(scenario, lines[0], "incremental"), lines)
    out = [line for line in out if line["estimate"] is not None]  # not what is said at the end
    problem = scenario.problem(scenario.simulate(0), 0)
    track = run_estimator("incremental", problem)
    points = [block for block in problem.layout.statics if block.number is not None]
    counts = [len(line["estimate"]["point"]["id"]) for line in out]
    first = next(m for m in problem.epochs[0].measurements if m.sensor == "camera")
    assert counts[0] == len(first.z)
    assert sorted(counts) == counts
    assert counts[-1] == len(points)
    last = out[-1]["estimate"]["point"]
    assert last["id"] == [block.number for block in points]
    for i, block in enumerate(points):
        sigma = np.sqrt(np.diag(track.covariance(block.name)[-1]))
        np.testing.assert_allclose(last["sigma"][i], sigma, rtol=1e-3)
        assert np.abs((last["value"][i] - track.value(block.name)[-1]) / sigma).max() < 1e-2


def test_the_stream_says_that_it_is_initialising(inspection: tuple[Scenario, list[str]]) -> None:
    scenario, lines = inspection
    out = feed(session_of(scenario, lines[0], "fixed_lag"), lines)
    statuses = [line["status"] for line in out]
    first = statuses.index("OK")
    assert set(statuses[:first]) == {"INITIALISING"}
    assert set(statuses[first:]) == {"OK"}
    assert 15 < first < 30
    assert out[3]["message"].startswith("initialising: the target has turned by ")
    # Axes of a body whose moments are equal are nowhere: null, not a number that JSON lacks.
    assert json.loads(json.dumps(out[0]))["estimate"]["principal_axes"]["sigma"] == [None] * 3


@pytest.mark.parametrize("kind", ["fixed_lag", "iekf", "incremental"])
def test_a_session_with_a_map_goes_on_from_its_bytes(
    inspection: tuple[Scenario, list[str]], kind: str
) -> None:
    scenario, lines = inspection
    lines = [lines[0], *(changed(line) for line in lines[1:])]
    whole = feed(session_of(scenario, lines[0], kind), lines)
    for at in (1, 30, 75):
        session = session_of(scenario, lines[0], kind)
        begun = feed(session, lines[:at], end=False)
        resumed = session_of(scenario, lines[0], kind)
        resumed.load(session.save())
        assert begun + feed(resumed, lines[at:]) == whole
