"""Rows 38, 43, 46 and 48: clocks and their origin, stamps in another unit, estimators apart."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import ZHANG, relnav
from streams import feed, lines_of, session_of

from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import InputSeries
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion
from relnav_graph.runs.comparison import Comparison, compare
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

UNIX = 1_700_000_000.0
KINDS = ("batch", "ekf")
SHORT = ("time.epochs=12", "seed=3")


def short(*settings: str) -> Scenario:
    return load_scenario(ZHANG, [*SHORT, *settings])


@pytest.fixture(scope="module", name="recording")
def recording_() -> Recording:
    return short().simulate(3)


@pytest.fixture(scope="module", name="near")
def near_(recording: Recording) -> Comparison:
    return compare(short(), KINDS, data=recording)


def apart(found: Comparison, other: Comparison) -> float:
    """Largest difference of any component at any epoch, in sigmas of the second."""
    largest = 0.0
    for a, b in zip(found.tracks, other.tracks, strict=True):
        sigma = np.sqrt(np.diagonal(b.P, axis1=1, axis2=2))
        largest = max(largest, float(np.abs(b.layout.local(b.x, a.x) / sigma).max()))
    return largest


def cautions(found: Comparison) -> list[tuple[str, str | None]]:
    return [(c["name"], c["estimator"]) for c in found.summary["cautions"]]


# --- 38 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("far", [UNIX, 1.4e9, -8.5e8, 3e5])
def test_row_38_stamps_far_from_the_epoch_and_the_right_anomaly(
    recording: Recording, near: Comparison, far: float
) -> None:
    """The epoch says when it holds; or, at another time, the anomaly is that of then."""
    found = compare(short(f"orbit.epoch={far}"), KINDS, data=recording.shifted(far))
    assert apart(found, near) < 1e-3
    assert "orbit epoch" not in dict(cautions(found))
    later = chief_motion(KeplerOrbit(7.2e6, 0.05).array(), 2000.0)[2]
    settings = f"orbit.epoch={far + 2000.0}", f"orbit.true_anomaly={later}"
    assert apart(compare(short(*settings), KINDS, data=recording.shifted(far)), near) < 1e-3


@pytest.mark.parametrize("far", [UNIX, -UNIX, 7e4])
def test_row_38_the_wrong_anomaly_is_a_caution(recording: Recording, far: float) -> None:
    found = compare(short(), KINDS, data=recording.shifted(far))
    assert ("orbit epoch", None) in cautions(found)
    assert found.problems[0].cautions[0].name == "orbit epoch"


def test_row_38_a_pass_about_the_epoch_has_no_caution(recording: Recording) -> None:
    """Nor one of a hyperbola that begins an hour from it."""
    assert short().cautions == ()
    for far in (5e4, -5e4):
        assert short().problem(recording.shifted(far), 3).cautions == ()
    flyby = KeplerOrbit(-3.3e6, 3.0)
    assert abs(flyby.revolutions(3600.0)) < 10 < abs(flyby.revolutions(UNIX))


def test_row_38_the_truth_has_the_epoch_too() -> None:
    """Simulated about another place of the same orbit: the same motion, and consistent."""
    period = 2 * np.pi * np.sqrt(7.2e6**3 / KeplerOrbit(7.2e6).mu)
    late = chief_motion(KeplerOrbit(7.2e6, 0.05).array(), 1000.0)[2]
    here = short(f"orbit.true_anomaly={late}").simulate(3).truth
    for epoch in (-1000.0, -1000.0 - 3 * period, 4 * period - 1000.0):
        there = short(f"orbit.epoch={epoch}").simulate(3).truth
        assert here is not None
        assert there is not None
        for name, value in here.values.items():
            np.testing.assert_allclose(there.values[name], value, rtol=0, atol=1e-6)


def test_row_38_an_origin_is_taken_off_and_put_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In data sets and streams; named in validate, table, report and on each line without it."""
    data, out, origin = tmp_path / "data", tmp_path / "out", f"time.origin={UNIX:.0f}"
    options = [part for text in (*SHORT, origin) for part in ("--set", text)]
    assert relnav(capsys, "simulate", ZHANG, *options, "-o", data)[0] == 0
    assert (data / "beacons.csv").read_text().splitlines()[1].startswith(f"{UNIX}")
    code, text, _ = relnav(capsys, "smooth", data, "-e", "batch", "-o", out, "--json")
    right = json.loads(text)
    assert (code, right["cautions"]) == (0, [])
    plain = compare(short(), ["batch"], seed=3).summary["estimators"]["batch"]
    assert right["estimators"]["batch"]["anees"] == pytest.approx(plain["anees"], rel=1e-6)
    wrong = "--set", "time.origin=0"
    assert "caution: orbit epoch: " in relnav(capsys, "validate", data, *wrong)[1]
    code, text, _ = relnav(capsys, "smooth", data, "-e", "batch", "-o", out, *wrong)
    assert "caution: the pass: orbit epoch: " in text
    assert relnav(capsys, "report", out)[0] == 0
    assert "orbit epoch" in (out / "report.html").read_text("utf-8")


