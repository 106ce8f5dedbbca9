"""Row 58 in a stream: who holds the whole pass takes a second look at its end."""

from __future__ import annotations

from functools import cache

import pytest
from passes import ZHANG
from streams import feed, lines_of, session_of

from relnav_graph.core.cautions import Caution
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.second_look import SECOND_LOOK
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

SEED = 3


@cache
def bent() -> tuple[Scenario, list[str]]:
    """A far target with coarse lines of sight, in order of time."""
    scenario = load_scenario(
        ZHANG,
        (
            'time.step="1.26 s"',
            "time.epochs=40",
            'sensors.beacons.sigma="2 mrad"',
            'truth.relative_position=["3487 m", "1357 m", "-417 m"]',
            'inputs.gyro.period="1.26 s"',
            'prior.relative_position.sigma="500 m"',
        ),
    )
    return scenario, lines_of(scenario, SEED)


@pytest.mark.parametrize("kind", ["incremental", "isam2"])
def test_row_58_a_stream_ends_with_what_a_second_look_finds(kind: str) -> None:
    scenario, lines = bent()
    session = session_of(scenario, lines[0], kind)
    out = feed(session, lines)
    last = out[-1]
    assert (last["message"], last["status"]) == ("the end of the stream", "OK")
    assert [c["name"] for c in last["cautions"]] == [SECOND_LOOK]
    assert [c.name for c in session.cautions] == [SECOND_LOOK]
    assert all("cautions" not in line for line in out[:-1])


def test_row_58_the_look_changes_nothing_and_is_kept() -> None:
    """A stream may go on after its end; its look is then one of the past."""
    scenario, lines = bent()
    half = next(k for k, line in enumerate(lines) if '"t": 25.2' in line)
    whole = session_of(scenario, lines[0], "incremental")
    feed(whole, lines[:half])
    feed(whole, lines[half:])
    plain = session_of(scenario, lines[0], "incremental")
    feed(plain, lines[:half], end=False)
    plain.pause()
    again = session_of(scenario, lines[0], "incremental")
    feed(again, lines[:half])
    assert again.cautions
    resumed = session_of(scenario, lines[0], "incremental")
    resumed.load(again.save())
    assert resumed.cautions == again.cautions
    out = feed(plain, lines[half:])
    assert feed(resumed, lines[half:])[-2]["estimate"] == out[-2]["estimate"]
    assert (whole.online.x == plain.online.x).all()
    assert whole.cautions == plain.cautions == resumed.cautions


@pytest.mark.parametrize("kind", ["ekf", "fixed_lag"])
def test_row_58_who_does_not_hold_the_pass_takes_no_look(kind: str) -> None:
    scenario, lines = bent()
    session = session_of(scenario, lines[0], kind)
    out = feed(session, lines)
    assert session.online.second_look() == ()
    assert all("cautions" not in line for line in out)


def test_row_58_a_good_stream_ends_as_before() -> None:
    scenario = load_scenario(ZHANG, ["time.epochs=12"])
    lines = lines_of(scenario, SEED)
    session = session_of(scenario, lines[0], "incremental")
    out = feed(session, lines)
    assert len(out) == 12
    assert session.cautions == ()


def test_row_58_a_look_that_fails_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, lines = bent()
    session = session_of(scenario, lines[0], "incremental")
    feed(session, lines, end=False)
    x = session.online.x.copy()

    def fails(state: object) -> tuple[Caution, ...]:
        raise EstimationError("no trajectory")

    monkeypatch.setattr(session.online.engine, "second_look", fails)
    found = session.online.second_look()
    assert [str(c) for c in found] == [
        f"{SECOND_LOOK}: no second look could be taken: no trajectory"
    ]
    assert (session.online.x == x).all()
