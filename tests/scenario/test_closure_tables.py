"""Loop closures in scenarios, data sets and streams: keyframes, copies, and both times."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS

from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.io.dataset import write_dataset
from relnav_graph.maths import so3
from relnav_graph.runs.passes import open_dataset
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.schema import ScenarioError
from relnav_graph.streaming.lines import LineError, parse_line

#: A circle in a minute, and a third of the next; what was seen at 0 and 10 s is seen again.
FAST = [
    "time.epochs=81",
    "inputs.gyro.values=[0.0, 0.0, 0.1047198]",
    "inputs.velocity.values=[0.3141593, 0.0, 0.0]",
    "sensors.closures.keyframes=[0, 10]",
    "sensors.closures.period=1.0",
    "sensors.closures.begin=40.0",
]
NONE = 'sensors.closures.begin="90 s"'


def scenario(*changes: str) -> Scenario:
    return load_scenario(EXPERIMENTS / "closures.toml", [*FAST, *changes])


def tables(**closures: Any) -> dict[str, Any]:
    """The tables with entries of the closures' sensor changed; None: taken out."""
    raw: dict[str, Any] = copy.deepcopy(dict(scenario().raw))
    own = raw["sensors"]["closures"]
    own.update(closures)
    raw["sensors"]["closures"] = {k: v for k, v in own.items() if v is not None}
    return raw


def test_a_table_with_keyframes_is_a_sensor_for_each_and_a_copy() -> None:
    found = scenario()
    assert [*found.sensors] == [
        *("odometry", "closures.0", "closures.10", "closures.0.copy", "closures.10.copy")
    ]
    names = [b.name for b in found.layout.statics]
    assert names == [
        "gyro_bias",
        *(f"relative_{what}.{t}" for t in (0, 10) for what in ("attitude", "position")),
    ]
    every = make_scenario(tables(keyframes="40 s"), "period")
    closures = [n for n in every.sensors if n.startswith("closures") and "copy" not in n]
    assert closures == ["closures.0", "closures.40", "closures.80"]


