"""Rows 12 and 45 in a stream: what is one epoch, and life after a gap in an input."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from gyro_gaps import EPOCHS, SEED, lines_of_gap, scenario_of
from streams import changed, feed, lines_of, session_of

from relnav_graph.core.measurement import InputSeries
from relnav_graph.estimators import run_estimator

# --- 45 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["ekf", "incremental", "fixed_lag"])
@pytest.mark.parametrize("gone", [[5, 6, 7, 8], [8, 9, 10, 11], [7, 8, 9, 10, 11, 12, 13]])
def test_row_45_a_stream_begins_again_after_a_gap_beyond(kind: str, gone: list[int]) -> None:
    """From the last estimate, over what is left of the gap, as if bridged: without what was
    measured before the input was there again, which is LOST. All later lines say so."""
    epochs = "time.epochs=60"
    lines = lines_of(scenario_of(epochs), SEED)
    starts = [10.0 * k for k in gone]
    lines = [changed(line) for line in lines if json.loads(line).get("t_start") not in starts]
    session = session_of(scenario_of(epochs), lines[0], kind)
    out = feed(session, lines)
    lost = [line["t"] for line in out if line["status"] == "LOST"]
    after = 10.0 * (gone[-1] + 2)
    before = lost[0] - 10
    assert 10.0 * gone[0] <= before < 10.0 * gone[0] + 40
    assert lost == [t for t in 10.0 * np.arange(1, 60) if before < t < after]
    assert session.status == out[-1]["status"] == "OK"
    again = [line for line in out if line["t"] >= after]
    assert again[0]["status"] == "DEGRADED"
    assert f"begun again from the estimate of {before} s" in str(again[0]["cautions"])
    for line in out:
        named = [c["name"] for c in line.get("cautions", [])]
        assert named == (["begun again"] if line["t"] >= after else [])
    sigma = again[0]["estimate"]["chaser_attitude"]["sigma"]
    assert len(again) == 60 - gone[-1] - 2
    wide = scenario_of(epochs, 'gaps.gyro.bridge="100 s"')
    rest = [line for line in lines if json.loads(line).get("t") not in lost]
    bridged = feed(session_of(wide, lines[0], kind), rest)
    at = next(line for line in bridged if line["t"] == after)
    np.testing.assert_allclose(sigma, at["estimate"]["chaser_attitude"]["sigma"], rtol=1e-12)
    for name, found in out[-1]["estimate"].items():
        np.testing.assert_array_equal(found["value"], bridged[-1]["estimate"][name]["value"])


def test_row_45_a_resumed_stream_knows_that_it_began_again() -> None:
    lines = lines_of_gap([8, 9, 10, 11])
    whole = feed(session_of(scenario_of(), lines[0], "ekf"), lines)
    first = session_of(scenario_of(), lines[0], "ekf")
    at = next(k for k, line in enumerate(lines) if json.loads(line).get("t") == 170.0)
    out = feed(first, lines[:at], end=False)
    second = session_of(scenario_of(), lines[0], "ekf")
    second.load(first.save())
    assert [*out, *feed(second, lines[at:])] == whole
    assert [c.name for c in second.cautions] == ["begun again"]


def test_row_45_an_input_that_is_not_back_stays_lost() -> None:
    """So does one of which nobody says how far it may have gone."""
    lines = lines_of_gap(range(8, EPOCHS))
    out = feed(session_of(scenario_of(), lines[0], "ekf"), lines)
    assert [line["status"] for line in out[-6:]] == ["LOST"] * 6
    lines = lines_of_gap([8, 9, 10, 11])
    session = session_of(scenario_of(), lines[0], "ekf")
    session.problem = replace(session.problem, bridges={})
    out = feed(session, lines)
    assert out[-1]["status"] == "LOST"
    assert "no inputs: input 'gyro' has a gap after 80.0 s" in out[-1]["message"]


# --- 12 ----------------------------------------------------------------------------------


def test_row_12_online_epochs_close_together_are_those_of_offline() -> None:
    """Half a microsecond apart, with `merge = 0`: their inputs are those that tell of the time
    between, and what one sensor sees of one id in both are two measurements."""
    scenario = scenario_of("time.merge=0")
    recording = scenario_of().simulate(SEED)
    two = list(recording.measurements)
    two += [replace(m, t=m.t + 5e-7, z=m.z[::-1], ids=m.ids[::-1]) for m in two]
    two.sort(key=lambda m: m.t)
    g = recording.inputs["gyro"]
    beyond = InputSeries(
        "gyro",
        np.append(g.t_start, g.t_end[-1]),
        np.append(g.t_end, g.t_end[-1] + 10),
        np.vstack([g.values, g.values[:1]]),
    )
    times = np.array([m.t for m in two])
    both = replace(recording, measurements=tuple(two), times=times, inputs={"gyro": beyond})
    problem = scenario.problem(both, SEED)
    lines = lines_of(scenario_of(), SEED)
    inputs = [
        json.dumps({"input": "gyro", "t_start": a, "t_end": b, "values": v.tolist()})
        for a, b, v in zip(beyond.t_start, beyond.t_end, beyond.values, strict=True)
    ]
    own = [
        json.dumps({"sensor": m.sensor, "t": m.t, "id": m.ids.tolist(), "z": m.z.tolist()})
        for m in two
    ]
    # Each sample comes after what was measured at its end.
    order = own[:2]
    for k, sample in enumerate(inputs):
        order += [*own[2 * k + 2 : 2 * k + 3], sample, *own[2 * k + 3 : 2 * k + 4]]
    session = session_of(scenario, lines[0], "ekf")
    out = feed(session, [lines[0], *order])
    assert session.rejected == {}
    assert [line["t"] for line in out] == [m.t for m in two]
    for found, expected in zip(session.online.epochs, problem.epochs[-30:], strict=True):
        assert found.t == expected.t
        for name, u in expected.inputs.items():
            np.testing.assert_array_equal(found.inputs[name], u)
    x = run_estimator("ekf", problem).x[-1]
    np.testing.assert_allclose(session.online.x, x, rtol=1e-9, atol=1e-12)


def test_row_12_a_repeat_within_merge_is_a_duplicate() -> None:
    scenario = scenario_of('time.merge="1 ms"')
    lines = lines_of(scenario_of(), SEED)
    again = [k for k, line in enumerate(lines) if json.loads(line).get("t") == 50.0]
    other = changed(lines[again[0]], t=50.0004)
    session = session_of(scenario, lines[0], "ekf")
    plain = session_of(scenario, lines[0], "ekf")
    moved = json.loads(other)
    moved["z"] = [[-v for v in row] for row in moved["z"]]
    feed(session, [*lines[: again[0] + 6], other, json.dumps(moved), *lines[again[0] + 6 :]])
    feed(plain, lines)
    assert set(session.rejected["beacons"]) == {"duplicate", "second value"}
    np.testing.assert_array_equal(session.online.x, plain.online.x)
