"""A stream whose pose is taken from its first frames."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
from passes import ZHANG
from streams import feed, session_of

from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.streaming.writing import recording_lines

POSE = ("target_attitude", "relative_position")
FLAT = (
    "sensors.beacons.points=[[0.5, 0.5, 0], [-0.5, -0.5, 0], [-0.5, 0.5, 0], [0.4, -0.5, 0]]",
    'sensors.beacons.sigma="0.002 deg"',
)


@cache
def _stream(*settings: str, given: bool = False) -> tuple[Scenario, list[str]]:
    """Lines whose header gives the means of the pose, or not."""
    measured = [f'prior.{name}.mean="measured"' for name in POSE]
    scenario = load_scenario(ZHANG, ["time.epochs=12", *measured, *settings])
    recording = scenario.simulate(0)
    prior = scenario.problem(recording, 0).prior
    lines = list(recording_lines(recording, scenario.name, 0, scenario.layout, prior))
    header = json.loads(lines[0])
    header["prior"] = {n: v for n, v in header["prior"].items() if given or n not in POSE}
    return scenario, [json.dumps(header), *lines[1:]]


def _with_one_beacon(line: str) -> str:
    raw = json.loads(line)
    return json.dumps({**raw, "id": raw["id"][:1], "z": raw["z"][:1]})


def _near(a: list[dict[str, Any]], b: list[dict[str, Any]]) -> None:
    assert [line["status"] for line in a] == [line["status"] for line in b]
    for one, other in zip(a, b, strict=True):
        for name, block in one["estimate"].items():
            want = other["estimate"][name]
            np.testing.assert_allclose(block["value"], want["value"], rtol=1e-7, atol=1e-9)


def test_the_pose_of_the_first_frame_is_that_of_compare() -> None:
    told = [feed(session_of(s, lines[0]), lines) for s, lines in (_stream(), _stream(given=True))]
    assert [line["status"] for line in told[0]] == 12 * ["OK"]
    _near(*told)


def test_a_frame_that_does_not_suffice_says_what_is_missing() -> None:
    """The next one does; what is known of the others has moved there."""
    scenario, lines = _stream()
    first = next(i for i, line in enumerate(lines) if '"beacons"' in line)
    cut = [*lines[:first], _with_one_beacon(lines[first]), *lines[first + 1 :]]
    told = feed(session_of(scenario, cut[0]), cut)
    whole = feed(session_of(scenario, lines[0]), lines)
    assert told[0]["status"] == "LOST"
    assert told[0]["estimate"] is None
    assert "does not determine 4 directions" in told[0]["message"]
    assert "relative_position[" in told[0]["message"]
    assert len(told[0]["rejected"]) == 1
    assert [line["status"] for line in told[1:]] == 11 * ["OK"]
    for name in POSE:
        (a, b) = (line[-1]["estimate"][name] for line in (told, whole))
        away = np.linalg.norm(np.subtract(a["value"], b["value"]))
        assert away < 3 * np.linalg.norm(b["sigma"])


def test_a_stream_without_a_frame_stays_lost() -> None:
    scenario, lines = _stream()
    blind = [_with_one_beacon(line) if '"beacons"' in line else line for line in lines]
    told = feed(session_of(scenario, blind[0]), blind)
    assert [line["status"] for line in told] == 12 * ["LOST"]


@pytest.mark.parametrize("cut", [2, 5, 30])
def test_hypotheses_are_held_back_until_they_tell(cut: int) -> None:
    """Mirror poses: nothing comes out until some frames have told them apart, or it is said
    that they do not; and a session saved meanwhile goes on as it would have."""
    scenario, lines = _stream(*FLAT)
    session = session_of(scenario, lines[0])
    told, counts = list[dict[str, Any]](), list[int]()
    for i, line in enumerate(lines):
        if i == cut:
            data = session.save()
            session = session_of(scenario, lines[0])
            session.load(data)
        told += feed(session, [line], end=False)
        counts.append(len(told))
    told += session.pause() + session.end()
    beacons = [i for i, line in enumerate(lines) if '"beacons"' in line]
    assert counts[beacons[5]] == 0
    assert counts[beacons[8]] > 6
    assert [line["t"] for line in told] == sorted(line["t"] for line in told)
    assert len(told) == 12
    for one in told:
        assert one["status"] == "OK" or "hypotheses" in one["message"]
    whole = feed(session_of(scenario, lines[0]), lines)
    assert json.loads(json.dumps(told)) == whole


def test_what_was_held_back_comes_out_at_the_end() -> None:
    scenario, lines = _stream(*FLAT)
    third = [i for i, line in enumerate(lines) if '"beacons"' in line][2]
    told = feed(session_of(scenario, lines[0]), lines[: third + 1])
    assert len(told) == 3
