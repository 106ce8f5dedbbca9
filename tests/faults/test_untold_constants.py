"""Row 56: constants that nothing tells of, keyframes that are no epochs, one error for a word."""

from __future__ import annotations

from pathlib import Path

import pytest
from passes import EXPERIMENTS

from relnav_graph.errors import InputError
from relnav_graph.io.closures import keyframes_in
from relnav_graph.runs.comparison import compare
from relnav_graph.scenario.build import load_scenario

MOUNTING, CLOSURES = EXPERIMENTS / "mounting.toml", EXPERIMENTS / "closures.toml"


def test_row_56_a_constant_that_nothing_tells_of_is_a_caution() -> None:
    """Also where a process reads it, of a target that nobody sees."""
    blind = load_scenario(MOUNTING, ["time.epochs=12", 'sensors.camera.begin="1e5 s"'])
    (found,) = compare(blind, ["ekf"]).summary["cautions"]
    assert found["name"] == "never seen"
    assert found["estimator"] is None
    names = "inertia_matrix_parameters, camera_misalignment, camera_displacement"
    assert f"tells of {names}: it ends with its prior" in found["text"]


def test_row_56_constants_that_are_told_are_none() -> None:
    assert compare(load_scenario(MOUNTING, ["time.epochs=12"]), ["ekf"]).summary["cautions"] == []


@pytest.mark.parametrize("keyframe", ["-1 s", "60.5 s", "601 s", "1e4 s"])
def test_row_56_a_keyframe_off_the_pass_is_refused_by_validate(keyframe: str) -> None:
    setting = f'sensors.closures.keyframes=["60 s", "{keyframe}"]'
    says = r"keyframes: found a keyframe at .* expected the time of an epoch, from 0 s to 600 s"
    with pytest.raises(InputError, match=says):
        load_scenario(CLOSURES, [setting])


def test_row_56_keyframes_at_both_ends_are_epochs() -> None:
    load_scenario(CLOSURES, ['sensors.closures.keyframes=["0 s", "600 s"]'])


@pytest.mark.parametrize("value", ['"estimate"', "3", '"no"'])
def test_row_36_a_wrong_mounting_is_one_error(value: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scenario(MOUNTING, [f"sensors.camera.mounting={value}"])
    text = str(caught.value)
    assert "sensors.camera.mounting: Input should be 'known' or 'estimated'" in text
    assert "unknown block" not in text
    assert "1 error" in text


def test_row_12_stamps_of_one_keyframe_may_differ_in_their_last_digits(tmp_path: Path) -> None:
    """Of one epoch written with different rounding: one keyframe, not two that are too near."""
    (tmp_path / "loops.csv").write_text(
        "t_s,t_from_s,id\n"
        "100,10,0\n110,10.0000004,0\n120,9.9999999,0\n130,20,0\n"  # a microsecond is one time
    )
    scenario = {"sensors": {"loops": {"kind": "pose_odometry"}}}
    found = keyframes_in(tmp_path, scenario)["loops"]["keyframes"]
    assert found == [9.9999999, 20.0]
