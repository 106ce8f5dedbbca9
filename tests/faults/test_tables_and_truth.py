"""Rows 34, 42, 48 and 52: tables of a data set that are none, truth beside the epochs, and what
data may not ask for: modules, and files outside their folder."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import ZHANG, relnav

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import RELATIVE_POSITION, TARGET_ATTITUDE
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.readers import read_raw
from relnav_graph.io.tabular import read_table
from relnav_graph.io.truth import between
from relnav_graph.runs.passes import open_dataset, open_pass
from relnav_graph.scenario.build import load_scenario

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of 40 epochs, 10 s apart."""
    from relnav_graph.cli.main import main

    folder = tmp_path_factory.mktemp("data") / "pass"
    with pytest.raises(SystemExit) as stop:
        main(["simulate", str(ZHANG), "--set", "time.epochs=40", "-o", str(folder)])
    assert not stop.value.code
    return folder


@pytest.fixture
def data(simulated: Path, tmp_path: Path) -> Path:
    """A copy of it that one may change."""
    shutil.copytree(simulated, tmp_path / "pass")
    (tmp_path / "pass" / "dataset.toml").unlink()
    return tmp_path / "pass"


TABLES = {
    b"": "line 1: found nothing, expected names of columns",
    b"t_s;a\n0;1\n": "line 1: found names separated by semicolons, expected commas",
    b"t_s\ta\n0\t1\n": "line 1: found names separated by tabs, expected commas",
    b"0.0,1.5\n1.0,2.5\n": "line 1: found numbers, 0.0, 1.5; expected the names of columns",
    b"t_s,a\n0,5,1,5\n": "line 2: found 4 of 2 columns; are there commas in the numbers?",
    b't_s,a\n0,1\n1,"0,5"\n': "line 3, column a: found '0,5', expected a number, with a point",
    b"t_s,a,a\n0,1,2\n": "line 1: found 'a' 2 times, expected names, once each",
    b"t_s,\n0,1\n": "line 1: found a column without a name",
    b"t_s,a\n0,1\nnan,2\n": "line 3, column t_s: found nan, expected a finite number",
    b"t_s,a\n0," + b"7" * 5000 + b"\n": "line 2, column a: found inf, expected a finite number",
    b"t_s,a\n0," + b"x" * 200_000: "line 2: field larger than field limit",
    b"t_s,a\n0,\0\n": r"line 2, column a: found '\x00', expected a number",
    b"t_s,a\n0,1\n1,\xe9\n": "line 3: found the byte 0xe9, expected UTF-8",
    "t_s,a\n0,1\n".encode("utf-16"): "expected UTF-8; it is UTF-16, as some spreadsheets write",
}


def read_all(folder: Path) -> None:
    table = read_table(folder, "range")
    assert table is not None
    table.require(tuple(table.columns))


@pytest.mark.parametrize("content", TABLES, ids=TABLES.values())
def test_row_34_a_table_that_is_none_is_named_with_its_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "range.csv").write_bytes(content)
    with pytest.raises(InputError) as error:
        read_all(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'range.csv'}, line ")
    assert TABLES[content] in str(error.value)
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    "content", [b"\xef\xbb\xbft_s,a\r\n0,1\r\n1,2\r\n", b"t_s,a\r0,1\r1,2\r", b"t_s, a\n\n0,1\n1,2"]
)
def test_row_34_tables_as_other_programs_end_their_lines(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "range.csv").write_bytes(content)
    table = read_table(tmp_path, "range")
    assert table is not None
    np.testing.assert_array_equal(table.stack(("t_s", "a")), [[0, 1], [1, 2]])


def test_row_34_a_parquet_table_with_a_name_twice_or_cut(tmp_path: Path) -> None:
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "range.parquet"
    twice = pyarrow.Table.from_arrays([pyarrow.array([1.0])] * 2, names=["a", "a"])
    parquet.write_table(twice, path)
    with pytest.raises(InputError, match="found 'a' 2 times"):
        read_table(tmp_path, "range")
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(InputError, match=r"range\.parquet: not a readable Parquet table"):
        read_table(tmp_path, "range")