@pytest.mark.parametrize(
    ("keyframes", "message"),
    [
        ([], "expected one time or more, each once"),
        ([0, 10, 0], "expected one time or more, each once"),
        (["1 m"], "found unit 'm', expected one like 's'"),
        (-5.0, "expected a positive value"),
        ("often", "expected a number with a unit like 's'"),
        ([0, 1e-7], "found two keyframes at 0 s"),
        ("1 ms", "found the period 0.001 s, expected a multiple of the [time] step, 1 s"),
        ("1.5 s", "found the period 1.5 s, expected a multiple"),
    ],
)
def test_wrong_keyframes_are_named_with_their_path(keyframes: Any, message: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        make_scenario(tables(keyframes=keyframes), "wrong")
    assert message in dict(raised.value.problems)["sensors.closures.keyframes"]


def test_a_keyframe_beside_keyframes_is_refused() -> None:
    with pytest.raises(ScenarioError) as raised:
        make_scenario(tables(keyframe=3.0), "both")
    assert "expected one of them" in dict(raised.value.problems)["sensors.closures.keyframe"]


def test_a_period_of_keyframes_needs_the_length_of_the_pass() -> None:
    raw = tables(keyframes="20 s")
    del raw["time"], raw["truth"]
    with pytest.raises(ScenarioError) as raised:
        make_scenario(raw, "open end")
    message = dict(raised.value.problems)["sensors.closures.keyframes"]
    assert message.endswith("expected a list of times")
    raw["sensors"]["odometry"]["keyframes"] = [1.0]
    raw["sensors"]["gps"] = {"kind": "gps_position", "sigma": 1.0, "keyframes": [1.0]}
    with pytest.raises(ScenarioError) as raised:
        make_scenario(raw, "no closures")
    assert "unknown key" in dict(raised.value.problems)["sensors.gps.keyframes"]


def last(track: Track) -> tuple[np.ndarray, np.ndarray]:
    return track.x[-1], track.P[-1]


def test_closures_tell_where_odometry_has_drifted_and_filters_use_them_too() -> None:
    found = scenario()
    problem = found.problem(found.simulate(1), 1)
    layout = problem.layout.moving
    tracks = {kind: run_estimator(kind, problem) for kind in ("ekf", "iekf", "incremental")}
    x, P = last(run_estimator("batch", problem))
    sigma = np.sqrt(np.diag(P))
    for kind, track in tracks.items():
        x_other, P_other = last(track)
        assert np.abs(layout.local(x, x_other) / sigma).max() < 0.1, kind
        np.testing.assert_allclose(np.sqrt(np.diag(P_other)), sigma, rtol=0.02, err_msg=kind)
    without = scenario(NONE)
    assert not [m for m in without.simulate(1).measurements if "closures" in m.sensor]
    _, P_without = last(run_estimator("batch", without.problem(without.simulate(1), 1)))
    place = layout.tangent("relative_position")
    assert np.trace(P_without[place, place]) > 5 * np.trace(P[place, place])


def test_the_copies_are_what_they_copy_and_have_its_truth() -> None:
    found = scenario()
    recording = found.simulate(1)
    problem = found.problem(recording, 1)
    track = run_estimator("batch", problem)
    assert recording.truth is not None
    for name in ("relative_attitude", "relative_position"):
        block, row = problem.layout.block(name), slice(10, 11)
        d = block.local(track.value(f"{name}.10")[:1], track.value(name)[row])
        assert np.abs(d).max() < 1e-6
        np.testing.assert_allclose(
            track.covariance(f"{name}.10")[0], track.covariance(name)[10], rtol=1e-4, atol=1e-14
        )
        true = recording.truth.values[name][10]
        np.testing.assert_array_equal(recording.truth.values[f"{name}.10"], [true] * 81)


# --- data sets ------------------------------------------------------------------------------------


def written(folder: Path, origin: float = 0.0, change: Callable[..., Any] | None = None) -> Any:
    """The recording, as a data set with closures.csv changed."""
    found = scenario(f"time.origin={origin}")
    recording = found.simulate(1)
    blocks = {b.name: b for b in found.layout}
    models = found.sensors, found.input_columns, blocks
    raw = tables()
    raw["time"] = {**raw["time"], "origin": origin}
    del raw["sensors"]["closures"]["keyframes"]  # the data say them
    write_dataset(folder, raw, recording, *models, origin=origin)
    if change is not None:
        (folder / "dataset.toml").unlink()
        path = folder / "closures.csv"
        lines = path.read_text("utf-8").splitlines()
        path.write_text("\n".join(change(lines)) + "\n", "utf-8")
    return recording


@pytest.mark.parametrize("origin", [0.0, 1000.0])
def test_recorded_closures_name_both_times(tmp_path: Path, origin: float) -> None:
    recording = written(tmp_path / "set", origin)
    assert not [*(tmp_path / "set").glob("*copy*"), *(tmp_path / "set").glob("truth_*.10.csv")]
    header = (tmp_path / "set/closures.csv").read_text("utf-8").splitlines()[0]
    assert header.startswith("t_s,t_from_s,id,x_m,")
    found = open_dataset(tmp_path / "set")
    assert {*found.scenario.sensors} == {*scenario().sensors}
    closures = [m for m in recording.measurements if "closures" in m.sensor]
    assert len({m.sensor for m in closures}) == 2
    got = {(m.sensor, m.t): m.z for m in found.recording.measurements if "closures" in m.sensor}
    assert len(got) == len(closures)
    for m in closures:
        np.testing.assert_array_equal(got[m.sensor, m.t], m.z)
    assert found.recording.truth is not None
    for name in ("relative_attitude.10", "relative_position.0", "gyro_bias"):
        true = recording.truth.values[name]
        np.testing.assert_allclose(found.recording.truth.values[name], true, rtol=0, atol=1e-15)
    mine, theirs = found.problem, scenario().problem(recording, 0)
    assert [len(e.measurements) for e in mine.epochs] == [
        len(e.measurements) for e in theirs.epochs
    ]


def test_recorded_closures_to_epochs_that_are_no_keyframes_are_refused(tmp_path: Path) -> None:
    def other(lines: list[str]) -> list[str]:
        t, _, rest = lines[3].split(",", 2)
        return [*lines[:3], f"{t},11.0,{rest}", *lines[4:]]

    written(tmp_path / "set", change=other)
    changed = ["sensors.closures.keyframes=[0, 10]"]
    with pytest.raises(InputError, match=r"closures\.csv, line 4, column t_from_s: found 11\.0, e"):
        _ = open_dataset(tmp_path / "set", changed).problem
    # Without keyframes in the scenario they are those of the data: 11 s is one then.
    assert "closures.11" in open_dataset(tmp_path / "set").scenario.sensors


@pytest.mark.parametrize(
    ("t_from", "message"),
    [
        ("70.0", "column t_from_s: found 70.0, expected a time before t_s"),
        ("10.5", "no epoch; the"),
    ],
)
def test_recorded_closures_to_no_earlier_epoch_are_refused(
    tmp_path: Path, t_from: str, message: str
) -> None:
    def other(lines: list[str]) -> list[str]:
        t, _, rest = lines[3].split(",", 2)
        return [*lines[:3], f"{t},{t_from},{rest}", *lines[4:]]

    written(tmp_path / "set", change=other)
    with pytest.raises(InputError, match=message):
        _ = open_dataset(tmp_path / "set").problem


# --- lines ----------------------------------------------------------------------------------------


def test_a_line_names_the_earlier_epoch_and_others_are_refused_by_name() -> None:
    sensors = scenario().sensors
    z = [[0.1, 0.0, 0.0, *so3.quaternion(np.eye(3)).tolist()]]

    def parsed(**line: Any) -> Any:
        text = json.dumps({"t": 1050.0, "id": [0], "z": z, **line}).encode()
        return parse_line(text, sensors, {}, 1000.0)[1]

    assert parsed(sensor="closures", t_from=1010.0).sensor == "closures.10"
    assert parsed(sensor="closures.0").sensor == "closures.0"
    for line, name in (
        ({"sensor": "closures", "t_from": 1011.0}, "closures.11"),
        ({"sensor": "closures"}, "closures"),
        ({"sensor": "closures.10.copy"}, "closures.10.copy"),
    ):
        with pytest.raises(LineError, match=f"unknown sensor '{name}'; the scenario has"):
            parsed(**line)


def test_a_closure_to_before_the_pass_is_refused() -> None:
    found = scenario()
    whole = found.simulate(1)
    late = replace(
        whole, times=whole.times[5:], measurements=tuple(m for m in whole.measurements if m.t > 4)
    )
    with pytest.raises(
        InputError, match=r"'closures\.0' at t = 5\d\.0 s: closure: no epoch was th"
    ):
        found.problem(late, 1)