def test_row_38_the_lines_of_a_stream(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    origin = f"time.origin={UNIX:.0f}"
    options = [part for text in (*SHORT, origin) for part in ("--set", text)]
    _, text, _ = relnav(capsys, "simulate", ZHANG, *options, "-o", "-")
    assert json.loads(text.splitlines()[0])["t"] == UNIX
    (tmp_path / "lines").write_text(text, "utf-8")

    def stream(*settings: str) -> list[dict[str, Any]]:
        given = [part for s in (*SHORT, *settings) for part in ("--set", s)]
        where = "-e", "ekf", "--from", tmp_path / "lines", "-o", tmp_path / "out"
        relnav(capsys, "stream", ZHANG, *given, *where)
        return [json.loads(line) for line in (tmp_path / "out").read_text().splitlines()]

    plain = short()
    expected = feed(session_of(plain, (lines := lines_of(plain, 3))[0], "ekf"), lines)
    for settings, start in (((origin,), 0.0), ((f"orbit.epoch={UNIX:.0f}",), UNIX)):
        found = stream(*settings)
        assert [line["t"] - start for line in found] == [line["t"] for line in expected]
        assert not any("cautions" in line for line in found)
        for a, b in zip(found, expected, strict=True):
            for name, state in b["estimate"].items():
                np.testing.assert_allclose(
                    a["estimate"][name]["value"], state["value"], rtol=1e-6, atol=1e-9
                )
    doubtful = stream()
    assert all(line["cautions"][0]["name"] == "orbit epoch" for line in doubtful)


def test_row_38_recorded_data_need_no_step(tmp_path: Path) -> None:
    """`origin` and `merge` stand alone; what is simulated needs both step and epochs."""
    text = ZHANG.read_text("utf-8")
    start, end = text.index("[time]"), text.index("[orbit]")
    path = tmp_path / "zhang.toml"
    path.write_text(text[:start] + "[time]\norigin = 1e9\n\n" + text[end:], "utf-8")
    scenario = load_scenario(path)
    assert scenario.file.time.origin == 1e9
    with pytest.raises(InputError, match=r"no \[truth\] and \[time\] to simulate from"):
        scenario.simulate(0)
    with pytest.raises(InputError, match="found one of step and epochs"):
        load_scenario(path, ["time.step=1.0"])


# --- 43 ----------------------------------------------------------------------------------


def test_row_43_estimators_apart_are_a_caution() -> None:
    """The filter of a tumbling target, linearised where it stood; status and kind as before."""
    found = compare(
        load_scenario(ZHANG, ["time.epochs=30", "seed=7"]), ["ekf", "batch", "incremental"]
    )
    rows = found.summary["estimators"]
    batch, ekf = found.track("batch"), found.track("ekf")
    sigma = np.sqrt(np.diag(batch.P[-1]))
    by_hand = np.abs(batch.layout.local(batch.x[-1], ekf.x[-1]) / sigma).max()
    assert rows["ekf"]["distance"] == pytest.approx(by_hand, rel=1e-12)
    assert by_hand > 3
    assert rows["ekf"]["status"] == "ok"
    assert rows["batch"]["distance"] == 0.0
    assert rows["incremental"]["distance"] < 0.5
    assert rows["incremental_smoothed"]["distance"] < 0.1
    assert cautions(found) == [("distance", "ekf")]
    assert [c["name"] for c in rows["ekf"]["cautions"]] == ["distance"]


def test_row_43_without_batch_rts_is_the_reference_and_without_both_there_is_none() -> None:
    rows = compare(short(), ["iekf", "rts"], seed=3).summary["estimators"]
    assert rows["rts"]["distance"] == 0.0
    assert rows["iekf"]["distance"] is not None
    alone = compare(short(), ["iekf"], seed=3).summary
    assert alone["estimators"]["iekf"]["distance"] is None
    assert alone["cautions"] == []


# --- 46 ----------------------------------------------------------------------------------


def stamps_times(recording: Recording, factor: float) -> Recording:
    measurements = tuple(replace(m, t=factor * m.t) for m in recording.measurements)
    inputs = {
        n: replace(s, t_start=factor * s.t_start, t_end=factor * s.t_end)
        for n, s in recording.inputs.items()
    }
    times = factor * recording.times
    return replace(recording, times=times, measurements=measurements, inputs=inputs, truth=None)


#: All means, where there is no truth to draw them about.
MEANS = [
    f"prior.{name}.mean={mean}"
    for name, mean in {
        "relative_position": [200, 200, 100],
        "relative_velocity": [0, 0, 0],
        "chaser_attitude": [0.35, -0.17, 0.09],
        "gyro_bias": [0, 0, 0],
        "target_attitude": [0.17, -0.35, 0.52],
    }.items()
]


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_row_46_stamps_in_another_unit_are_refused(
    recording: Recording, unit: str, factor: float
) -> None:
    with pytest.raises(InputError, match=rf"are the stamps in {unit}\?"):
        short(*MEANS).problem(stamps_times(recording, factor), 3)


@pytest.mark.parametrize(("unit", "factor"), [("us", 1e6), ("ns", 1e9)])
def test_row_46_also_where_no_step_is_known(recording: Recording, unit: str, factor: float) -> None:
    scenario = short(*MEANS)
    time = scenario.file.time.model_copy(update={"step": None, "epochs": None})
    blind = replace(scenario, file=scenario.file.model_copy(update={"time": time}))
    with pytest.raises(InputError, match=rf"interval of .* are the stamps in {unit}\?"):
        blind.problem(stamps_times(recording, factor), 3)
    doubtful = blind.problem(stamps_times(recording, 1e3), 3)
    assert [c.name for c in doubtful.cautions] == ["intervals"]


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("time.step=1e10", r"time: found step 1e\+10 s.* are the numbers in ns\?"),
        ('processes.target.max_step="1e-300 s"', r"max_step = 1e-300 s .* at most 100000 steps"),
        ('processes.target.max_step="1e-9 s"', r"max_step = 1e-09 s .* at most 100000 steps"),
    ],
)
def test_row_46_steps_that_none_can_make(setting: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        compare(short(setting), ["batch"], seed=3)


# --- 48 ----------------------------------------------------------------------------------


def test_row_48_a_prior_may_be_a_quaternion_with_five_decimals() -> None:
    """Normalised within 1e-3, as sensors do; else refused with its path."""
    mean = [0.96593, 0.0, 0.25882, 0.0]
    scenario = short(f"prior.target_attitude.mean={mean}")
    prior = scenario.prior(scenario.simulate(3).truth, 0.0, 3)
    R = scenario.layout.value(prior.x, "target_attitude")
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    turned = np.arccos((np.trace(R) - 1) / 2)
    assert turned == pytest.approx(np.radians(30.0), abs=1e-4)
    with pytest.raises(InputError, match=r"prior\.target_attitude\.mean: found .* unit quaternion"):
        short("prior.target_attitude.mean=[0.9, 0.0, 0.25882, 0.0]")


@pytest.mark.parametrize(
    ("gyro", "camera", "says"),
    [
        (1000.0, 1.0, "are the stamps of the input in ms"),
        (1.0, 1000.0, "are those of the measurements in ms"),
        (1.0, 1.0, ""),
        (60.0, 1.0, ""),  # a table that is held, and goes on far beyond the pass
    ],
)
def test_row_38_stamps_of_two_units_are_told_by_their_lengths(
    gyro: float, camera: float, says: str
) -> None:
    """Samples that are a thousand times further apart than they can be cover every epoch."""
    processes = short().processes
    (name,) = {n for p in processes.values() for n in p.inputs}
    edges = gyro * np.arange(0.0, 20.05, 0.1)
    series = InputSeries(name, edges[:-1], edges[1:], np.zeros((len(edges) - 1, 3)))
    times = camera * np.arange(0.0, 20.0, 0.5)
    if says:
        with pytest.raises(InputError, match=f"input 'gyro': .*apart over .*: {says}"):
            make_epochs(processes, [], {name: series}, times)
    else:
        assert len(make_epochs(processes, [], {name: series}, times)) == 40


@pytest.mark.parametrize("begin", [0.0, 1000.0])
def test_row_38_a_pass_may_be_a_short_part_of_a_long_input(begin: float) -> None:
    """An hour of a gyro at 1 Hz beside some seconds of a camera at 10 Hz: in ms, it would have
    ended before they begin; only where both begin with zero none can tell."""
    processes = short().processes
    (name,) = {n for p in processes.values() for n in p.inputs}
    edges = np.arange(0.0, 3601.0)
    series = InputSeries(name, edges[:-1], edges[1:], np.zeros((len(edges) - 1, 3)))
    times = np.linspace(begin, begin + 8, 80)
    if begin:
        assert len(make_epochs(processes, [], {name: series}, times)) == 80
    else:
        with pytest.raises(InputError, match="If not, leave out what is not of this pass"):
            make_epochs(processes, [], {name: series}, times)
