"""Folders with a scenario that names one reader: files of others, read as they came."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from passes import ZHANG, relnav

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.io.dataset import write_dataset
from relnav_graph.io.results import read_results
from relnav_graph.runs.passes import open_dataset, open_pass

T: Array = np.arange(20.0)
TRUE = np.column_stack([20 + 0.5 * T, -3 + 0 * T, 0.25 * T])
SEEN = TRUE + 0.1 * np.random.default_rng(0).normal(size=TRUE.shape)
#: In km, on a clock that began at 100 s, in columns of other names.
COLUMNS = {"columns": ["north", "east", "down"], "unit": "km"}
MAPPING = {"time": {"column": "stamp", "unit": "s", "clock": "none"}, "sensors": {"fix": COLUMNS}}
SCENARIO: dict[str, Any] = {
    "title": "fixes of a log",
    "processes": {"motion": {"kind": "white_noise_acceleration", "acceleration_density": 1e-3}},
    "sensors": {"fix": {"kind": "position_fix", "sigma": 0.1}},
    "prior": {
        "relative_position": {"sigma": 50.0, "mean": [0.0, 0.0, 0.0]},
        "relative_velocity": {"sigma": 5.0, "mean": [0.0, 0.0, 0.0]},
    },
}


def smoothed(capsys: pytest.CaptureFixture[str], *arguments: object) -> Array:
    """Positions (N, 3), m, that a command writes into the folder that it names last."""
    code, _, said = relnav(capsys, *arguments)
    assert code == 0, said
    (track,), _, _ = read_results(Path(str(arguments[-1])) / "results.nc")
    return track.value("relative_position")


def test_a_folder_is_smoothed_by_the_reader_that_its_scenario_names(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """As by compare with the same scenario elsewhere, and as from the data set it converts to."""
    raw, own = tmp_path / "raw", tmp_path / "own"
    table = {"data": {"reader": "table", "options": MAPPING}}
    for folder in (raw, own):
        folder.mkdir()
        rows = np.column_stack([100 + T, SEEN / 1e3])
        head = "stamp,north,east,down"
        np.savetxt(folder / "log.csv", rows, "%.17g", ",", header=head, comments="")
    for path in (own / "scenario.toml", tmp_path / "mine.toml"):
        path.write_text(tomli_w.dumps(SCENARIO | table))
    found = smoothed(capsys, "smooth", own, "-o", tmp_path / "a")
    np.testing.assert_allclose(found, TRUE, atol=0.3)
    mine = ("compare", tmp_path / "mine.toml", "-e", "batch", "--data")
    np.testing.assert_array_equal(smoothed(capsys, *mine, raw, "-o", tmp_path / "b"), found)
    np.testing.assert_array_equal(smoothed(capsys, *mine, own, "-o", tmp_path / "c"), found)
    assert relnav(capsys, "convert", own, tmp_path / "set")[0] == 0
    again = smoothed(capsys, "smooth", tmp_path / "set", "-o", tmp_path / "d")
    np.testing.assert_allclose(again, found, atol=1e-9)


def test_sensors_to_simulate_are_drawn_where_the_truth_alone_is_there(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data = {"reader": "tables", "simulate": ["fix"]}
    (tmp_path / "scenario.toml").write_text(tomli_w.dumps(SCENARIO | {"data": data}))
    for name, values, axes in (
        ("position", TRUE, "x_m,y_m,z_m"),
        ("velocity", np.gradient(TRUE, axis=0), "x_m_s,y_m_s,z_m_s"),
    ):
        path, head = tmp_path / f"truth_relative_{name}.csv", f"t_s,{axes}"
        rows = np.column_stack([T, values])
        np.savetxt(path, rows, "%.17g", ",", header=head, comments="")
    found = smoothed(capsys, "smooth", tmp_path, "-o", tmp_path / "out")
    error = np.abs(found - TRUE)
    assert 0 < error.max() < 0.3


@pytest.mark.parametrize("told", [False, True])
def test_stamps_in_unix_time_do_not_say_that_axes_are_inertial(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    told: bool,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """They tell when t = 0 is; a scenario that says it itself is taken at its word."""
    rows = np.column_stack([(0 if told else 1.75e9) + T, SEEN / 1e3])
    head = "stamp,north,east,down"
    np.savetxt(tmp_path / "log.csv", rows, "%.17g", ",", header=head, comments="")
    stamps = {"column": "stamp", "unit": "s", "clock": "none" if told else "unix"}
    table = {"data": {"reader": "table", "options": MAPPING | {"time": stamps}}}
    table |= {"time": {"epoch": "2025-06-15T15:00:00 UTC"}} if told else {}
    (tmp_path / "scenario.toml").write_text(tomli_w.dumps(SCENARIO | table))
    smoothed(capsys, "smooth", tmp_path, "-o", tmp_path / "out")
    out = tmp_path / "own.oem"
    code, _, said = relnav(
        capsys, "convert", tmp_path / "out", out, "--track", "batch", "--option", "of=relative"
    )
    assert code == 0, said
    assert "START_TIME = 2025-06-15T15:" in out.read_text()
    assert ("are not known to be inertial" in caplog.text) == (not told)


OPTIONS = {"unit": "km", "columns": ["north", "east", "down"]}
#: Options of a reader, and what is said of them before there is any file.
WRONG: dict[str, tuple[str, dict[str, Any], str]] = {
    "unit": ("table", {"sensors": {"fix": OPTIONS | {"unit": "kms"}}}, "fix.unit: unit 'kms'"),
    "other unit": ("table", {"sensors": {"fix": OPTIONS | {"unit": "s"}}}, "one like 'm'"),
    "sensor": ("table", {"sensors": {"fox": OPTIONS}}, "fox: found 'fox', expected a sensor, one"),
    "input": ("table", {"inputs": {"gyro": OPTIONS}}, "gyro: found 'gyro', expected an input, one"),
    "clock": ("table", {"time": {"column": "t", "unit": "s"}}, "time: found neither of clock"),
    "measured": (
        "tum",
        {"measured": "fox"},
        "measured: found 'fox', expected a sensor, one",
    ),
    "by quantity": ("tum", {"measured": {"position": "fox"}}, "measured.position: found 'fox'"),
    "imu": ("euroc", {"inputs": {"rate": "gyro"}}, "inputs.rate: found 'gyro', expected an input"),
    "topic": ("ros", {"topics": {"/a": {"measured": "fox"}}}, "/a.measured: found 'fox', expected"),
}


@pytest.mark.parametrize("name", WRONG)
def test_options_are_looked_at_before_there_are_files(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str
) -> None:
    reader, options, says = WRONG[name]
    options = MAPPING | options if reader == "table" else options
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(SCENARIO | {"data": {"reader": reader, "options": options}}))
    code, _, said = relnav(capsys, "validate", path)
    assert code == 2
    assert "data: data.options." in said
    assert says in said


def test_truth_that_scores_nothing_is_named_before_there_are_files(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    truth = {"relative_positon": OPTIONS, "relative_velocity": OPTIONS | {"unit": "km/s"}}
    data = {"reader": "table", "options": MAPPING | {"truth": truth}}
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(SCENARIO | {"data": data}))
    assert relnav(capsys, "validate", path)[0] == 0
    assert "has no 'relative_positon' (is 'relative_position' meant?)" in caplog.text
    assert "'relative_velocity'" not in caplog.text


def test_a_recorded_pass_is_cut(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Raw data alike: what is from begin until before end, at the times that it has."""
    rows = np.column_stack([100 + T, SEEN / 1e3])
    head = "stamp,north,east,down"
    np.savetxt(tmp_path / "log.csv", rows, "%.17g", ",", header=head, comments="")
    data = {"data": {"reader": "table", "options": MAPPING}}
    (tmp_path / "scenario.toml").write_text(tomli_w.dumps(SCENARIO | data))
    part = open_dataset(tmp_path, ("data.begin=105 s", "data.end=110")).recording
    assert part.times.tolist() == [105, 106, 107, 108, 109]
    assert [m.t for m in part.measurements] == part.times.tolist()
    with pytest.raises(InputError, match=r"data: found no epoch .* are from 100.0 to 119.0 s"):
        open_dataset(tmp_path, ("data.begin=120",))
    for setting, says in (
        ("data.end=100 m", "data.end: found unit 'm', expected one like 's'"),
        ("data={reader='table', begin=3, end=2}", "data: found begin at 3.0 s and end at 2.0 s"),
        ("time.epochs=5", "recorded data, which have their own (data.end cuts them short)"),
    ):
        code, _, said = relnav(capsys, "smooth", tmp_path, "-o", tmp_path / "o", "--set", setting)
        assert code == 2
        assert says in said


def test_a_data_set_is_cut_with_its_truth_and_inputs(tmp_path: Path) -> None:
    """A filter of the first part says what it says of the whole; NEES has the truth of that."""
    whole = open_pass(ZHANG, 1, None, ("time.epochs=40",))
    s, blocks = whole.scenario, {b.name: b for b in whole.scenario.layout}
    columns = s.input_columns
    write_dataset(tmp_path, s.raw, whole.recording, s.sensors, columns, blocks, "csv", 0.0)
    full, cut = open_dataset(tmp_path), open_dataset(tmp_path, ("data.end=105",))
    long, short = (run_estimator("ekf", one.problem) for one in (full, cut))
    assert short.t.tolist() == [t for t in long.t.tolist() if t < 105]
    assert 2 < len(short.t) < 40
    np.testing.assert_array_equal(short.x, long.x[: len(short.t)])
    truth = cut.recording.truth
    assert truth is not None
    assert truth.t.tolist() == short.t.tolist()
    assert {len(v) for v in truth.values.values()} == {len(short.t)}
    late = open_dataset(tmp_path, ("data.begin=105",))
    assert late.problem.times[0] == long.t[len(short.t)]
    assert cut.scenario.layout == full.scenario.layout
