"""`compare`: one call makes a run, with the numbers of the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from passes import ZHANG

import relnav_graph as rg
from relnav_graph.cli.main import main
from relnav_graph.errors import InputError, ModelError

SHORT = "time.epochs=20"
TIMINGS = {"runtime_s", "step_ms", "versions"}


def numbers(found: object) -> object:
    """A summary without what differs from run to run."""
    if isinstance(found, dict):
        return {key: numbers(value) for key, value in found.items() if key not in TIMINGS}
    return found


def test_it_is_what_the_command_does(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["compare", str(ZHANG), "--set", SHORT, "-e", "iekf", "-e", "batch", "--seed", "3",
              "--json"])  # fmt: skip
    printed = json.loads(capsys.readouterr().out)
    made = rg.compare(rg.load_scenario(ZHANG, [SHORT]), ["iekf", "batch"], seed=3)
    assert numbers(json.loads(json.dumps(made.summary))) == numbers(printed)
    assert [track.name for track in made.tracks] == ["iekf", "batch"]
    assert made.problems[0] is made.problems[1]  # the fairness argument
    assert made.truths[0] is made.truths[1]
    assert made.track("batch") is made.tracks[1]


def test_of_a_file_with_its_own_estimators_and_seed() -> None:
    scenario = rg.load_scenario(ZHANG, [SHORT, 'estimators=["ekf"]', "seed=5"])
    made = rg.compare(scenario)
    assert (made.summary["seed"], [t.name for t in made.tracks]) == (5, ["ekf"])


def test_of_a_recording(tmp_path: Path) -> None:
    scenario = rg.load_scenario(ZHANG, [SHORT])
    recording = scenario.simulate(seed=1)
    by_hand = rg.run_estimator("iekf", scenario.problem(recording, 1))
    made = rg.compare(scenario, ["iekf"], seed=1, data=recording)
    np.testing.assert_array_equal(made.tracks[0].x, by_hand.x)
    assert made.summary["seed"] is None  # nothing but the prior was drawn
    with pytest.raises(InputError, match="no such folder"):
        rg.compare(scenario, data=tmp_path / "nowhere")


def test_in_a_loop_each_track_has_its_own_pass() -> None:
    path = ZHANG.with_name("thienel2006.toml")
    scenario = rg.load_scenario(path, ['time.step="5 s"', "time.epochs=30"])
    made = rg.compare(scenario, ["momentum_observer", "ekf"], seed=2)
    assert made.problems[0] is not made.problems[1]
    assert made.truths[0] is not made.truths[1]


def test_an_unknown_estimator_is_refused() -> None:
    with pytest.raises(ModelError, match="found kind 'ukkf'"):
        rg.compare(rg.load_scenario(ZHANG, [SHORT]), ["ukkf"])