@pytest.mark.parametrize("what", ["pipe", "device", "folder"])
@pytest.mark.parametrize("name", ["beacons.csv", "truth_target_rate.csv", "scenario.toml"])
def test_row_34_a_table_that_never_ends(data: Path, capsys: Capture, what: str, name: str) -> None:
    """A pipe that nobody writes to, a link to a device without end: refused at once."""
    (data / name).unlink()
    if what == "pipe":
        os.mkfifo(data / name)
    elif what == "device":
        (data / name).symlink_to("/dev/zero")
    else:
        (data / name).mkdir()
    code, _, err = relnav(capsys, "smooth", data, "-o", data.parent / "out")
    assert code == 2
    assert f"{data / name}: is a {what}, expected a file" in err


@pytest.mark.parametrize(
    ("reader", "names"),
    [
        ("starry_night", ("a.mat",)),
        ("grace_fo", ("a.orb", "b.orb")),
        ("astrobee_tumble", ("chaser_deltapose.csv", "chaser_imu.csv.gz")),
    ],
)
def test_row_34_a_raw_file_that_never_ends(
    tmp_path: Path, reader: str, names: tuple[str, ...]
) -> None:
    for name in names:
        os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=f"{names[0]}: is a pipe, expected a file"):
        read_raw(reader, tmp_path)


def test_row_34_a_file_that_no_memory_holds(data: Path) -> None:
    os.truncate(data / "beacons.csv", 1 << 40)  # a hole: it takes nothing on the disk
    with pytest.raises(InputError, match=r"beacons\.csv, whose bytes, which take at least .* GiB"):
        open_dataset(data)
    os.truncate(data / "scenario.toml", 1 << 30)
    with pytest.raises(InputError, match=r"scenario\.toml: found 1073741824 bytes, expected at"):
        open_dataset(data)


def test_row_34_samples_that_no_memory_holds() -> None:
    for period in ("1e-9 s", "1e-300 s"):
        with pytest.raises(InputError, match=r"inputs\.gyro\.period: .* 1e-.* samples, .*GiB"):
            load_scenario(ZHANG, [f'inputs.gyro.period = "{period}"'])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("truth_source = ", "truth_source = 3 #", "truth_source: found 3, expected text"),
        ("[sha256]", '[sha256]\n"a.csv" = 3', "a.csv: found 3, expected text"),
        (
            "[sha256]",
            '[sha256]\n"../scenario.toml" = "0"',
            "'../scenario.toml' cannot name a file in it",
        ),
        ("format = 1", "format = []", "found format [], expected 1"),
        ("[sha256]", "[other]", "expected tables [settings] and [sha256]"),
    ],
)
def test_row_34_a_manifest_of_other_types(
    simulated: Path, tmp_path: Path, capsys: Capture, old: str, new: str, says: str
) -> None:
    folder = tmp_path / "pass"
    shutil.copytree(simulated, folder)
    path = folder / "dataset.toml"
    path.write_text(path.read_text("utf-8").replace(old, new, 1), "utf-8")
    code, _, err = relnav(capsys, "validate", folder)
    assert code == 2
    assert str(folder) in err
    assert says in err


# --- row 42 --------------------------------------------------------------------------------


def _moved(data: Path, table: str, shift: float, first: int = 0, every: int = 1) -> None:
    """Rows of a truth table from the `first` on, every so many, their times shifted, s."""
    path = data / f"truth_{table}.csv"
    head, *rows = path.read_text("utf-8").splitlines()
    kept = [row.partition(",") for row in rows[first::every]]
    text = [head, *(f"{float(t) + shift!r},{rest}" for t, _, rest in kept)]
    path.write_text("\n".join(text) + "\n", "utf-8")


