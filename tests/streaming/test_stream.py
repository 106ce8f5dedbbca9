"""`relnav stream`: order, late and repeated lines, sources, and what it says of them."""

from __future__ import annotations

import json
import shlex
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import ZHANG, relnav
from streams import (
    RELNAV,
    assert_close,
    changed,
    feed,
    lines_of,
    reasons,
    session_of,
    toy,
    write_scenario,
)

from relnav_graph.core.models import derived_quantities
from relnav_graph.estimators import run_estimator
from relnav_graph.io.tabular import component_columns, to_components
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scoring.deviations import estimates
from relnav_graph.streaming.beginning import prior_values
from relnav_graph.streaming.lines import LineError, header_of, parse_line
from relnav_graph.streaming.session import Options

Capture = pytest.CaptureFixture[str]
Toy = tuple[Scenario, list[str]]


@pytest.fixture(scope="module", name="toy")
def toy_(tmp_path_factory: pytest.TempPathFactory) -> Toy:
    return toy(tmp_path_factory.mktemp("toy"))


def _assert_equal_to_track(out: list[dict[str, Any]], scenario: Scenario, kind: str) -> None:
    """The lines out are what `compare` finds for its own simulation of the same seed."""
    seed = scenario.file.seed
    track = run_estimator(kind, scenario.problem(scenario.simulate(seed), seed))
    assert [line["t"] for line in out] == track.t.tolist()
    found = estimates(track, derived_quantities(scenario.layout))
    assert found.keys() == out[0]["estimate"].keys()
    for name, state in found.items():
        values = np.array([line["estimate"][name]["value"] for line in out])
        sigma = np.array([line["estimate"][name]["sigma"] for line in out])
        assert values.shape[1] == len(component_columns(state.block))
        expected = np.sqrt(np.diagonal(state.P, axis1=1, axis2=2))
        np.testing.assert_allclose(sigma, expected, rtol=1e-6)
        error = values - to_components(state.block, state.value)
        assert np.abs(error).max() < 1e-6 * expected.max()


@pytest.mark.parametrize("kind", ["ekf", "iekf", "incremental", "fixed_lag"])
def test_a_stream_is_what_compare_runs(toy: Toy, kind: str) -> None:
    scenario, lines = toy
    out = feed(session_of(scenario, lines[0], kind), lines)
    _assert_equal_to_track(out, scenario, kind)
    assert all(line["status"] == "OK" for line in out[1:])
    assert reasons(out) == []


def test_simulate_piped_into_stream_is_compare(tmp_path: Path) -> None:
    """Two processes, beacons and gyro, the prior that is drawn about the truth."""
    options = f"{ZHANG} --set time.epochs=40 --set seed=7"
    relnav = " ".join(map(shlex.quote, RELNAV))
    command = f"{relnav} simulate {options} -o - | {relnav} stream {options} -e fixed_lag"
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    out = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["seq"] for line in out] == list(range(40))
    assert all(line["latency_ms"] >= 0 for line in out)
    scenario = load_scenario(ZHANG, ["time.epochs=40", "seed=7"])
    _assert_equal_to_track(out, scenario, "fixed_lag")
    assert "80 lines in, 40 out; at last OK" in done.stderr


def test_the_order_of_lines_is_that_of_arrival_not_of_time(toy: Toy) -> None:
    """Shuffled within the window: the last estimate is the same, whatever the estimator."""
    scenario, lines = toy
    expected = feed(session_of(scenario, lines[0]), lines)
    rest = [changed(line) for line in lines[1:]]
    rng = np.random.default_rng(3)
    order = np.argsort(np.arange(len(rest)) + 8 * rng.random(len(rest)))
    shuffled = [changed(lines[0]), *(rest[i] for i in order)]
    assert shuffled[1:] != rest
    for kind in ("fixed_lag", "ekf"):
        ordered = feed(session_of(scenario, lines[0], kind), lines)
        out = feed(session_of(scenario, lines[0], kind), shuffled)
        assert reasons(out) == []
        assert_close([out[-1]], [ordered[-1]])
    assert len(expected) == 40


def test_what_arrives_at_one_moment_is_one_update(toy: Toy) -> None:
    scenario, lines = toy
    late = [lines[0]]
    for line in lines[1:]:
        late.append(changed(line, t_arrival=json.loads(line)["t"] + 0.25))
    out = feed(session_of(scenario, lines[0]), late)
    assert_close(out, feed(session_of(scenario, lines[0]), lines))


def test_predict_to_now(toy: Toy) -> None:
    """Every measurement is late by 2.5 s: the state at now has the sigma of a prediction."""
    scenario, lines = toy
    late = [lines[0]]
    late += [changed(line, t_arrival=json.loads(line)["t"] + 2.5) for line in lines[1:]]
    out = feed(session_of(scenario, lines[0], options=Options(predict_to_now=True)), late)
    for line in out[:-1]:
        assert line["now"]["t"] == pytest.approx(line["t"] + 3.5)
        then, now = line["estimate"]["relative_position"], line["now"]["estimate"]
        velocity = np.array(line["estimate"]["relative_velocity"]["value"])
        moved = np.array(now["relative_position"]["value"]) - then["value"]
        np.testing.assert_allclose(moved, 3.5 * velocity, atol=1e-9)
        assert (np.array(now["relative_position"]["sigma"]) > then["sigma"]).all()
    plain = feed(session_of(scenario, lines[0]), late)
    assert_close(out, plain)
    assert "now" not in plain[0]


