"""Rows 6 and 7: measurements in another unit, and time stamps of another clock."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from passes import ZHANG, relnav
from streams import changed, feed, lines_of, session_of, toy, write_scenario

from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

Toy = tuple[Scenario, list[str]]


@pytest.fixture(scope="module", name="toy")
def toy_(tmp_path_factory: pytest.TempPathFactory) -> Toy:
    return toy(tmp_path_factory.mktemp("toy"))


def _scaled(line: str, sensor: str, scale: float) -> str:
    raw = json.loads(line)
    if raw.get("sensor") != sensor:
        return line
    return changed(line, z=(scale * np.array(raw["z"])).tolist())


# --- 6 -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "factor"), [("km", 1e-3), ("mm", 1e3)])
@pytest.mark.parametrize("sensor", ["fix", "ranger"])
def test_row_6_another_unit_is_refused_with_a_hint(
    toy: Toy, sensor: str, unit: str, factor: float
) -> None:
    """Each of its measurements, from the first on; the others do as without it."""
    scenario, lines = toy
    wrong = [_scaled(line, sensor, factor) for line in lines]
    out = feed(session_of(scenario, lines[0]), wrong)
    rejected = [r for line in out for r in line["rejected"]]
    assert {r["sensor"] for r in rejected} == {sensor}
    assert all(r["reason"].startswith(f"unit: {unit} given for m?") for r in rejected)
    assert len(rejected) == (20 if sensor == "fix" else 120)
    without = [line for line in lines if json.loads(line).get("sensor") != sensor]
    ticks = [json.dumps({"epoch": float(t)}) for t in range(40)] if sensor == "ranger" else []
    alone = feed(session_of(scenario, lines[0]), [*without[:1], *_in_order(without[1:], ticks)])
    np.testing.assert_allclose(
        out[-1]["estimate"]["relative_position"]["value"],
        alone[-1]["estimate"]["relative_position"]["value"],
        rtol=1e-12,
    )


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("prior.target_attitude.sigma=60", "60 rad is 3438 deg, more than half a turn"),
        ("prior.chaser_attitude.sigma=[0.1, 5, 0.1]", "5 rad is 286.5 deg, more than half a turn"),
        ("sensors.beacons.sigma=4", "4 rad is 229.2 deg, more than half a turn"),
        ("prior.target_attitude.sigma='180 deg'", ""),
        ("prior.relative_position.sigma=60", ""),
    ],
)
def test_row_6_an_angle_known_to_many_turns_is_doubted(
    setting: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Degrees without their unit. Said before there are data, and of the pass."""
    code, out, _ = relnav(capsys, "validate", ZHANG, "--set", setting)
    assert code == 0
    scenario = load_scenario(ZHANG, [setting, "time.epochs=3"])
    of_pass = scenario.problem(scenario.simulate(0), 0).cautions
    assert scenario.cautions == of_pass
    assert [c.name for c in of_pass] == ["angle"] * bool(says)
    if says:
        text = f"{setting.partition('=')[0]}: {says}: are degrees meant? write "
        assert of_pass[0].text.startswith(text)
        assert f"caution: angle: {text}" in out


def _in_order(lines: list[str], ticks: list[str]) -> list[str]:
    def time(line: str) -> float:
        raw = json.loads(line)
        return float(raw.get("t", raw.get("epoch", 0.0)))

    return sorted((changed(line) for line in [*lines, *ticks]), key=time)


def test_row_6_offline_too(toy: Toy) -> None:
    scenario, _ = toy
    recording = scenario.simulate(4)
    wrong = tuple(
        Measurement(m.sensor, m.t, m.z / 1e3 if m.sensor == "ranger" else m.z, m.ids)
        for m in recording.measurements
    )
    with pytest.raises(InputError, match=r"sensor 'ranger' at t = 0\.0 s: km given for m\?"):
        scenario.problem(replace(recording, measurements=wrong), 4)


