"""Tables as people have them: loose where nothing can be mistaken."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tables import BLOCKS, GYRO, INPUTS, SCENARIO, SENSORS, by_hand, make_recording, read

from relnav_graph.errors import InputError
from relnav_graph.io.dataset import read_dataset, write_dataset


def test_tables_as_people_have_them(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A mark of the encoding, lines that end as on Windows, columns in any order, further ones, no
    ids where there is one thing to see, a sigma for each row."""
    text = "\ufeffquality,range_m,sigma_m,t_s\r\n0.9,5.25,0.5,0\r\n0.8,5.5,0.25,1\r\n"
    with caplog.at_level("INFO"):
        got = read(by_hand(tmp_path, range=text))
    ranges = [m for m in got.measurements if m.sensor == "range"]
    assert [(m.t, m.z.tolist(), m.ids.tolist()) for m in ranges] == [
        (0.0, [[5.25]], [7]),
        (1.0, [[5.5]], [7]),
    ]
    assert [m.covariance.tolist() for m in ranges if m.covariance is not None] == [
        [[[0.25]]],
        [[[0.0625]]],
    ]
    assert f"{tmp_path / 'range.csv'}: not read: column quality" in caplog.messages


def test_rows_are_sorted_on_request_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = by_hand(
        tmp_path, range="t_s,range_m\n1,6\n0,5\n", gyro=GYRO + "1,2,0,0,2\n0,1,0,0,1\n"
    )
    with pytest.raises(InputError, match=r"line 3, column t_s: found 0\.0"):
        read(folder)
    with caplog.at_level("INFO"):
        got = read_dataset(folder, SENSORS, INPUTS, BLOCKS, sort=True)
    assert [m.z[0, 0] for m in got.measurements if m.sensor == "range"] == [5.0, 6.0]
    assert got.inputs["gyro"].values[:, 2].tolist() == [1.0, 2.0]
    assert f"{folder / 'range.csv'}: sorted by t_s: 2 of 2 rows moved" in caplog.text


def test_noise_of_its_own_is_written_and_read_bit_by_bit(tmp_path: Path) -> None:
    R = np.array([[2.0e-7, 3.3e-8], [3.3e-8, 1.7e-7]]) / 3
    recording = make_recording()
    given = tuple(
        replace(m, covariance=np.tile(R, (len(m.z), 1, 1)) * (1 + m.t))
        if m.sensor == "beacons"
        else m
        for m in recording.measurements
    )
    folder = tmp_path / "set"
    write_dataset(folder, SCENARIO, replace(recording, measurements=given), SENSORS, INPUTS, BLOCKS)
    got = read(folder)
    assert (
        (folder / "beacons.csv")
        .read_text("utf-8")
        .splitlines()[0]
        .endswith("cov_1_1,cov_2_1,cov_2_2")
    )
    for one, other in zip(got.measurements, given, strict=True):
        assert (one.covariance is None) == (other.covariance is None)
        if one.covariance is not None and other.covariance is not None:
            np.testing.assert_array_equal(one.covariance, other.covariance)
    k = next(k for k, m in enumerate(given) if m.covariance is not None)
    bare = (*given[:k], replace(given[k], covariance=None), *given[k + 1 :])
    with pytest.raises(InputError, match="found no covariance, but others of its"):
        write_dataset(
            tmp_path / "two",
            SCENARIO,
            replace(recording, measurements=bare),
            SENSORS,
            INPUTS,
            BLOCKS,
        )


def test_truth_is_not_read_across_a_gap_that_is_too_long(tmp_path: Path) -> None:
    rows = "".join(f"{t},{t * t},0,0\n" for t in (0.0, 0.4, 0.8, 1.2))
    folder = by_hand(tmp_path, truth_relative_velocity="t_s,x_m_s,y_m_s,z_m_s\n" + rows)
    for gap, known in ((None, True), (0.39, False)):
        truth = read_dataset(folder, SENSORS, INPUTS, BLOCKS, gap=gap).truth
        assert truth is not None
        at, same = truth.at(np.array([1.0]))
        assert same.all()
        assert np.isfinite(truth.values["relative_velocity"][at]).all() == known


@pytest.mark.parametrize("quoted", [False, True], ids=["plain", "with care"])
def test_an_origin_is_taken_off_stamps_as_they_are_written(tmp_path: Path, quoted: bool) -> None:
    """Unix stamps in nanoseconds, of which a float64 would lose the last two digits."""
    stamps = ["1700000000.000000001", "1700000000.123456789", "1700000001.999999999"]
    mark = '"' if quoted else ""
    rows = "".join(f"{mark}{t}{mark},5\n" for t in stamps)
    (tmp_path / "range.csv").write_text("t_s,range_m\n" + rows, "utf-8")
    sensors = {"range": SENSORS["range"]}
    got = read_dataset(tmp_path, sensors, {}, {}, origin=1.7e9)
    assert [m.t for m in got.measurements] == [1e-9, 0.123456789, 1.999999999]
    assert got.times.tolist() == [1e-9, 0.123456789, 1.999999999]
    out = tmp_path / "out"
    write_dataset(out, SCENARIO, got, sensors, {}, {}, origin=1.7e9)
    assert [row.split(",")[0] for row in (out / "range.csv").read_text().splitlines()[1:]] == stamps
    again = read_dataset(out, sensors, {}, {}, origin=1.7e9)
    np.testing.assert_array_equal(again.times, got.times)
    (tmp_path / "range.csv").write_text("t_s,range_m\n1700000005,5\n1700000004,5\n", "utf-8")
    with pytest.raises(InputError, match=r"line 3, column t_s: found 1700000004\.0, expected"):
        read_dataset(tmp_path, sensors, {}, {}, origin=1.7e9)


def test_texts_and_holes_in_columns_that_nobody_reads(tmp_path: Path) -> None:
    """A remark, a temperature that was not always there; a hole in what is read is wrong."""
    text = "t_s,remark,range_m,kelvin\n0,begun,5.25,nan\n1,,{},290\n"
    got = read(by_hand(tmp_path / "good", range=text.format("5.5")))
    assert [m.z[0, 0] for m in got.measurements if m.sensor == "range"] == [5.25, 5.5]
    for cell in ("", "nan", "five"):
        with pytest.raises(InputError, match=r"range\.csv, line 3, column range_m: found .*number"):
            read(by_hand(tmp_path / f"bad{cell}", range=text.format(cell)))


def test_a_truth_of_no_state_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = by_hand(tmp_path)
    (folder / "truth_relative_positon.csv").write_text("t_s,x_m,y_m,z_m\n0,1,2,3\n")
    with caplog.at_level("INFO"):
        read(folder)
    assert f"{folder / 'truth_relative_positon.csv'}: not read: no state has that" in caplog.text
