"""The JSON Schema of scenarios, judged by an independent validator."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from passes import EXPERIMENTS

from relnav_graph.scenario.json_schema import json_schema

SCENARIOS = sorted(EXPERIMENTS.glob("*.toml"))


@pytest.fixture(scope="module")
def valid() -> Callable[[dict[str, Any]], bool]:
    schema = json.loads(json.dumps(json_schema()))
    Draft202012Validator.check_schema(schema)
    judge: Callable[[dict[str, Any]], bool] = Draft202012Validator(schema).is_valid
    return judge


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_shipped_scenario_is_valid(
    path: Any, valid: Callable[[dict[str, Any]], bool]
) -> None:
    assert valid(tomllib.loads(path.read_text("utf-8")))


@pytest.mark.parametrize(
    ("assigned", "kept"),
    [
        ({"processes.target.max_stepp": "2 s"}, False),
        ({"processes.target.torque_density": ["1e-8 rad/s^1.5"]}, False),
        ({"processes.chaser.angle_random_walk_density": ["1 rad/sqrt(s)"] * 3}, True),
        ({"processes.chaser.angle_random_walk_density": True}, False),
        ({"sensors.beacons.kind": "beacon"}, False),
        ({"sensors.beacons.kind": "mine:Beacons"}, True),
        ({"sensors.beacons.gate": 2.0}, False),
        ({"sensors.beacons.sigma": None}, False),
        ({"sensors.beacons.sigma": None, "base": "other.toml"}, True),
        ({"sensors.beacons": False}, False),
        ({"sensors.beacons": False, "base": ["one.toml", "two.toml"]}, True),
        ({"prior": None}, False),
        ({"prior": None, "base": "other.toml"}, True),
        ({"tims.epochs": 5}, False),
        ({"time.epochs": "many"}, False),
        ({"base": []}, False),
    ],
)
def test_what_is_wrong_is_refused(
    assigned: dict[str, Any], kept: bool, valid: Callable[[dict[str, Any]], bool]
) -> None:
    raw = tomllib.loads((EXPERIMENTS / "zhang2015.toml").read_text("utf-8"))
    for path, value in assigned.items():
        *parents, last = path.split(".")
        table = raw
        for name in parents:
            table = table.setdefault(name, {})
        if value is None:
            del table[last]
        else:
            table[last] = value
    assert valid(raw) == kept


def test_the_file_beside_the_scenarios_is_this_schema() -> None:
    """Made by ``relnav validate --schema``; the first line of each scenario names it to editors."""
    stored = json.loads((EXPERIMENTS / "scenario.schema.json").read_text("utf-8"))
    assert stored == json.loads(json.dumps(json_schema()))
    for path in SCENARIOS:
        first = path.read_text("utf-8").partition("\n")[0]
        assert first == "#:schema scenario.schema.json", path
