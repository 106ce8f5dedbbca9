"""Rows 12, 45 and 49: inputs with gaps and in another unit; what counts as one epoch."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gyro_gaps import EPOCHS, SEED, lines_of_gap, scenario_of
from passes import ZHANG, relnav
from streams import changed, feed, lines_of, session_of

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import epoch_times, process_inputs
from relnav_graph.core.measurement import Bridge, InputSeries, Measurement
from relnav_graph.core.packing import split
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.runs.comparison import compare

KINDS = ("batch", "rts", "ekf", "iekf", "incremental", "fixed_lag")
SPREAD = np.radians(0.1)


@pytest.fixture(scope="module", name="recording")
def recording_() -> Recording:
    return scenario_of().simulate(SEED)


def without(recording: Recording, gone: Sequence[int]) -> Recording:
    """Less some samples of the gyro, 10 s each."""
    g = recording.inputs["gyro"]
    kept = np.setdiff1d(np.arange(len(g.t_start)), gone)
    return replace(
        recording,
        inputs={"gyro": InputSeries("gyro", g.t_start[kept], g.t_end[kept], g.values[kept])},
    )


def attitude(track: Track) -> Array:
    """Sigmas of the chaser's attitude (N, 3), rad."""
    return np.sqrt(np.diagonal(track.covariance("chaser_attitude"), axis1=1, axis2=2))


# --- 45 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("gone", [[0], [9], [EPOCHS - 2], [0, 1], [8, 9, 10], [2, 7, 12]])
def test_row_45_a_gap_is_bridged_by_every_estimator(recording: Recording, gone: list[int]) -> None:
    """Marked, and as the stream does, to rounding."""
    gap = without(recording, gone)
    found = compare(scenario_of(), KINDS, data=gap)
    names = [(c["name"], c["estimator"]) for c in found.summary["cautions"]]
    assert ("input gap", None) in names
    rows = found.summary["estimators"]
    assert all(row["status"] == "ok" for row in rows.values())
    assert rows["batch"]["anees"] < 1.5
    assert rows["incremental_smoothed"]["distance"] < 0.05
    assert rows["fixed_lag"]["distance"] < 0.05
    problem = found.problems[0]
    assert [t for t, _ in problem.bridged["gyro"]] == [10.0 * (k + 1) for k in gone]
    assert sum(length for _, length in problem.bridged["gyro"]) == 10.0 * len(gone)
    lines = lines_of_gap(gone)
    out = feed(session_of(scenario_of(), lines[0], "ekf"), lines)
    assert [line["t"] for line in out] == problem.times.tolist()
    ekf = attitude(found.track("ekf"))
    for k, line in enumerate(out):
        got = line["estimate"]["chaser_attitude"]["sigma"]
        np.testing.assert_allclose(got, ekf[k], rtol=1e-9)
    marked = [line["t"] for line in out if "gap" in str(line["rejected"])]
    assert marked == [10.0 * (k + 1) for k in gone]
    assert all(line["status"] != "OK" for line in out if line["t"] in marked)


def test_row_45_the_covariance_grows_by_what_is_said(recording: Recording) -> None:
    """(spread x length)^2, of a gap as a whole, however many epochs lie in it."""
    for settings, spread in (((), SPREAD), (('gaps.gyro.spread="1 deg/s"',), 10 * SPREAD)):
        scenario = scenario_of(*settings)
        blind = replace(recording, measurements=recording.measurements[:1])
        for gone in ([5], [5, 6], [5, 6, 7]):
            variance = []
            for one in (blind, without(blind, gone)):
                problem = scenario.problem(one, SEED)
                x, P = problem.prior.x, problem.prior.P
                assembly = Assembly(problem.layout, problem.processes, {}, [])
                for before, epoch in zip(problem.epochs[:8], problem.epochs[1:9], strict=True):
                    ahead = replace(epoch, measurements=())
                    x, P = assembly.again(ahead, before.t).predict(x, P)
                rows = problem.layout.tangent("chaser_attitude")
                variance.append(np.diag(P[rows, rows]))
            added = (spread * 10 * len(gone)) ** 2
            np.testing.assert_allclose(variance[1] - variance[0], added, rtol=2e-2)


def test_row_45_a_gap_of_zero_spread_is_the_mean_held(recording: Recording) -> None:
    scenario = scenario_of("gaps.gyro.spread=0")
    g = recording.inputs["gyro"]
    values = g.values.copy()
    values[9] = values[8]
    held = replace(recording, inputs={"gyro": replace(g, values=values)})
    a = compare(scenario, ["batch"], data=without(recording, [9])).track("batch")
    b = compare(scenario, ["batch"], data=held).track("batch")
    np.testing.assert_allclose(a.x, b.x, rtol=1e-12)


