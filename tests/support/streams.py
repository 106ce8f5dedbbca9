"""A stream that several test files use: position fixes and drifting ranges, 1 Hz."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.cli.stream import new_session
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.streaming.lines import header_of
from relnav_graph.streaming.session import Options, Session
from relnav_graph.streaming.writing import recording_lines

#: The command, in a process of its own.
RELNAV = (sys.executable, "-c", "from relnav_graph.cli.main import main; main()")

SCENARIO = """
title = "position fixes and a laser ranger that drifts with its temperature"
estimators = ["fixed_lag"]
seed = 4

[time]
step = "1 s"
epochs = 40

[online]
window = "10 s"

[processes.motion]
kind = "white_noise_acceleration"
acceleration_density = "2 mm/s^1.5"

[processes.electronics]
kind = "toy_model:ThermalDrift"
time_constant = "1 min"
density = "2 mm/sqrt(s)"

[sensors.fix]
kind = "toy_model:PositionFix"
covariance = [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]]
period = "2 s"

[sensors.ranger]
kind = "toy_model:DriftingRange"
points = [[2, 0, 0], [0, 2, 0], [0, 0, 2]]
sigma = "5 mm"

[prior]
relative_position = { sigma = "1 m" }
relative_velocity = { sigma = "10 cm/s" }
range_drift = { sigma = "20 cm", mean = [0] }

[truth]
kind = "own_models"

[truth.initial]
relative_position = [9, -6, 4]
relative_velocity = [-0.02, 0.01, 0]
range_drift = [0.15]
"""


def write_scenario(folder: Path, text: str = SCENARIO) -> Path:
    path = folder / "toy.toml"
    path.write_text(text, "utf-8")
    return path


def lines_of(scenario: Scenario, seed: int | None = None) -> list[str]:
    """What `relnav simulate -o -` writes."""
    seed = scenario.file.seed if seed is None else seed
    recording = scenario.simulate(seed)
    prior = scenario.prior(recording.truth, 0.0, seed)
    return list(recording_lines(recording, scenario.name, seed, scenario.layout, prior))


def session_of(
    scenario: Scenario, first: str, kind: str = "fixed_lag", options: Options | None = None
) -> Session:
    return new_session(scenario, kind, header_of(first.encode()), options or Options())


def feed(session: Session, lines: list[str], end: bool = True) -> list[dict[str, Any]]:
    """Lines out, as a reader of them gets them."""
    out = []
    for line in lines:
        parsed = session.parse(line.encode())
        if not session.repeats(parsed):
            out += session.take(parsed)
    if end:
        out += session.pause() + session.end()
    return [json.loads(json.dumps(line)) for line in out]


def toy(folder: Path) -> tuple[Scenario, list[str]]:
    scenario = load_scenario(write_scenario(folder))
    return scenario, lines_of(scenario)


def changed(line: str, **values: Any) -> str:
    """A line with other values, and without its number."""
    raw = {**json.loads(line), **values}
    return json.dumps({k: v for k, v in raw.items() if k != "n" and v is not None})


def reasons(out: list[dict[str, Any]]) -> list[tuple[str | None, str]]:
    """Sensor and the kind of reason of everything that was rejected."""
    return [(r["sensor"], r["reason"].partition(":")[0]) for line in out for r in line["rejected"]]


def values_of(line: dict[str, Any]) -> Array:
    """All numbers of an estimate, sigmas included."""
    return np.concatenate([[*s["value"], *s["sigma"]] for s in line["estimate"].values()])


def assert_close(found: list[dict[str, Any]], expected: list[dict[str, Any]]) -> None:
    assert [line["t"] for line in found] == [line["t"] for line in expected]
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(values_of(a), values_of(b), rtol=1e-9, atol=1e-9)
