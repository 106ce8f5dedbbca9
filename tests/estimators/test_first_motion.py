"""The motion of a target of which one camera sees unknown points: found, and kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from passes import EXPERIMENTS

from relnav_graph import load_scenario
from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Truth
from relnav_graph.estimators import try_estimator
from relnav_graph.estimators.first_motion import begun, motions, tells_no_depth
from relnav_graph.linear.assembly import Assembly
from relnav_graph.runs.passes import open_pass

#: As well as 0.3 px of 2000 px.
BEARINGS = 'kind = "beacon_los"\nsigma = "1.5e-4 rad"\n'


def opened(kind: str, epochs: int, path: Path) -> tuple[Problem, Truth]:
    """The shipped pass with one camera, or with bearings instead of pixels, of so many epochs."""
    text = (EXPERIMENTS / "inspection_mono.toml").read_text()
    if kind == "beacon_los":
        lines = text.replace('kind = "mono_point"\n', BEARINGS).splitlines()
        pixels = ("fu =", "fv =", "cu =", "cv =", "pixel_sigma =")
        text = "\n".join(line for line in lines if not line.startswith(pixels))
    (path / "pass.toml").write_text(text)
    found = open_pass(path / "pass.toml", assignments=[f"time.epochs={epochs}"])
    assert found.recording.truth is not None
    return found.problem, found.recording.truth


def rate_error(x: Array, problem: Problem, truth: Truth, k: int) -> float:
    """deg/s, at epoch k."""
    rate = x[problem.layout.stored("target_rate")]
    return float(np.rad2deg(np.linalg.norm(rate - truth.values["target_rate"][k])))


@pytest.mark.parametrize("kind", ["mono_point", "beacon_los"])
def test_lines_of_sight_tell_how_the_target_turns(kind: str, tmp_path: Path) -> None:
    problem, truth = opened(kind, 11, tmp_path)
    assert tells_no_depth(problem)
    assembly = Assembly.of(problem)
    found = motions(assembly, problem.prior)
    assert min(rate_error(x, problem, truth, 0) for x in found) < 0.8  # the prior's: 2.5
    x = begun(assembly, problem.prior, found[0])
    points = [b.name for b in problem.layout if b.number is not None]
    true = np.array([truth.values[name][0] for name in points])
    off = np.linalg.norm([problem.layout.value(x[0], n) for n in points] - true, axis=1)
    assert np.median(off) < 1.5  # the prior's sigma is 10 m


def test_incremental_starts_from_lines_of_sight_alone(tmp_path: Path) -> None:
    problem, truth = opened("mono_point", 20, tmp_path)
    track = try_estimator("incremental", problem).smoothed
    assert track is not None
    assert track.status == "ok"
    assert rate_error(track.states[-1], problem, truth, -1) < 0.5
    assert np.linalg.norm(track.value("relative_position")[-1]) == pytest.approx(15, abs=8)


def test_a_camera_that_sees_depth_needs_no_search() -> None:
    scenario = load_scenario(EXPERIMENTS / "inspection.toml", ["time.epochs=3"])
    assert not tells_no_depth(scenario.problem(scenario.simulate(0), 0))