@pytest.mark.parametrize("gone", [[0, 1, 2, 3], [8, 9, 10, 11], [15, 16, 17, 18]])
def test_row_45_a_gap_beyond_what_is_bridged(recording: Recording, gone: list[int]) -> None:
    gap = without(recording, gone)
    with pytest.raises(InputError, match=r"input 'gyro' .*\[gaps\] gyro\.bridge"):
        compare(scenario_of(), ["batch"], data=gap)
    wide = compare(scenario_of('gaps.gyro.bridge="40 s"'), ["batch"], data=gap)
    assert wide.summary["estimators"]["batch"]["status"] == "ok"
    lines = lines_of_gap(gone)
    out = feed(session_of(scenario_of(), lines[0], "ekf"), lines)
    assert any(line["status"] == "LOST" and "[gaps] gyro.bridge" in line["message"] for line in out)
    out = feed(session_of(scenario_of('gaps.gyro.bridge="40 s"'), lines[0], "ekf"), lines)
    assert len([line for line in out if line["estimate"]]) == EPOCHS


def test_row_45_the_error_names_file_and_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data"
    relnav(capsys, "simulate", ZHANG, "--set", f"time.epochs={EPOCHS}", "-o", data)
    (data / "dataset.toml").unlink()
    rows = (data / "gyro.csv").read_text().splitlines()
    (data / "gyro.csv").write_text("\n".join(rows[:6] + rows[7:]) + "\n")
    code, text, _ = relnav(capsys, "validate", data)
    assert code == 0
    assert "caution: input gap: input 'gyro' has no samples for 10 s" in text
    (data / "gyro.csv").write_text("\n".join(rows[:6] + rows[10:]) + "\n")
    code, _, err = relnav(capsys, "validate", data)
    assert code == 2
    assert f"{data / 'gyro.csv'}, line 6: input 'gyro' has a gap of 40 s, from 50.0 s" in err
    (data / "gyro.csv").write_text("\n".join(rows[:6]) + "\n")
    assert f"{data / 'gyro.csv'}, line 6: " in relnav(capsys, "validate", data)[2]


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ('gaps.gyro.bridge="-1 s"', r"gaps\.gyro\.bridge: .*non-negative"),
        ('gaps.gyro.spread="1 m"', r"gaps\.gyro\.spread: found unit 'm'"),
        ("gaps.gyro.spread=-1", r"gaps\.gyro\.spread: found -1"),
        ("gaps.gyro.spread=[1, 2]", r"gaps\.gyro\.spread: found 2 numbers"),
        ("gaps.gyros.spread=1", r"gaps\.gyros: unknown input; those of the processes: gyro"),
        ("gaps.gyro.length=1", r"gaps\.gyro\.length: "),
    ],
)
def test_row_45_a_policy_that_cannot_be(setting: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        scenario_of(setting)


def test_row_45_two_inputs_of_one_process(recording: Recording) -> None:
    """Edges of the one cut the gap of the other: its parts add up to the variance of the whole."""
    bridge = Bridge(100.0, np.array([0.1]))
    edges = np.arange(0.0, 11.0)
    gyro = InputSeries("a", edges[[0, 8]], edges[[2, 10]], np.ones((2, 1)), bridge)
    fine = np.arange(0.0, 10.5, 0.5)
    other = InputSeries("b", fine[:-1], fine[1:], np.zeros((20, 1)), bridge)

    class Both:
        kind = "both"
        inputs = {"a": ("a_1",), "b": ("b_1",)}

        def condense(self, u: Array) -> Array:
            return u

    both: Any = Both()
    u = process_inputs(both, {"a": gyro, "b": other}, 0.0, 10.0)
    assert u.shape == (20, 5)
    assert u[:, 0].sum() == 10.0
    held = (fine[:-1] >= 2) & (fine[1:] <= 8)
    np.testing.assert_array_equal(u[:, 3] > 0, held)
    assert not u[:, 4].any()
    assert ((u[:, 0] * u[:, 3]) ** 2).sum() == pytest.approx((0.1 * 6) ** 2, rel=1e-12)
    before, after = split(u, 5.25, 2)
    parts = np.concatenate([before, after])
    assert ((parts[:, 0] * parts[:, 3]) ** 2).sum() == pytest.approx((0.1 * 6) ** 2, rel=1e-12)


def test_row_45_late_in_a_gap_is_as_in_order(recording: Recording) -> None:
    """A measurement that comes late and cuts a bridged interval: to the variance of the whole."""
    lines = lines_of_gap([9])
    at = next(k for k, s in enumerate(lines) if json.loads(s).get("t") == 120.0)
    middle = changed(lines[at], t=95.0, t_arrival=125.0)
    scenario = scenario_of("sensors.beacons.gate=0.999")
    out = feed(session_of(scenario, lines[0], "ekf"), [*lines[: at + 1], middle, *lines[at + 1 :]])
    assert out[-1]["t"] == 190.0
    assert out[-1]["estimate"] is not None


# --- 49 ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "factor"), [("deg/s", 180 / np.pi), ("deg/h", 648000 / np.pi)])
def test_row_49_an_input_in_another_unit(unit: str, factor: float) -> None:
    recording = scenario_of('truth.chaser_rate=["0 deg/s", "0.02 deg/s", "0.1133 deg/s"]').simulate(
        1
    )
    g = recording.inputs["gyro"]
    wrong = replace(recording, inputs={"gyro": replace(g, values=factor * g.values)})
    with pytest.raises(InputError, match=rf"input 'gyro': {unit} given for rad/s\?"):
        scenario_of().problem(wrong, SEED)


def test_row_49_online_too(recording: Recording) -> None:
    """Refused as long as measurements do not fit; the newest estimate stays what it was."""
    lines = []
    for line in lines_of(scenario_of(), SEED):
        raw = json.loads(line)
        values = [180 / np.pi * v for v in raw["values"]] if "values" in raw else None
        lines.append(changed(line, values=values))
    session = session_of(scenario_of(), lines[0], "ekf")
    out = feed(session, lines)
    assert out[0]["status"] == "OK"
    assert "deg/s given for rad/s?" in out[1]["message"]
    assert all(line["status"] != "OK" for line in out[1:])
    assert session.online.t == 0.0


def test_row_49_a_right_unit_is_left_alone(recording: Recording) -> None:
    """Also where what is measured next is an outlier."""
    scenario_of().problem(recording, SEED)
    second = recording.measurements[1]
    z = -second.z
    far = (recording.measurements[0], replace(second, z=z), *recording.measurements[2:])
    scenario_of().problem(replace(recording, measurements=far), SEED)


# --- 12 ----------------------------------------------------------------------------------


def test_row_12_epochs_are_what_is_within_the_first_of_them() -> None:
    stamps = np.array([0.0, 0.9, 1.5, 2.4, 3.0, 3.0]) * 1e-3
    np.testing.assert_array_equal(epoch_times(stamps, 1e-3), [0.0, 1.5e-3, 3e-3])
    np.testing.assert_array_equal(epoch_times(stamps), np.unique(stamps))
    np.testing.assert_array_equal(epoch_times(np.array([0.0, 0.0, 1e-9]), 0.0), [0.0, 1e-9])
    assert not len(epoch_times(np.zeros(0), 1e-3))


def halves(recording: Recording, apart: float) -> tuple[Measurement, ...]:
    """Half of the beacons are seen a little later than the others."""
    out = []
    for m in recording.measurements:
        out.append(replace(m, z=m.z[:3], ids=m.ids[:3]))
        out.append(replace(m, t=m.t + apart, z=m.z[3:], ids=m.ids[3:]))
    return tuple(out)


@pytest.mark.parametrize(("merge", "apart"), [("1 ms", 5e-4), ("1 ms", 1e-3), ("10 ms", 3e-3)])
def test_row_12_merge_makes_one_epoch_of_stamps(
    recording: Recording, merge: str, apart: float
) -> None:
    """The estimate of equal stamps, offline and online; also where the later half comes late."""
    scenario = scenario_of(f'time.merge="{merge}"')
    two = halves(recording, apart)
    times = np.sort([m.t for m in two])
    found = compare(scenario, KINDS, data=replace(recording, measurements=two, times=times))
    equal = compare(
        scenario_of(), KINDS, data=replace(recording, measurements=halves(recording, 0.0))
    )
    assert found.summary["epochs"] == EPOCHS
    for a, b in zip(found.tracks, equal.tracks, strict=True):
        np.testing.assert_array_equal(a.x, b.x)
    lines = lines_of(scenario_of(), SEED)
    inputs = [changed(line) for line in lines[1:] if "input" in json.loads(line)]
    own = [
        json.dumps({"sensor": m.sensor, "t": m.t, "id": m.ids.tolist(), "z": m.z.tolist()})
        for m in two
    ]
    for order in (own, [*own[0::2], *own[1::2]]):
        session = session_of(scenario, lines[0], "ekf")
        out = feed(session, [lines[0], *inputs, *order])
        last = out[-1]["estimate"]["relative_position"]["value"]
        expected = equal.track("ekf").value("relative_position")[-1]
        assert session.online.t == 10.0 * (EPOCHS - 1)
        if order is own:
            np.testing.assert_allclose(last, expected, rtol=1e-12)


def test_row_12_merge_of_zero_means_equal_stamps_only(recording: Recording) -> None:
    scenario = scenario_of("time.merge=0")
    two = halves(recording, 1e-9)
    times = np.sort([m.t for m in two])
    problem = scenario.problem(replace(recording, measurements=two, times=times), SEED)
    assert len(problem.epochs) == 2 * len({m.t for m in recording.measurements}) == 2 * EPOCHS
    same = halves(recording, 0.0)
    problem = scenario.problem(replace(recording, measurements=same), SEED)
    assert len(problem.epochs) == EPOCHS