def test_late_inside_the_window_is_used_and_beyond_it_refused(toy: Toy) -> None:
    scenario, lines = toy
    at = next(k for k, line in enumerate(lines) if json.loads(line).get("t") == 20.0 and k)
    moved = changed(lines[at])
    rest = [changed(line) for k, line in enumerate(lines) if k != at]
    ordered = feed(session_of(scenario, lines[0]), lines)
    inside = feed(session_of(scenario, lines[0]), [*rest[: at + 12], moved, *rest[at + 12 :]])
    assert reasons(inside) == []
    assert len(inside) == len(ordered) + 1  # the newest estimate once more
    assert_close([inside[-1]], [ordered[-1]])
    beyond = feed(session_of(scenario, lines[0]), [*rest, moved])
    assert set(reasons(beyond)) == {(json.loads(moved)["sensor"], "late")}
    without = feed(session_of(scenario, lines[0]), rest)
    assert_close([beyond[-1]], [without[-1]])


def test_duplicates_are_counted_and_not_used_twice(toy: Toy) -> None:
    scenario, lines = toy
    twice = [lines[0]]
    for line in lines[1:]:
        twice += [changed(line), changed(line)]
    session = session_of(scenario, lines[0])
    out = feed(session, twice)
    ordered = feed(session_of(scenario, lines[0]), lines)
    assert_close([out[-1]], [ordered[-1]])
    assert session.rejected["ranger"] == {"duplicate": 120}
    assert session.rejected["fix"] == {"duplicate": 20}


def test_numbered_lines_that_come_again_are_skipped(toy: Toy) -> None:
    scenario, lines = toy
    out = feed(session_of(scenario, lines[0]), [*lines[:30], *lines])
    assert out == feed(session_of(scenario, lines[0]), lines)


def test_a_session_goes_on_from_its_bytes_bit_for_bit(toy: Toy) -> None:
    scenario, lines = toy
    lines = [lines[0], *(changed(line) for line in lines[1:])]
    lines.insert(30, lines.pop(20))  # one comes late, some wait, some were refused
    lines.insert(25, "nonsense")
    for kind in ("fixed_lag", "iekf", "incremental"):
        whole = feed(session_of(scenario, lines[0], kind), lines)
        for at in (1, 2, 26, 31, 45):
            session = session_of(scenario, lines[0], kind)
            begun = feed(session, lines[:at], end=False)
            resumed = session_of(scenario, lines[0], kind)
            resumed.load(session.save())
            assert begun + feed(resumed, lines[at:]) == whole


def test_memory_is_flat_whatever_comes(toy: Toy) -> None:
    """Hundreds of epochs of what never becomes one: nothing is kept for ever."""
    scenario, lines = toy
    session = session_of(scenario, lines[0])
    feed(session, lines, end=False)
    sizes = []
    for k in range(600):
        t = 40.0 + k
        feed(session, [changed(lines[1], t=t), changed(lines[1], t=t - 30), "no line"], end=False)
        if k % 200 == 199:
            sizes.append(len(session.save()))
    assert max(sizes) < 1.02 * min(sizes)


# --- inputs ------------------------------------------------------------------------------


@pytest.fixture(scope="module", name="zhang")
def zhang_() -> Toy:
    scenario = load_scenario(ZHANG, ["time.epochs=30", "online.window=100.0"])
    return scenario, lines_of(scenario)


def test_measurements_wait_for_their_inputs(zhang: Toy) -> None:
    """The gyro comes three intervals late, by its own clock too, and out of order."""
    scenario, lines = zhang
    beacons = [changed(line) for line in lines if "beacons" in line[:20]]
    gyro = [
        changed(line, t_arrival=json.loads(line)["t_end"] + 30.0)
        for line in lines
        if "gyro" in line[:20]
    ]
    gyro[4], gyro[5] = gyro[5], gyro[4]
    mixed = [lines[0], *beacons[:4]]
    for k, sample in enumerate(gyro):
        mixed += [sample, *beacons[k + 4 : k + 5]]
    out = feed(session_of(scenario, lines[0]), mixed)
    assert_close(out, feed(session_of(scenario, lines[0]), lines))
    assert reasons(out) == []


def test_a_gap_in_the_inputs_is_bridged_and_said(zhang: Toy) -> None:
    scenario, lines = zhang
    gap = [k for k, line in enumerate(lines) if '"t_start": 100.0' in line]
    rest = [changed(line) for k, line in enumerate(lines) if k not in gap]
    out = feed(session_of(scenario, lines[0]), rest)
    assert reasons(out) == [("gyro", "gap")]
    bridged = next(line for line in out if line["t"] == 110.0)
    assert bridged["status"] == "DEGRADED"
    assert "gap" in bridged["message"]
    assert len(out) == 30
    assert out[-1]["status"] == "OK"