def _scores(data: Path, capsys: Capture) -> tuple[dict[str, Any], str]:
    code, out, err = relnav(capsys, "smooth", data, "-o", data.parent / "out", "--json")
    assert code == 0, err
    return json.loads(out)["estimators"]["batch"]["states"], err


def test_row_42_truth_between_its_rows(data: Path, simulated: Path, capsys: Capture) -> None:
    """Every second row is gone: the score is that of all rows, and it is said why."""
    want, quiet = _scores(simulated, capsys)
    assert "truth_" not in quiet
    _moved(data, "relative_position", 0.0, every=2)
    _moved(data, "chaser_attitude", 0.0, every=2)
    found, err = _scores(data, capsys)
    for name in ("relative_position", "chaser_attitude"):
        assert found[name]["rmse"] == pytest.approx(want[name]["rmse"], rel=0.05)
        told = f"truth_{name}.csv: of 40 epochs 19 are between its rows and interpolated"
        assert told in err
        assert "1 are outside or in gaps" in err
    assert found["target_rate"] == want["target_rate"]


def test_row_42_truth_that_matches_no_epoch_is_said(
    data: Path, caplog: pytest.LogCaptureFixture
) -> None:
    _moved(data, "relative_position", 1e6)
    truth = open_dataset(data).recording.truth
    assert truth is not None
    rows, same = truth.at(np.linspace(0.0, 390.0, 40))
    assert same.all()
    assert np.isnan(truth.values["relative_position"][rows]).all()
    assert np.isfinite(truth.values["target_rate"][rows]).all()
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "truth_relative_position.csv: none of its 40 rows, t = 1000000 to 1000390 s," in (
        caplog.text
    )
    assert "is at an epoch or about one, t = 0 to 390 s: it scores nothing" in caplog.text


def test_row_42_nothing_is_made_up_in_a_gap(data: Path) -> None:
    """Six rows are missing in the middle, one before the first and after the last epoch."""
    path = data / "truth_relative_position.csv"
    head, *rows = path.read_text("utf-8").splitlines()
    path.write_text("\n".join([head, *rows[1:15], *rows[21:-1]]) + "\n", "utf-8")
    truth = open_dataset(data).recording.truth
    assert truth is not None
    unknown = np.isnan(truth.values["relative_position"]).any(axis=1)
    assert np.flatnonzero(unknown).tolist() == [0, 15, 16, 17, 18, 19, 20, 39]


@pytest.mark.parametrize(("rows", "order"), [(2, 1), (40, 4)])
def test_row_42_a_turning_attitude_and_a_path(rows: int, order: int) -> None:
    """Two rows: SLERP and a straight line, exact for a steady turn and path. Many: the error
    falls with the fourth power of the step."""
    layout = Layout([TARGET_ATTITUDE, RELATIVE_POSITION])

    def at(t: Array) -> tuple[Array, Array]:
        bend = 0.0 if order == 1 else 0.02
        d = np.column_stack([0.1 * t + bend * t**2, -0.2 * t, np.sin(bend * 5 * t)] * 2)
        x = layout.retract(np.tile(layout.identity, (len(t), 1)), d)
        return layout.value(x, "target_attitude"), layout.value(x, "relative_position")

    missed = []
    for step in (0.4, 0.2):
        t: Array = step * np.arange(rows, dtype=np.float64)
        asked: Array = t[:-1] + 0.37 * step if order == 1 else np.array([3.01, 3.13, 3.27])
        pairs = zip(layout, at(t), at(asked), strict=True)
        parts = [b.local(between(b, t, v, asked), true) for b, v, true in pairs]
        missed.append([float(np.linalg.norm(d, axis=1).max()) for d in parts])
    if order == 1:
        assert np.max(missed) < 1e-12
    else:
        assert np.all(np.array(missed[0]) / np.array(missed[1]) > 2**3.2), missed
        assert np.max(missed[1]) < 1e-4


