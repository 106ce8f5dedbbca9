"""A scenario with a model of its own beside it, and with a state that its truth does not know."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import relnav

from relnav_graph.errors import InputError
from relnav_graph.registry import look_beside
from relnav_graph.scenario.build import load_scenario

Capture = pytest.CaptureFixture[str]

MODULE = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.numerical import NumericalSensor
from relnav_graph.core.state import Block

OFFSET = Block("offset", "b_r", "vector", 1, "m", "-", "m")


@dataclass(frozen=True)
class Ranger(NumericalSensor):
    kind: ClassVar[str] = "NAME_ranger"
    columns: ClassVar[tuple[str, ...]] = ("range_m",)
    blocks: ClassVar[tuple[Block, ...]] = (RELATIVE_POSITION, OFFSET)

    sigma: float = 0.1

    def h(self, r_tc_o, offset):
        return np.linalg.norm(r_tc_o) + offset[0]


@dataclass(frozen=True)
class Honest(Ranger):
    kind: ClassVar[str] = "NAME_honest"

    def own_truth(self, times, rng):
        return {"offset": VALUE}
"""
SCENARIO = """
title = "a ranger with an offset"
[time]
step = 10
epochs = 4
[orbit]
semi_major_axis = "7000 km"
eccentricity = 0.0
[processes.motion]
kind = "eccentric_relative_motion"
acceleration_density = 1e-4
[sensors.ranger]
kind = "NAME:CLASS"
[prior]
relative_position = { sigma = "1 m" }
relative_velocity = { sigma = "1 mm/s" }
offset = { sigma = "10 m" }
[truth]
kind = "rigid_body_pair"
relative_position = ["200 m", "200 m", "100 m"]
relative_velocity = ["0.01 m/s", "-0.4325 m/s", "0.01 m/s"]
target_inertia = ["100 kg*m^2", "80 kg*m^2", "60 kg*m^2"]
target_rate = ["0.2 deg/s", "2.5 deg/s", "0.2 deg/s"]
target_attitude = ["10 deg", "-20 deg", "30 deg"]
chaser_attitude = ["20 deg", "-10 deg", "5 deg"]
chaser_rate = ["0 deg/s", "0 deg/s", "0.06 deg/s"]
torque_density = "1e-8 rad/s^1.5"
"""


@pytest.fixture(autouse=True)
def _path(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test puts on the path is taken off again."""
    monkeypatch.setattr(sys, "path", [*sys.path])


def written(folder: Path, name: str, cls: str, value: str = "np.array([2.5])") -> Path:
    (folder / f"{name}.py").write_text(MODULE.replace("NAME", name).replace("VALUE", value))
    path = folder / "own.toml"
    path.write_text(SCENARIO.replace("NAME", name).replace("CLASS", cls))
    return path


def test_a_module_beside_the_scenario_is_found(tmp_path: Path) -> None:
    """Without PYTHONPATH, and by the scenario that has it as base, in another folder."""
    scenario = load_scenario(written(tmp_path, "beside_one", "Honest"))
    assert type(scenario.sensors["ranger"]).__module__ == "beside_one"
    (tmp_path / "deeper").mkdir()
    other = tmp_path / "deeper" / "other.toml"
    other.write_text('base = "../own.toml"\ntitle = "another"\n')
    assert type(load_scenario(other).sensors["ranger"]).__module__ == "beside_one"


def test_what_was_there_before_is_taken_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = tmp_path / "a", tmp_path / "b"
    for folder in (first, second):
        folder.mkdir()
        load_scenario(written(folder, "beside_two", "Honest"))
    assert sys.modules["beside_two"].__file__ == str(first / "beside_two.py")
    assert f"{first / 'beside_two.py'} is taken, not {second / 'beside_two.py'}" in caplog.text
    (tmp_path / "json.py").write_text("raise SystemExit")
    look_beside(tmp_path, ["json:Class"])
    assert "json.py: rename one of them" in caplog.text


def test_a_data_set_with_a_module_beside_it_needs_trust(tmp_path: Path, capsys: Capture) -> None:
    path = written(tmp_path, "beside_three", "Honest")
    code, _, err = relnav(capsys, "simulate", path, "-o", tmp_path / "set")
    assert code == 0, err
    source = (tmp_path / "beside_three.py").read_text().replace("beside_three", "beside_four")
    (tmp_path / "set" / "beside_four.py").write_text(source)
    scenario = tmp_path / "set" / "scenario.toml"
    scenario.write_text(scenario.read_text().replace("beside_three", "beside_four"))
    code, _, err = relnav(capsys, "validate", tmp_path / "set")
    assert code == 2
    assert "--trust" in err
    assert "beside_four" not in sys.modules
    code, _, err = relnav(capsys, "validate", tmp_path / "set", "--trust")
    assert code == 0, err
    assert "beside_four" in sys.modules


def test_a_report_finds_the_module_where_it_is_run(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, out = written(tmp_path, "beside_five", "Honest"), tmp_path / "out"
    code, _, err = relnav(capsys, "compare", path, "-e", "ekf", "-o", out, "--figures", "none")
    assert code in (0, 3), err
    sys.modules.pop("beside_five")
    monkeypatch.setattr(sys, "path", [one for one in sys.path if one != str(tmp_path)])
    assert relnav(capsys, "report", out, "--trust")[0] == 2
    monkeypatch.chdir(tmp_path)
    assert relnav(capsys, "report", out)[0] == 2
    code, _, err = relnav(capsys, "report", out, "--trust")
    assert code == 0, err


def test_validate_asks_for_what_the_truth_does_not_know(tmp_path: Path, capsys: Capture) -> None:
    path = written(tmp_path, "beside_five", "Ranger")
    code, _, err = relnav(capsys, "validate", path)
    assert code == 2
    for words in (
        "sensor 'ranger'",
        "the truth has no ['offset']",
        "truth.statics.offset",
        "own_truth",
    ):
        assert words in err
    code, _, err = relnav(capsys, "validate", path, "--set", "truth.statics.offset=[1]")
    assert code == 0, err


@pytest.mark.parametrize(
    ("value", "expected"),
    [("np.array([2.5])", np.full((4, 1), 2.5)), ("np.sqrt(times)[:, None]", None)],
)
def test_a_sensor_brings_its_own_truth(tmp_path: Path, value: str, expected: Any) -> None:
    name = f"beside_six_{len(value)}"
    scenario = load_scenario(written(tmp_path, name, "Honest", value))
    scenario.check_truth()
    recording = scenario.simulate(0)
    truth = recording.truth
    assert truth is not None
    wanted = np.sqrt(truth.t)[:, None] if expected is None else expected
    np.testing.assert_array_equal(truth.values["offset"], wanted)
    assert "offset: that of sensor 'ranger'" in truth.source
    z = np.concatenate([m.z for m in recording.measurements])[:, 0]
    distance = np.linalg.norm(truth.values["relative_position"], axis=1)
    np.testing.assert_allclose(z, distance + wanted[:, 0], atol=0.6)


def test_an_own_truth_of_another_form_is_refused(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, "beside_seven", "Honest", "np.zeros(3)"))
    with pytest.raises(InputError, match=r"'ranger': own_truth of offset: found \(3,\), expected"):
        scenario.simulate(0)
