"""Data sets: what is written is read back bit by bit, and damage is named."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest

from relnav_graph.core.catalogue import INERTIA, RELATIVE_ATTITUDE, RELATIVE_VELOCITY_T
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.dataset import (
    read_dataset,
    read_scenario_of,
    read_settings_of,
    write_dataset,
)
from relnav_graph.linear.whitening import measurement_noise

ONE = np.zeros(1, dtype=np.int64)
# A table needs only the names of a sensor's columns, and how many rows its residual has.
SENSORS: dict[str, Any] = {
    "beacons": SimpleNamespace(columns=("los_x", "los_y", "los_z"), rows=2),
    "range": SimpleNamespace(columns=("range_m",), rows=1),
}
BLOCKS = {b.name: b for b in (RELATIVE_ATTITUDE, RELATIVE_VELOCITY_T, INERTIA)}
SCENARIO = {"title": "a pass", "seed": 3, "sensors": {"range": {"sigma": "0.1 mm"}}}


def make_recording(epochs: int = 30) -> Recording:
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.1, 0.2, epochs))
    measurements = []
    for k in range(epochs):
        ids = rng.permutation(6)[: k % 4]
        if len(ids):
            measurements.append(Measurement("beacons", t[k], rng.normal(size=(len(ids), 3)), ids))
        if k % 3 == 0:
            z = 1e-7 * rng.normal(size=(1, 1))
            measurements.append(Measurement("range", t[k], z, np.array([7]), t[k] + 0.01))
    gyro = InputSeries("gyro", t[:-1], t[1:], rng.normal(size=(epochs - 1, 3)))
    layout = Layout(BLOCKS.values())
    x = np.array(
        [layout.retract(layout.identity, d) for d in rng.normal(size=(epochs, layout.dim))]
    )
    values = {name: layout.value(x, name).copy() for name in BLOCKS}
    values["relative_velocity"][4:9] = np.nan
    settings = {"sensors": {"range": {"points": [[0.1, 1 / 3], [2.0, 3.0]]}}}
    return Recording(t, tuple(measurements), {"gyro": gyro}, Truth(t, values, "made up"), settings)


INPUTS = {"gyro": ("wx_rad_s", "wy_rad_s", "wz_rad_s")}


def read(folder: Path) -> Recording:
    return read_dataset(folder, SENSORS, INPUTS, BLOCKS)


def write(folder: Path, tables: Literal["csv", "parquet"] = "csv") -> Path:
    write_dataset(folder, SCENARIO, make_recording(), SENSORS, INPUTS, BLOCKS, tables)
    return folder


def by_hand(folder: Path, **tables: str) -> Path:
    """A data set without a manifest, as one makes it from one's own data."""
    folder.mkdir(exist_ok=True)
    defaults = {
        "beacons": "t_s,id,los_x,los_y,los_z\n0,1,0,0,1\n0,2,0,1,0\n1,1,0,0,1\n",
        "range": "t_s,id,range_m\n0,0,5\n1.0,0,6.5\n",
        "gyro": "t_start_s,t_end_s,wx_rad_s,wy_rad_s,wz_rad_s\n0,0.5,0,0,1\n0.5,1,0,0,2\n",
    }
    for name, text in (defaults | tables).items():
        (folder / f"{name}.csv").write_text(text, "utf-8")
    return folder


@pytest.mark.parametrize("tables", ["csv", "parquet"])
def test_write_then_read_is_bit_exact(tmp_path: Path, tables: Literal["csv", "parquet"]) -> None:
    want, got = make_recording(), read(write(tmp_path / "set", tables))
    assert read_scenario_of(tmp_path / "set") == SCENARIO
    assert read_settings_of(tmp_path / "set") == got.settings == want.settings
    np.testing.assert_array_equal(got.times, want.times)
    assert len(got.measurements) == len(want.measurements)
    for a, b in zip(got.measurements, want.measurements, strict=True):
        assert (a.sensor, a.t, a.t_arrival) == (b.sensor, b.t, b.t_arrival)
        np.testing.assert_array_equal(a.z, b.z)
        np.testing.assert_array_equal(a.ids, b.ids)
    for key in ("t_start", "t_end", "values"):
        np.testing.assert_array_equal(
            getattr(got.inputs["gyro"], key), getattr(want.inputs["gyro"], key)
        )
    assert got.truth is not None
    assert want.truth is not None
    assert got.truth.source == "made up"
    np.testing.assert_array_equal(got.truth.t, want.truth.t)
    for name in ("relative_velocity", "inertia_parameters"):
        np.testing.assert_array_equal(got.truth.values[name], want.truth.values[name])
    np.testing.assert_allclose(
        got.truth.values["relative_attitude"], want.truth.values["relative_attitude"], atol=1e-14
    )