def test_row_48_truth_with_five_decimals_is_normalised(data: Path, capsys: Capture) -> None:
    path = data / "truth_chaser_attitude.csv"
    head, *rows = path.read_text("utf-8").splitlines()
    short = [[float(v) for v in row.split(",")] for row in rows]
    text = [",".join([repr(t), *(f"{v:.5f}" for v in q)]) for t, *q in short]
    path.write_text("\n".join([head, *text]) + "\n", "utf-8")
    truth = open_dataset(data).recording.truth
    assert truth is not None
    for R in truth.values["chaser_attitude"]:
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    path.write_text("\n".join([head, f"0.0,{1.002},0,0,0", *text[1:]]) + "\n", "utf-8")
    code, _, err = relnav(capsys, "validate", data)
    assert code == 2
    assert f"{path}, line 2, column q_w: found 1.002, expected a quaternion of length one" in err


# --- row 52: what data may not ask for -------------------------------------------------------


@pytest.fixture
def evil(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data set whose scenario has a module imported, which leaves a file."""
    monkeypatch.syspath_prepend(str(tmp_path))
    code = f"open({str(tmp_path / 'ran')!r}, 'w').close()\n"
    code += "from relnav_factors.sensors.beacon_los import BeaconLineOfSight as Model\n"
    (tmp_path / f"evil_{tmp_path.name}.py").write_text(code, "utf-8")
    path = data / "scenario.toml"
    text = path.read_text("utf-8")
    named = text.replace('kind = "beacon_los"', f'kind = "evil_{tmp_path.name}:Model"')
    assert named != text
    path.write_text(named, "utf-8")
    return data


def test_row_52_data_name_no_module(evil: Path, tmp_path: Path, capsys: Capture) -> None:
    """Not imported, not even to be looked at, by any command; with --trust it is."""
    out = tmp_path / "out"
    commands: tuple[tuple[object, ...], ...] = (
        ("validate", evil),
        ("smooth", evil, "-o", out),
        ("convert", evil, tmp_path / "other"),
    )
    for command in commands:
        code, _, err = relnav(capsys, *command)
        assert code == 2
        assert f"{evil / 'scenario.toml'}: sensors.beacons.kind: found 'evil_" in err
        assert "--trust" in err
        assert not (tmp_path / "ran").exists()
    code, _, err = relnav(capsys, "smooth", evil, "-o", out, "--trust")
    assert code == 0, err
    assert (tmp_path / "ran").exists()
    # What it leaves behind names it too, and is data for whoever reads it.
    (tmp_path / "ran").unlink()
    code, _, err = relnav(capsys, "report", out)
    assert code == 2
    assert f"{out / 'pass.json'}: raw.sensors.beacons.kind: found 'evil_" in err
    assert relnav(capsys, "report", out, "--trust")[0] == 0


@pytest.mark.parametrize(
    "settings",
    [
        {"sensors": {"beacons": {"kind": "os:system"}}},
        {"processes": {"chaser": {"kind": "os:system"}}},
    ],
)
def test_row_52_settings_of_data_name_no_module(settings: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"settings of the data: .*kind: found 'os:system'"):
        open_pass(ZHANG, data=Recording(np.zeros(1), (), settings=settings))


def test_row_52_a_sensor_cannot_read_outside_its_data_set(data: Path, capsys: Capture) -> None:
    """Nor can it be written there."""
    (data / "beacons.csv").rename(data.parent / "out.csv")
    path = data / "scenario.toml"
    text = path.read_text("utf-8").replace("[sensors.beacons]", '[sensors."../out"]')
    path.write_text(text, "utf-8")
    code, _, err = relnav(capsys, "validate", data)
    assert code == 2
    assert "sensors: found '../out' as the name of" in err
    code, _, err = relnav(capsys, "simulate", path, "-o", data.parent / "new")
    assert code == 2
    assert "sensors: found '../out' as the name of" in err
    assert not (data.parent / "new").exists()
