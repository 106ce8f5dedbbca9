"""What is wrong with a scenario is said, and nothing besides that only follows from it."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from board import BOARD
from passes import EXPERIMENTS, relnav

from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.schema import Problems, ScenarioError
from relnav_graph.scenario.toml import read_toml

Capture = pytest.CaptureFixture[str]

#: Of recorded data: a scenario that does not know yet what they may bring.
MINE = (
    BOARD
    + """
[sensors.ranger]
kind = "range"
pose = "target"
sigma = "1 cm"
bias = true

[prior]
relative_attitude = { mean = "measured", sigma = "60 deg" }
gyro_bias = { mean = [0, 0, 0], sigma = "1 deg/s" }
relative_position = { mean = "measured", sigma = "10 m" }
relative_velocity = { mean = [0, 0, 0], sigma = "1 m/s" }
range_bias = { mean = [0], sigma = "1 m" }
"""
)


def _problems(raw: Mapping[str, Any]) -> Problems:
    with pytest.raises(ScenarioError) as raised:
        make_scenario(raw, "mine")
    return raised.value.problems


@pytest.mark.parametrize("command", ["validate", "compare"])
@pytest.mark.parametrize("prior", ["", "[prior]\n"])
def test_a_prior_that_is_not_there_is_shown_block_by_block(
    tmp_path: Path, capsys: Capture, command: str, prior: str
) -> None:
    path = tmp_path / "s.toml"
    path.write_text(MINE.partition("[prior]")[0] + prior)
    code, _, err = relnav(capsys, command, path)
    assert code == 2
    assert err.startswith("error: s: 5 errors\n")
    for block in ("relative_attitude", "relative_position", "relative_velocity", "gyro_bias"):
        assert f"  prior.{block}: missing: every block needs a prior, as {{ mean = [" in err


def test_what_no_data_bring_is_missed_before_they_are_read() -> None:
    raw = tomllib.loads(MINE)
    del raw["title"]
    assert _problems(raw) == [("title", "missing, and required")]
    del raw["processes"], raw["sensors"]
    found = {path for path, _ in _problems(raw)}
    assert found == {"title"}
    raw["title"] = "mine"
    assert {path for path, _ in _problems(raw)} == {"processes", "sensors"}


def test_what_data_may_bring_is_missed_where_nothing_can_be_made_without() -> None:
    raw = tomllib.loads(MINE)
    del raw["processes"]["move"]["acceleration_density"]
    assert make_scenario(raw, "mine").processes.keys() == {"turn"}
    del raw["processes"]["turn"]
    (found,) = _problems(raw)
    assert found == ("processes.move.acceleration_density", "missing, and required")


def _spoilt(tables: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Tables with one model each that cannot be made, and the path of that model."""
    for section in ("processes", "sensors", "inputs"):
        for name, table in tables.get(section, {}).items():
            for key, value in table.items():
                unit = isinstance(value, str) and value[:1].isdigit()
                if key == "kind" or unit:
                    raw = copy.deepcopy(dict(tables))
                    raw[section][name][key] = f"{value}x" if key == "kind" else "1 px^3"
                    yield f"{section}.{name}.", raw


@pytest.mark.parametrize("name", ["", "zhang2015", "mounting", "inspection", "starry_night"])
def test_a_model_that_cannot_be_made_is_the_only_error(name: str) -> None:
    spoilt = list(_spoilt(read_toml(EXPERIMENTS / f"{name}.toml") if name else tomllib.loads(MINE)))
    assert len(spoilt) > 3
    for path, raw in spoilt:
        (found,) = _problems(raw)
        assert found[0].startswith(path)


def test_a_kind_that_is_nearly_one_is_asked_for() -> None:
    raw = tomllib.loads(MINE)
    raw["processes"]["turn"]["kind"] = "gyro_bais"
    ((path, message),) = _problems(raw)
    assert path == "processes.turn.kind"
    asked = "found kind 'gyro_bais' (is 'gyro_bias' meant?), expected one of: accelerometer_bias, "
    assert message.startswith(asked)


@pytest.mark.parametrize(
    ("section", "near", "there", "others"),
    [
        ("processes.turn", "gyro_bais", "euler_rotation", "star_tracker"),
        ("sensors.board", "pose_mesurement", "star_tracker", "gyro_bias"),
        ("truth", "rigid_body_pai", "tumbling_body", "rendezvous"),
        ("inputs.gyro", "strapdown_gyr", "rate_integrating_gyro", "tumbling_body"),
        ("control", "rendezvou", "attitude_tracking", "tumbling_body"),
    ],
)
def test_only_kinds_of_its_section_are_listed(
    section: str, near: str, there: str, others: str
) -> None:
    raw = tomllib.loads(MINE)
    table = raw
    for key in section.split("."):
        table = table.setdefault(key, {})
    table["kind"] = near
    (message,) = [m for path, m in _problems(raw) if path == f"{section}.kind"]
    assert f"found kind '{near}' (is '{near[:5]}" in message
    assert there in message
    assert others not in message
    assert "relative_attitude" not in message  # which is derived