@pytest.mark.parametrize(
    "text",
    [
        "1_1,2_1\n0.25,-0.5\n",
        "t_s,1_1,2_1\n0.3,0.25,-0.5\n",
        "t_s,1_1,2_1\n0,0.25,-0.5\n9,0.25,-0.5\n",
    ],
)
def test_the_truth_of_a_constant_holds_at_all_epochs(tmp_path: Path, text: str) -> None:
    folder = by_hand(tmp_path / "set", truth_inertia_parameters=text)
    got = read_dataset(folder, SENSORS, INPUTS, BLOCKS, statics={"inertia_parameters"})
    assert got.truth is not None
    assert got.truth.at(got.times)[1].all()
    np.testing.assert_array_equal(
        got.truth.values["inertia_parameters"], np.tile([0.25, -0.5], (len(got.truth.t), 1))
    )


def test_the_truth_of_a_constant_that_moves_is_left_as_it_is(tmp_path: Path) -> None:
    text = "t_s,1_1,2_1\n0,0.25,-0.5\n1,0.5,-0.5\n"
    folder = by_hand(tmp_path / "set", truth_inertia_parameters=text)
    got = read_dataset(folder, SENSORS, INPUTS, BLOCKS, statics={"inertia_parameters"})
    assert got.truth is not None
    assert got.truth.values["inertia_parameters"][:, 0].tolist() == [0.25, 0.5]


def test_two_rows_without_times_are_refused(tmp_path: Path) -> None:
    text = "1_1,2_1\n0.25,-0.5\n0.25,-0.5\n"
    folder = by_hand(tmp_path / "set", truth_inertia_parameters=text)
    for statics in ({"inertia_parameters"}, set[str]()):
        with pytest.raises(
            InputError, match=r"truth_inertia_parameters\.csv, line 1: no column 't_s'"
        ):
            read_dataset(folder, SENSORS, INPUTS, BLOCKS, statics=statics)


def test_a_data_set_made_by_hand(tmp_path: Path) -> None:
    folder = by_hand(
        tmp_path,
        gyro="t_s,wx_rad_s,wy_rad_s,wz_rad_s\n0,9,9,9\n0.4,1,2,3\n1,4,5,6\n",
        truth_relative_attitude="t_s,q_w,q_x,q_y,q_z\n0,-0.6,0,0,-0.8\n1,0.6,0,0,0.8\n",
        truth_relative_velocity="\ufefft_s,x_m_s,y_m_s,z_m_s\r\n\r\n1,1,2,3\r\n",
    )
    got = read(folder)
    assert [(m.sensor, m.t, len(m.z)) for m in got.measurements] == [
        ("beacons", 0, 2),
        ("range", 0, 1),
        ("beacons", 1, 1),
        ("range", 1, 1),
    ]
    np.testing.assert_array_equal(got.times, [0, 1])
    gyro = got.inputs["gyro"]
    np.testing.assert_array_equal(gyro.t_start, [0, 0.4])
    np.testing.assert_array_equal(gyro.values, [[1, 2, 3], [4, 5, 6]])
    assert got.truth is not None
    R_tc = got.truth.values["relative_attitude"]
    np.testing.assert_allclose(R_tc[0] @ [1, 0, 0], [-0.28, 0.96, 0], atol=1e-15)
    np.testing.assert_array_equal(R_tc[0], R_tc[1])  # q and -q are one attitude
    np.testing.assert_array_equal(got.truth.values["relative_velocity"][1], [1, 2, 3])
    assert np.isnan(got.truth.values["relative_velocity"][0]).all()