def test_measurements_without_inputs_are_refused_in_the_end(zhang: Toy) -> None:
    scenario, lines = zhang
    beacons = [changed(line) for line in lines if "gyro" not in line[:20]]
    out = feed(session_of(scenario, lines[0]), beacons)
    assert {line["status"] for line in out[1:]} == {"LOST"}
    assert all(line["estimate"] is None for line in out[1:])
    assert set(reasons(out)) == {("beacons", "no inputs")}
    assert len(reasons(out)) == 6 * 29


# --- lines -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"", "not a line of JSON"),
        (b"{", "not a line of JSON"),
        (b"[1]", "expected an object"),
        (b'{"a": "' + b"x" * (1 << 20) + b'"}', "bytes, expected 1048576 at most"),
        (b"[" * 5000, "not a line of JSON"),
        (b"\xff\xfe", "not a line of JSON"),
        (b'{"t": 1}', "expected one of format, sensor, input, epoch"),
        (b'{"sensor": "fix", "epoch": 1}', "expected one of format, sensor, input, epoch"),
        (b'{"sensor": "lidar", "t": 1, "id": [0], "z": [[1]]}', "unknown sensor 'lidar'"),
        (b'{"sensor": "fix", "id": [0], "z": [[1, 2, 3]]}', "line.t: missing"),
        (b'{"sensor": "fix", "t": "1", "id": [0], "z": [[1, 2, 3]]}', "line.t: Input should be"),
        (b'{"sensor": "fix", "t": 1, "id": [0], "z": [[1, 2]]}', "rows of z with [2] numbers"),
        (b'{"sensor": "fix", "t": 1, "id": [0], "z": [[1, 2, 3], [1]]}', "rows of z with [1, 3]"),
        (b'{"sensor": "fix", "t": 1, "id": [0, 1], "z": [[1, 2, 3]]}', "1 rows of z, but ids"),
        (b'{"sensor": "fix", "t": 1, "id": [0, 0], "z": [[1, 2, 3], [1, 2, 3]]}', "each one once"),
        (b'{"sensor": "fix", "t": 1, "id": [true], "z": [[1, 2, 3]]}', "line.id[0]: Input should"),
        (b'{"sensor": "fix", "t": 1, "id": [1e300], "z": [[1, 2, 3]]}', "line.id[0]: Input should"),
        (b'{"sensor": "ranger", "t": 1, "id": [3], "z": [[1]]}', "found id 3, expected 0 to 2"),
        (b'{"sensor": "fix", "t": 1, "id": [0], "z": [[1, 2, 3]], "w": 1}', "line.w: Extra"),
        (b'{"epoch": "now"}', "line.epoch: Input should be"),
        (b'{"input": "gyro", "t_start": 0, "t_end": 1, "values": [1]}', "unknown input 'gyro'"),
        (b'{"format": "csv", "version": 1}', "found format 'csv', version 1, expected"),
        (b'{"format": "relnav-lines", "version": 2}', "version 2, expected 'relnav-lines'"),
    ],
)  # fmt: skip
def test_a_line_that_cannot_be_used_says_why(toy: Toy, line: bytes, says: str) -> None:
    """And is counted, in a stream that goes on as if it had not been there."""
    scenario, lines = toy
    with pytest.raises(LineError) as caught:
        parse_line(line, scenario.sensors, {})
    assert says in caught.value.reason
    session = session_of(scenario, lines[0])
    begun = feed(session, lines[:20], end=False)
    begun += session.take(session.parse(line))
    out = begun + feed(session, lines[20:])
    expected = feed(session_of(scenario, lines[0]), lines)
    assert_close(out, expected)
    (rejected,) = [r for line in out for r in line["rejected"]]
    assert says in rejected["reason"]


@pytest.mark.parametrize(
    ("prior", "says"),
    [
        ('{"speed": [1]}', "header: prior.speed: the state has"),
        ('{"relative_position": [1, 2]}', "expected 3 numbers"),
        ('{"relative_position": [1, 2, NaN]}', "expected 3 numbers"),
        ("{}", "prior.relative_position"),
    ],
)
def test_a_header_that_cannot_be_used_ends_with_2(
    tmp_path: Path, capsys: Capture, prior: str, says: str
) -> None:
    path = write_scenario(tmp_path)
    lines = tmp_path / "lines"
    lines.write_text('{"format": "relnav-lines", "version": 1, "prior": ' + prior + "}\n", "utf-8")
    code, out, err = relnav(capsys, "stream", path, "--from", lines)
    assert (code, out) == (2, "")
    assert says in err


def test_attitudes_of_a_header_are_unit_quaternions() -> None:
    scenario = load_scenario(ZHANG)
    line = b'{"format": "relnav-lines", "version": 1, "prior": {"chaser_attitude": [1, 1, 0, 0]}}'
    with pytest.raises(ValueError, match="expected a unit quaternion"):
        prior_values(header_of(line), scenario.layout)
