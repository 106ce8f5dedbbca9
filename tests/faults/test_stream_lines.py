"""Rows 44, 48, 50 and 51: the clock of a stream, and numbers that lines should not hold."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import ZHANG, relnav
from streams import assert_close, changed, feed, lines_of, reasons, session_of, toy, write_scenario

from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.streaming.beginning import prior_values
from relnav_graph.streaming.lines import header_of
from relnav_graph.streaming.session import Options, Session

Toy = tuple[Scenario, list[str]]
Capture = pytest.CaptureFixture[str]
HUGE = "1" + 309 * "0"
TIMES = ("t", "t_arrival", "t_start", "t_end", "epoch")


@pytest.fixture(scope="module", name="toy")
def toy_(tmp_path_factory: pytest.TempPathFactory) -> Toy:
    return toy(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="module", name="zhang")
def zhang_() -> Toy:
    scenario = load_scenario(ZHANG, ["time.epochs=40", "online.window=100.0"])
    return scenario, lines_of(scenario)


def _state(session: Session) -> dict[str, Any]:
    """All that a session knows, but for what counts and tells refusals."""
    held = dict(session.online.state())
    own = {k: v.tolist() for k, v in held.items()}
    clock = {name: (o.newest, o.step) for name, o in session._clock._own.items()}
    waits = [(e.t, e.arrival, len(e.measurements)) for e in session._waiting.epochs]
    inputs = {name: len(b.samples) for name, b in session._inputs.items()}
    return {"own": repr(own), "clock": (session._clock.heard, clock), "waits": waits} | inputs


def _moved(line: str, shift: float = 0.0, scale: float = 1.0) -> str:
    raw = json.loads(line)
    return changed(line, **{k: scale * raw[k] + shift for k in TIMES if k in raw})


# --- 50 ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [
        '{"epoch": HUGE}',
        '{"sensor": "fix", "t": HUGE, "id": [0], "z": [[1, 2, 3]]}',
        '{"sensor": "fix", "t": 14, "t_arrival": HUGE, "id": [0], "z": [[1, 2, 3]]}',
        '{"sensor": "fix", "t": 14, "id": [HUGE], "z": [[1, 2, 3]]}',
        '{"sensor": "fix", "t": 14, "id": [0], "z": [[1, 2, HUGE]]}',
        '{"sensor": "fix", "t": 14, "id": [0], "z": [[1, 2, 1e308]]}',
        '{"sensor": "fix", "t": 14, "id": [-1], "z": [[1, 2, [3]]]}',
        '{"sensor": "fix", "t": 1e308, "id": [0], "z": [[1, 2, 3]]}',
        '{"sensor": {"fix": 1}, "t": 14, "id": [0], "z": [[1, 2, 3]]}',
        '{"sensor": "fix", "t": 14, "id": [0], "z": [[1, 2, 3]], "n": HUGE}',
        '{"sensor": "fix", "t": 1.7e18, "id": [0], "z": [[1, 2, 3]], "n": 1000000}',
        '{"sensor": "fix", "t": 14, "id": [0], "z": [[1, 2, NaN]], "n": 1000000}',
        '{"n": HUGE}',
        '{"epoch": 14, "t_arrival": -1e308}',
        '{"epoch": ' + 4305 * "1" + "}",
        '{"format": "relnav-lines", "version": 1, "t": HUGE}',
    ],
)  # fmt: skip
def test_row_50_a_number_out_of_bounds_changes_nothing(toy: Toy, line: str) -> None:
    """The line is refused, and counted; the numbered lines that follow are no repeats."""
    scenario, lines = toy
    session = session_of(scenario, lines[0])
    out = feed(session, lines[:20], end=False)
    before = _state(session)
    session.take(session.parse(line.replace("HUGE", HUGE).encode()))
    assert session.refused == 1
    assert _state(session) == before
    out += feed(session, lines[20:])
    assert_close([x for x in out if x["t"] is not None][-1:], feed_all(toy)[-1:])
    assert sum(n for counts in session.rejected.values() for n in counts.values()) == 1


def feed_all(toy: Toy) -> list[dict[str, Any]]:
    scenario, lines = toy
    return feed(session_of(scenario, lines[0]), lines)


def test_row_50_a_refused_line_with_a_large_number_hides_no_good_ones(toy: Toy) -> None:
    scenario, lines = toy
    wrong = json.dumps({"sensor": "fix", "t": -50.0, "id": [0], "z": [[1, 2, 3]], "n": 10**9})
    out = feed(session_of(scenario, lines[0]), [*lines[:20], wrong, *lines[20:]])
    taken = [line for line in out if not line["message"].startswith("fix: clock")]
    assert_close(taken, feed_all(toy))


def test_row_50_a_good_line_with_a_large_number_hides_no_later_ones(toy: Toy) -> None:
    """What is new by its time is no repeat."""
    scenario, lines = toy
    raw = {**json.loads(lines[20]), "n": 10**9}
    out = feed(session_of(scenario, lines[0]), [*lines[:20], json.dumps(raw), *lines[21:]])
    assert_close(out[-1:], feed_all(toy)[-1:])


@pytest.mark.parametrize("begin", [-1e300, -3000.0, -1e9])
def test_row_50_a_wide_input_does_not_shut_out_the_others(zhang: Toy, begin: float) -> None:
    scenario, lines = zhang
    wide = {"input": "gyro", "t_start": begin, "t_end": 330.0, "values": [0.1, 0.1, 0.1]}
    at = next(k for k, line in enumerate(lines) if '"t_start": 320.0' in line)
    out = feed(session_of(scenario, lines[0]), [*lines[:at], json.dumps(wide), *lines[at:]])
    taken = [line for line in out if "clock" not in line["message"]]
    assert_close(taken, feed_all(zhang))
    assert [r[0] for r in reasons(out)] == ["gyro"]


def test_row_50_a_line_of_many_mistakes_is_refused_quickly(toy: Toy) -> None:
    scenario, lines = toy
    session = session_of(scenario, lines[0])
    feed(session, lines[:10], end=False)
    z = '{"sensor": "fix", "t": 10, "id": [0], "z": [[' + '"a",' * 200_000 + "1]]}"
    keys = "{" + ", ".join(f'"{k}": 0' for k in range(100_000)) + "}"
    names = json.dumps({"sensor": 100_000 * "fix", "t": 10, "id": [0], "z": [[1, 2, 3]]})
    begun = time.perf_counter()
    for line in (z, keys, names):
        session.take(session.parse(line.encode()))
    assert time.perf_counter() - begun < 2.0
    assert session.refused == 3
    out = feed(session, lines[10:])
    assert all(len(r["reason"]) < 400 for line in out for r in line["rejected"])


def test_row_50_names_and_reasons_that_come_to_no_end_take_no_memory(toy: Toy) -> None:
    scenario, lines = toy
    session = session_of(scenario, lines[0])
    feed(session, lines[:10], end=False)
    for k in range(3000):
        for line in (f'{{"sensor": "s{k}", "t": 1}}', f'{{"key{k}": 1}}', f'{{"input": "{k}"}}'):
            session.take(session.parse(line.encode()))
    assert len(session.rejected) <= 2
    assert all(len(counts) <= 21 for counts in session.rejected.values())
    assert len(session.save()) < 1_000_000


def test_row_50_what_waits_for_inputs_is_bounded(
    zhang: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without inputs, without an epoch, or all of one time: nothing is kept without end."""
    monkeypatch.setattr("relnav_graph.streaming.buffers.ROOM", 50)
    scenario, lines = zhang
    beacon = next(line for line in lines if '"beacons"' in line)
    gyro = next(line for line in lines if '"gyro"' in line)
    session = session_of(scenario, lines[0])
    for k in range(200):
        t = 10.0 + k / 100
        for line in (
            changed(beacon, t=t),
            changed(beacon, t=300.0, id=[6 * k + i for i in range(6)]),
            changed(gyro, t_start=10 * k, t_end=10 * k + 10),
        ):
            session.take(session.parse(line.encode()))
    assert len(session._waiting.epochs) <= 50
    assert sum(len(e.measurements) for e in session._waiting.epochs) <= 200
    assert len(session._inputs["gyro"].samples) <= 50