BEACONS = "t_s,id,los_x,los_y,los_z\n"
QUATERNION = "t_s,q_w,q_x,q_y,q_z\n"
GYRO = "t_start_s,t_end_s,wx_rad_s,wy_rad_s,wz_rad_s\n"
FAULTS = {
    "nan": ("range", "t_s,id,range_m\n0,0,5\n1,0,nan\n", "line 3, column range_m: found nan"),
    "infinite time": ("range", "t_s,id,range_m\ninf,0,5\n", "line 2, column t_s: found inf"),
    "text": ("range", "t_s,id,range_m\n0,0,5 km\n", "line 2, column range_m: found '5 km'"),
    "empty cell": ("range", "t_s,id,range_m\n0,,5\n", "line 2, column id: found ''"),
    "cut off": ("range", "t_s,id,range_m\n0,0,5\n1,0\n", "line 3: found 2 of 3 columns"),
    "empty file": ("range", "", "line 1: found .*, expected names of columns"),
    "other unit": ("range", "t_s,id,range_km\n0,0,5\n", "no column 'range_m'; found t_s, id"),
    "unknown column": ("range", "t_s,id,range_m,snr\n0,0,5,1\n", "unknown column 'snr'"),
    "column twice": ("range", "t_s,id,id\n0,0,5\n", "once each"),
    "fraction": ("range", "t_s,id,range_m\n0,0.5,5\n", "column id: found 0.5, expected a whole"),
    "duplicate": (
        "beacons",
        BEACONS + "0,1,0,0,1\n0,2,0,0,1\n0,1,0,0,1\n1,3,0,0,1\n1,3,0,0,1\n",
        r"line 4, column id: found 1.0, expected an id once .*\(2 such rows\)",
    ),
    "backwards": ("range", "t_s,id,range_m\n1,0,5\n0,0,5\n", "line 3, column t_s: found 0.0"),
    "arrival": (
        "beacons",
        "t_s,id,los_x,los_y,los_z,t_arrival_s\n0,1,0,0,1,1\n0,2,0,0,1,2\n",
        "line 3, column t_arrival_s: found 2.0, expected the same",
    ),
    "overlap": ("gyro", GYRO + "0,1,0,0,0\n0.5,2,0,0,0\n", "line 3, column t_start_s: found 0.5"),
    "no interval": ("gyro", GYRO + "0,0,0,0,0\n", "line 2, column t_end_s: found 0.0"),
    "other clock": ("epochs", "t_s\n0\n100\n", "line 4, column t_s: found 1.0, expected the time"),
    "epoch twice": ("epochs", "t_s\n0\n0\n1\n", "line 3, column t_s: found 0.0"),
    "long quaternion": (
        "truth_relative_attitude",
        QUATERNION + "0,1,0,0,0\n1,0.6,0,0,0.81\n",
        "line 3, column q_w: .* expected a quaternion of length one",
    ),
    "binary": ("range", "t_s,id,range_m\n0,0,\x00\n", "range.csv"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_table_is_refused_with_its_place(tmp_path: Path, fault: str) -> None:
    name, text, message = FAULTS[fault]
    by_hand(tmp_path)
    read(tmp_path)
    by_hand(tmp_path, **{name: text})
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path)
    assert str(tmp_path / f"{name}.csv" if fault != "other clock" else tmp_path) in str(
        caught.value
    )


def test_missing_and_ambiguous_tables(tmp_path: Path) -> None:
    by_hand(tmp_path)
    with pytest.raises(InputError, match=r"no table stars\.csv or stars\.parquet; found beacons"):
        read_dataset(tmp_path, {"stars": SENSORS["range"]}, {}, {})
    with pytest.raises(InputError, match="thrust"):
        read_dataset(tmp_path, SENSORS, {"thrust": ("x_n",)}, {})
    (tmp_path / "range.parquet").touch()
    with pytest.raises(InputError, match=r"both range\.csv and range\.parquet"):
        read(tmp_path)
    (tmp_path / "range.csv").unlink()
    with pytest.raises(InputError, match=r"range\.parquet: not a readable Parquet table"):
        read(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        read(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=r"scenario\.toml: cannot be read: No such file"):
        read_scenario_of(tmp_path)
    (tmp_path / "scenario.toml").write_text("seed = ", "utf-8")
    with pytest.raises(InputError, match=r"scenario\.toml: not valid TOML"):
        read_scenario_of(tmp_path)


def test_no_epochs_at_all(tmp_path: Path) -> None:
    by_hand(tmp_path, beacons=BEACONS, range="t_s,id,range_m\n")
    with pytest.raises(InputError, match="no epochs"):
        read(tmp_path)


@pytest.mark.parametrize(
    "name", ["range.csv", "gyro.csv", "epochs.csv", "truth_relative_attitude.csv"]
)
def test_a_cut_or_flipped_table_is_refused(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / "set") / name
    data = path.read_bytes()
    flipped = bytearray(data)
    flipped[-3] ^= 1
    # Cut behind a whole line: no reader of CSV could notice.
    for damaged in (bytes(flipped), data[: data[:-1].rindex(b"\n") + 1], data[:-4]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=rf"{name}: truncated or changed"):
            read(tmp_path / "set")
    path.unlink()
    with pytest.raises(InputError, match=rf"{name}: missing, though dataset\.toml lists it"):
        read(tmp_path / "set")


def test_a_damaged_manifest_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "set") / "dataset.toml"
    text = path.read_text("utf-8")
    for old, new, message in [
        ("format = 1", "format = 2", "found format 2, expected 1"),
        ("2.0,", "2.5,", r"\[settings\] changed"),
        ("[sha256]", "[other]", "expected tables"),
        ("format", '"', "not valid TOML"),
    ]:
        assert old in text
        path.write_text(text.replace(old, new, 1), "utf-8")
        with pytest.raises(InputError, match=message):
            read(tmp_path / "set")


def test_a_recording_that_no_table_can_hold_is_refused(tmp_path: Path) -> None:
    recording = make_recording()

    def attempt(sensors: dict[str, Any], rec: Recording, message: str) -> None:
        with pytest.raises(InputError, match=message):
            write_dataset(tmp_path / "set", SCENARIO, rec, sensors, INPUTS, BLOCKS)
        assert not list(tmp_path.iterdir())

    attempt({"range": SENSORS["range"]}, recording, "unknown sensor 'beacons'")
    attempt({**SENSORS, "epochs": SENSORS["range"]}, recording, "cannot name a table")
    attempt({**SENSORS, "a/b": SENSORS["range"]}, recording, "as the name of a table")
    attempt(
        {**SENSORS, "beacons": SENSORS["range"]}, recording, "z has 3 columns, expected range_m"
    )
    other = {"thrust": replace(recording.inputs["gyro"], name="thrust")}
    attempt(SENSORS, replace(recording, inputs=other), "unknown input 'thrust'")


def test_only_a_data_set_is_replaced(tmp_path: Path) -> None:
    folder = write(tmp_path / "set")
    write(folder, "parquet")
    assert not list(folder.glob("*.csv"))
    read(folder)
    (folder / "notes.txt").write_text("mine", "utf-8")
    with pytest.raises(InputError, match="holds files that are not of a data set"):
        write(folder)
    assert (folder / "notes.txt").read_text("utf-8") == "mine"
    read(folder)


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file may grow beyond `size` bytes: the system refuses as it does on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    folder = write(tmp_path / "set")
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    with full_disk(500), pytest.raises(InputError, match="set: cannot be written: File too large"):
        write(folder)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["set"]


def test_atomic_replaces_all_or_nothing(tmp_path: Path) -> None:
    target = tmp_path / "new" / "file.txt"
    with atomic(target) as staged:
        staged.write_text("one", "utf-8")
        assert not target.exists()

    def interrupted() -> None:
        with atomic(target) as staged:
            staged.write_text("half", "utf-8")
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        interrupted()
    assert target.read_text("utf-8") == "one"
    assert [p.name for p in target.parent.iterdir()] == ["file.txt"]
    for wrong in (target / "below.txt", tmp_path / "new"):  # below a file; where a folder stands
        with pytest.raises(InputError, match="cannot be written"), atomic(wrong) as staged:
            staged.write_text("two", "utf-8")
    assert target.read_text("utf-8") == "one"


def test_covariances_of_single_measurements_are_kept(tmp_path: Path) -> None:
    """As columns, to the bit; and they count in the place of the sensor's own noise."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(4, 1, 1))
    measured = tuple(
        Measurement("range", float(k), np.array([[5.0 + k]]), ONE, covariance=A[k : k + 1] ** 2 + 1)
        for k in range(4)
    )
    recording = Recording(np.arange(4.0), measured)
    sensors: Any = {"range": SENSORS["range"]}
    write_dataset(tmp_path / "set", {}, recording, sensors, {}, {})
    found = read_dataset(tmp_path / "set", sensors, {}, {})
    for a, b in zip(found.measurements, measured, strict=True):
        assert a.covariance is not None
        np.testing.assert_array_equal(a.covariance, b.covariance)
        np.testing.assert_array_equal(measurement_noise("range", sensors["range"], a), b.covariance)
    part = Recording(np.arange(2.0), (measured[0], replace(measured[1], covariance=None)))
    with pytest.raises(InputError, match=r"'range' at t = 1.0 s: found no covariance, but others"):
        write_dataset(tmp_path / "part", {}, part, sensors, {}, {})
    table = tmp_path / "set" / "range.csv"
    (tmp_path / "set" / "dataset.toml").unlink()
    table.write_text("t_s,id,range_m,cov_1_1\n0,0,5,0\n")
    with pytest.raises(InputError, match=r"column cov_1_1: found 0\.0, expected a variance"):
        read_dataset(tmp_path / "set", sensors, {}, {})
    with pytest.raises(InputError, match=r"found a covariance \(2, 1, 1\), expected"):
        Measurement("range", 0.0, np.ones((1, 1)), ONE, covariance=np.ones((2, 1, 1)))