def test_row_6_a_unit_vector_that_is_none(tmp_path: Path) -> None:
    """A line of sight in degrees, or a position in its place."""
    scenario = load_scenario(ZHANG, ["time.epochs=3"])
    lines = lines_of(scenario)
    out = feed(session_of(scenario, lines[0]), [_scaled(line, "beacons", 57.3) for line in lines])
    rejected = [r for line in out for r in line["rejected"]]
    assert len(rejected) == 3
    assert all("expected a unit vector" in r["reason"] for r in rejected)


def test_row_6_a_right_unit_is_left_alone(toy: Toy) -> None:
    """Also where the first measurement is an outlier, and where the prior is wide."""
    scenario, lines = toy
    at = next(k for k, line in enumerate(lines) if '"fix"' in line)
    far = [*lines[:at], changed(lines[at], z=[[60.0, 70.0, -80.0]]), *lines[at + 1 :]]
    out = feed(session_of(scenario, lines[0]), far)
    assert not any("unit" in r["reason"] for line in out for r in line["rejected"])


# --- 7 -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"t": float("nan")}, "the time is not finite"),
        ({"t": float("inf")}, "the time is not finite"),
        ({"t": None}, "line.t: missing"),
        ({"t": "12:00"}, "line.t: Input should be a valid number"),
        ({"t": 1.7e9}, "taken to be of another clock"),
        ({"t": -1.7e9}, "taken to be of another clock"),
        ({"t_arrival": 1.7e9}, "taken to be of another clock"),
        ({"t_arrival": float("nan")}, "expected a finite time"),
        ({"t": 20.0, "t_arrival": 19.0}, "before its own time"),
        ({"t": -1.0}, "before the prior"),
    ],
)
def test_row_7_a_time_that_cannot_be(toy: Toy, values: dict[str, object], says: str) -> None:
    """It is refused, counted by its sensor, and moves no clock."""
    scenario, lines = toy
    wrong = json.loads(lines[30])
    wrong = {k: v for k, v in {**wrong, **values}.items() if k != "n" and v is not None}
    session = session_of(scenario, lines[0])
    out = feed(session, lines[:28], end=False)
    state = session.online.state()
    told = session.take(session.parse(json.dumps(wrong).encode()))
    after = session.online.state()
    # A time of another clock is said at once; what has no time at all, with the next line.
    of_a_clock = "clock" in says or "before" in says
    assert [(line["status"], line["t"]) for line in told] == [("DEGRADED", 16.0)] * of_a_clock
    assert all(np.array_equal(state[k], after[k], equal_nan=True) for k in state)
    out += feed(session, lines[28:])
    rejected = [r for line in [*told, *out] for r in line["rejected"]]
    assert rejected
    assert all(says in r["reason"] and r["sensor"] == wrong["sensor"] for r in rejected)
    assert session.rejected.keys() == {wrong["sensor"]}
    expected = feed(session_of(scenario, lines[0]), lines)
    assert [line["estimate"] for line in out] == [line["estimate"] for line in expected]


def test_row_7_the_command_says_so_and_does_not_exit_0(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_scenario(tmp_path)
    lines = lines_of(load_scenario(path))
    lines.insert(20, changed(lines[20], t=1.7e9))
    (tmp_path / "lines").write_text("\n".join(lines) + "\n", "utf-8")
    options = "--from", tmp_path / "lines", "-o", tmp_path / "out"
    code, _, err = relnav(capsys, "stream", path, *options)
    sensor = json.loads(lines[20])["sensor"]
    assert code == 3
    assert f"{sensor}: not used: " in err
    assert "clock" in err
    # A pass may have a gap of that length: then one says so.
    wide = tmp_path / "wide"
    code, _, _ = relnav(capsys, "stream", path, *options[:2], "-o", wide, "--max-gap", 2e9)
    assert json.loads(wide.read_text().splitlines()[-1])["t"] == 1.7e9
