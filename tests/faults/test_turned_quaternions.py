"""Quaternions in another order, or of the other direction: they turn as no gyro does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, changed_tables, recorded, relnav

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Recording
from relnav_graph.io.dataset import write_dataset
from relnav_graph.maths import so3
from relnav_graph.runs.passes import open_dataset, open_pass
from relnav_graph.scenario.build import load_scenario, make_scenario

NAME = "attitude turns otherwise"
CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
LAST = [1, 2, 3, 0]
#: What somebody may write for q_wxyz (k, 4), and what the caution calls it.
WRITTEN: dict[str, Any] = {
    "": lambda q: q,
    "as conjugate quaternions:": lambda q: q * CONJUGATE,
    "as quaternions with the scalar last:": lambda q: q[:, LAST],
    "as conjugate quaternions with the scalar last:": lambda q: (q * CONJUGATE)[:, LAST],
}


def said(problem: Problem) -> list[str]:
    return [c.text for c in problem.cautions if c.name == NAME]


@pytest.mark.parametrize("called", WRITTEN)
def test_row_60_the_gyro_tells_how_quaternions_were_written(tmp_path: Path, called: str) -> None:
    """A data set of a star tracker beside a gyro."""
    scenario = load_scenario(EXPERIMENTS / "mounting.toml", ["time.epochs=200"])

    def rewritten(m: Measurement) -> Measurement:
        return replace(m, z=WRITTEN[called](m.z)) if m.sensor == "stars" else m

    recording = scenario.simulate(0)
    recording = replace(recording, measurements=tuple(map(rewritten, recording.measurements)))
    blocks = {b.name: b for b in scenario.layout}
    models = scenario.sensors, scenario.input_columns, blocks
    write_dataset(tmp_path / "set", scenario.raw, recording, *models)
    found = said(open_dataset(tmp_path / "set").problem)
    assert len(found) == bool(called)
    if called:
        assert "attitudes of 'stars' miss what 'gyro' says" in found[0]
        assert called in found[0]


def test_row_60_a_pass_that_hardly_turns_tells_nothing() -> None:
    scenario = load_scenario(EXPERIMENTS / "mounting.toml", ["time.epochs=20"])
    recording = scenario.simulate(0)
    wrong = tuple(
        replace(m, z=m.z * CONJUGATE) if m.sensor == "stars" else m for m in recording.measurements
    )
    assert said(scenario.problem(replace(recording, measurements=wrong), 0)) == []


def test_row_60_it_is_shown_before_anything_is_estimated(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scenario = load_scenario(EXPERIMENTS / "mounting.toml", ["time.epochs=200"])
    models = scenario.sensors, scenario.input_columns, {b.name: b for b in scenario.layout}
    write_dataset(tmp_path / "set", scenario.raw, scenario.simulate(0), *models)
    (tmp_path / "set" / "dataset.toml").unlink()  # as made by hand
    path = tmp_path / "set" / "stars.csv"
    head, *rows = path.read_text().splitlines()
    fields = head.split(",")
    swapped = {"q_x": "q_w", "q_y": "q_x", "q_z": "q_y", "q_w": "q_z"}
    path.write_text("\n".join([",".join(swapped.get(f, f) for f in fields), *rows]) + "\n")
    code, out, err = relnav(capsys, "validate", tmp_path / "set")
    assert code == 0
    assert NAME in out + err


@pytest.mark.parametrize(
    ("scenario", "data"),
    [
        ("starloc", "starloc"),
        ("starloc_as_filed", "starloc"),
        ("starloc_map", "starloc"),
        ("starry_night", "starry_night"),
        ("astrobee_tumble", "astrobee_tumble"),
        ("grace_fo", "grace_fo"),
        ("grace_kbr", "grace_kbr"),
    ],
)
def test_row_60_no_recorded_pass_is_doubted(scenario: str, data: str) -> None:
    assert said(open_pass(EXPERIMENTS / f"{scenario}.toml", data=recorded(data)).problem) == []


@pytest.mark.parametrize("called", WRITTEN)
def test_row_60_a_real_gyro_tells_it_too(called: str) -> None:
    """Captured attitudes of the laboratory, as a star tracker that sees at each epoch, beside the
    recorded gyro."""
    name = "stars"
    opened = open_pass(EXPERIMENTS / "starloc.toml", data=recorded("starloc"))
    truth = opened.recording.truth
    assert truth is not None
    (attitude,) = (b.name for b in opened.scenario.layout if b.manifold == "SO3")
    assert attitude == "relative_attitude"
    table = {
        "kind": "pose_measurement",
        "position_sigma": 0.01,
        "attitude_sigma": 0.01,
        "pose": "target",
    }
    tables = changed_tables(opened.scenario.raw, "sensors", name, value=table)
    scenario = make_scenario(tables, "with poses")
    R: Array = truth.values[attitude]
    ids = np.zeros(1, np.int64)
    poses = tuple(
        Measurement(name, float(t), np.concatenate([np.zeros(3), WRITTEN[called](q)[0]])[None], ids)
        for t, one in zip(truth.t, R, strict=True)
        if np.isfinite(one).all() and t in opened.recording.times
        for q in (so3.quaternion(np.ascontiguousarray(one))[None],)
    )
    measured = sorted((*opened.recording.measurements, *poses), key=lambda m: m.t)
    recording: Recording = replace(opened.recording, measurements=tuple(measured))
    found = said(scenario.problem(recording, 0))
    assert len(found) == bool(called), found
    assert called in "".join(found)