# --- 51 ----------------------------------------------------------------------------------


def test_row_51_prediction_to_now_without_inputs_says_which(zhang: Toy) -> None:
    """No gyro at all; then some, which go on to now."""
    scenario, lines = zhang
    options = Options(predict_to_now=True)
    late = [changed(x, t_arrival=json.loads(x)["t"] + 25.0) for x in lines if '"beacons"' in x]
    out = feed(session_of(scenario, lines[0], options=options), [lines[0], *late])
    now = next(line["now"] for line in out if "now" in line and line["now"]["estimate"] is None)
    assert "gyro" in now["message"]
    gyro = [line for line in lines[1:] if '"gyro"' in line]
    mixed = [x for pair in zip(gyro, late[1:], strict=False) for x in pair]
    out = feed(session_of(scenario, lines[0], options=options), [lines[0], late[0], *mixed])
    held = [line["now"] for line in out[3:-1] if "now" in line]
    assert held
    assert all(now["estimate"] is not None for now in held)
    assert all(now["t"] > line["t"] for now, line in zip(held, out[3:-1], strict=False))


def test_row_51_a_late_measurement_that_fails_leaves_the_newest_estimate(
    zhang: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the newest epoch, and within the window: that estimate again, and why."""
    scenario, lines = zhang
    last = json.loads(lines[-1])
    assert last["t"] == 390.0
    first = changed(lines[-1], id=last["id"][:5], z=last["z"][:5])
    for t in (390.0, 385.0):
        session = session_of(scenario, lines[0])
        newest = (feed(session, [*lines[:-1], first], end=False) + session.pause())[-1]

        def fails(_: object) -> None:
            raise np.linalg.LinAlgError("indeterminate")

        monkeypatch.setattr(session.online, "insert", fails)
        late = changed(lines[-1], t=t, id=last["id"][5:], z=last["z"][5:], t_arrival=391.0)
        out = feed(session, [late], end=False) + session.pause()
        assert [(line["t"], line["status"]) for line in out] == [(390.0, "DEGRADED")]
        assert "indeterminate" in out[0]["message"]
        assert out[0]["estimate"] == newest["estimate"]


# --- 44 ----------------------------------------------------------------------------------


def _after(toy: Toy, at: int, **moved: float) -> tuple[Session, list[dict[str, Any]]]:
    """The lines out from the first one whose clock is another one."""
    scenario, lines = toy
    session = session_of(scenario, lines[0])
    feed(session, lines[:at], end=False)
    session.pause()
    return session, feed(session, [_moved(line, **moved) for line in lines[at:]])


@pytest.mark.parametrize("shift", [-25.0, -12.0, -2000.0, -1e5, 1e5])
def test_row_44_a_clock_that_jumps_is_said_at_once_and_not_used(toy: Toy, shift: float) -> None:
    at = 2 + next(k for k, line in enumerate(toy[1]) if json.loads(line).get("t") == 30.0)
    session, out = _after(toy, at, shift=shift)
    assert out[0]["status"] == "DEGRADED"
    assert "clock" in out[0]["message"]
    assert out[0]["t"] == 30.0
    assert session.online.t == 30.0  # nor when the wrong clock has come there again
    assert {why for _, why in reasons(out)} <= {"clock", "late", "second value"}


def test_row_44_a_clock_set_back_is_not_taken_in_when_it_has_caught_up(toy: Toy) -> None:
    """Another pass whose clock is 25 s behind, to well beyond the newest time."""
    scenario, lines = toy
    session = session_of(scenario, lines[0])
    feed(session, lines, end=False)
    session.pause()
    other = lines_of(load_scenario_like(scenario, 80), 5)
    out = feed(session, [_moved(line, shift=14.0) for line in other[1:]])
    assert session.online.t == 39.0
    assert out[0]["status"] == "DEGRADED"
    # It jumps forward again to where it was: taken in at once, with a clock that is right.
    back = [_moved(line, shift=100.0) for line in other[1:40]]
    out = feed(session, back)
    assert session.online.t is not None
    assert session.online.t > 100.0


def load_scenario_like(scenario: Scenario, epochs: int) -> Scenario:
    from relnav_graph.scenario.build import make_scenario

    raw = {**scenario.raw, "time": {"step": "1 s", "epochs": epochs}}
    return make_scenario(raw, scenario.name)


def test_row_44_a_clock_within_the_window_is_told_by_contradictions(zhang: Toy) -> None:
    """The inputs overlap, the beacons have seen another value: both said, neither used."""
    at = next(k for k, line in enumerate(zhang[1]) if '"t_start": 300.0' in line)
    session, out = _after(zhang, at, shift=-50.0)
    first = {line["message"].partition(":")[0] for line in out[:2]}
    assert first == {"gyro", "beacons"}
    assert all(line["status"] == "DEGRADED" for line in out[:2])
    assert session.online.t == 300.0
    assert_close([{**out[1]}], [line for line in feed_all(zhang) if line["t"] == 300.0])


@pytest.mark.parametrize(
    ("scale", "says"), [(1e3, "milli"), (1e6, "micro"), (1e9, "nano"), (1e300, "")]
)
def test_row_44_another_scale_is_said_with_its_unit(zhang: Toy, scale: float, says: str) -> None:
    at = next(k for k, line in enumerate(zhang[1]) if '"t_start": 300.0' in line)
    session, out = _after(zhang, at, scale=scale)
    assert out[0]["status"] == "DEGRADED"
    assert f"{says}seconds given for seconds?" in out[0]["message"] or not says
    assert session.online.t == 300.0


def test_row_44_a_jump_forward_is_a_silence_and_said(toy: Toy) -> None:
    at = 1 + next(k for k, line in enumerate(toy[1]) if json.loads(line).get("t") == 30.0)
    _, out = _after(toy, at, shift=500.0)
    assert out[0]["status"] == "DEGRADED"
    assert "a silence, or a clock that jumped" in out[0]["message"]
    later = [line for line in out if line["t"] > 100]
    before, after = (x["estimate"]["relative_position"]["sigma"] for x in (out[0], later[0]))
    assert max(before) < max(after)
    assert later[-1]["status"] == "OK"


def test_row_44_a_sender_that_begins_again_is_no_clock(toy: Toy, zhang: Toy) -> None:
    """All lines once more, without numbers, and then the rest: nothing is lost."""
    for scenario, lines in (toy, zhang):
        plain = [changed(line) for line in lines]
        half = len(plain) // 2
        session = session_of(scenario, lines[0])
        out = feed(session, [*plain[:half], *plain[1:half], *plain[half:]])
        assert_close(out[-1:], feed_all((scenario, lines))[-1:])
        assert session.online.t == json.loads(lines[-1])["t"]


# --- 48 ----------------------------------------------------------------------------------


def test_row_48_quaternions_of_a_header_with_few_decimals() -> None:
    scenario = load_scenario(ZHANG)

    def means(q: list[float]) -> Any:
        line = {"format": "relnav-lines", "version": 1, "prior": {"chaser_attitude": q}}
        return prior_values(header_of(json.dumps(line).encode()), scenario.layout)

    q = np.array([0.8, -0.2, 0.4, 0.3])
    q /= np.linalg.norm(q)
    exact = means(q.tolist())["chaser_attitude"]
    for decimals in (3, 4, 5, 9):
        R = means(np.round(q, decimals).tolist())["chaser_attitude"]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(R, exact, atol=2 * 10.0**-decimals)
    for wrong in (1.002 * q, 0.998 * q, 0 * q):
        with pytest.raises(ValueError, match=r"expected a unit quaternion, within 0\.001"):
            means(wrong.tolist())


@pytest.mark.parametrize("value", ["1e300", "-1e31", "1e999", HUGE])
def test_row_48_a_header_with_a_huge_prior_ends_with_2(
    tmp_path: Path, capsys: Capture, value: str
) -> None:
    path, data = write_scenario(tmp_path), tmp_path / "lines"
    prior = '{"relative_position": [1, 2, ' + value + "]}"
    data.write_text('{"format": "relnav-lines", "version": 1, "prior": ' + prior + "}\n", "utf-8")
    code, out, err = relnav(capsys, "stream", path, "--from", data)
    assert (code, out) == (2, "")
    assert "prior.relative_position" in err
    assert "Traceback" not in err
