"""Static blocks in results files and tables: round trip, and damage."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from static_tracks import filtered, joint_covariance, smoothed, truth_of_statics

from relnav_graph.core.track import Track
from relnav_graph.io.results import read_results, write_results
from relnav_graph.io.track_tables import write_csv

FORMAT = ("relnav-graph results", 1)


def online() -> Track:
    return replace(filtered(), smoothed=smoothed(name="ekf_smoothed"))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_results(tmp_path / "r.nc", [online(), smoothed()], truth_of_statics(), {})
    return tmp_path / "r.nc"


def test_round_trip_of_statics(path: Path) -> None:
    tracks, truth, _ = read_results(path)
    assert tracks[0].smoothed is not None
    for got, want in zip(
        [*tracks, tracks[0].smoothed], [online(), smoothed(), smoothed()], strict=True
    ):
        assert got.blocks == want.blocks
        assert got.layout == want.layout
        assert got.statics is not None
        assert want.statics is not None
        np.testing.assert_array_equal(got.P, want.P)
        np.testing.assert_array_equal(got.statics.P, want.statics.P)
        np.testing.assert_array_equal(got.statics.cross, want.statics.cross)
        np.testing.assert_allclose(got.statics.x, want.statics.x, rtol=0, atol=1e-12)
    assert truth is not None
    for name, values in truth_of_statics().values.items():
        np.testing.assert_allclose(truth.values[name], values, rtol=0, atol=1e-12)


def test_one_value_is_stored_once(path: Path) -> None:
    with xarray.open_dataset(path, group="batch", engine="h5netcdf") as data:
        assert data["static_covariance"].dims == ("pass", "static", "static_2")
        assert data["mounting"].dims == ("pass", "mounting_component")
        assert data["cross_covariance"].dims == ("time", "state", "static")
        assert data["static_covariance"].attrs["block_order"] == "mounting lever_arm"
        assert data["lever_arm"].attrs["units"] == "m"
    with xarray.open_dataset(path, group="ekf", engine="h5netcdf") as data:
        assert data["static_covariance"].dims == ("time", "static", "static_2")
        assert data["mounting"].dims == ("time", "mounting_component")


def test_a_diverged_track_keeps_the_nan_of_its_statics(tmp_path: Path) -> None:
    track = smoothed(status="diverged")
    s = track.statics
    assert s is not None
    nan = replace(s, x=np.full_like(s.x, np.nan), P=np.full_like(s.P, np.nan))
    write_results(tmp_path / "r.nc", [replace(track, statics=nan)], None, {})
    (got,), _, _ = read_results(tmp_path / "r.nc")
    assert got.statics is not None
    assert np.isnan(got.statics.P).all()
    assert np.isnan(got.statics.x).all()


def test_tables_of_statics(tmp_path: Path) -> None:
    write_csv(tmp_path, [online()])
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "ekf.csv",
        "ekf_smoothed.csv",
        "ekf_smoothed_statics.csv",
        "ekf_statics.csv",
    ]
    with (tmp_path / "ekf_statics.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 40
    assert float(rows[9]["t_s"]) == 9.0
    sigma = np.sqrt(joint_covariance()[6, 6] / 10)
    assert float(rows[9]["sigma_lever_arm_x_m"]) == pytest.approx(sigma)
    with (tmp_path / "ekf_smoothed_statics.csv").open() as stream:
        (row,) = csv.DictReader(stream)
    assert "t_s" not in row
    assert float(row["lever_arm_z_m"]) == smoothed().value("lever_arm")[0, 2]
    with (tmp_path / "ekf.csv").open() as stream:
        assert not [c for c in next(csv.reader(stream)) if "mounting" in c]
