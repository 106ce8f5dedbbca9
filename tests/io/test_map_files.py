"""Maps of unknown points in results, tables, data sets, and as point clouds."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from map_tracks import IDS, POINTS, filtered, joint_covariance, smoothed, truth_of_map

from relnav_graph.arrays import Array
from relnav_graph.cli.main import main
from relnav_graph.core.catalogue import POINT
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.io.maps import write_map
from relnav_graph.io.netcdf import Variable, read_groups, write_groups
from relnav_graph.io.results import read_results, write_results
from relnav_graph.io.track_tables import write_csv
from relnav_graph.io.truth import read_truth
from relnav_graph.runs.passes import open_dataset

FORMAT = ("relnav-graph results", 1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_results(tmp_path / "r.nc", [filtered(), smoothed()], truth_of_map(), {})
    return tmp_path / "r.nc"


def test_round_trip_of_a_map(path: Path) -> None:
    tracks, truth, _ = read_results(path)
    for got, want in zip(tracks, [filtered(), smoothed()], strict=True):
        assert got.blocks == want.blocks
        assert got.statics is not None
        assert want.statics is not None
        np.testing.assert_array_equal(got.statics.P, want.statics.P)
        np.testing.assert_array_equal(got.statics.cross, want.statics.cross)
        np.testing.assert_array_equal(got.statics.x, want.statics.x)
    assert truth is not None
    assert set(truth.values) == set(truth_of_map().values)
    for name, values in truth_of_map().values.items():
        np.testing.assert_allclose(truth.values[name], values, rtol=0, atol=1e-12)


def test_a_map_is_one_array_with_ids_and_covariances(path: Path) -> None:
    with xarray.open_dataset(path, group="batch", engine="h5netcdf") as data:
        assert not [n for n in data.variables if "[" in str(n)]
        assert data["point"].dims == ("pass", "point_id", "point_component")
        assert data["point"].shape == (1, 5, 3)
        assert data["point_id"].values.tolist() == list(IDS)
        np.testing.assert_array_equal(
            data["point"].sel(point_id=7).values[0], smoothed().value("point[7]")[0]
        )
        P = joint_covariance()[17:20, 17:20] / 40
        np.testing.assert_allclose(data["point_covariance"].sel(point_id=7).values[0], P)
        assert data["point"].attrs["symbol"] == "X_t"
    with xarray.open_dataset(path, group="ekf", engine="h5netcdf") as data:
        assert data["point"].dims == ("time", "point_id", "point_component")
    with xarray.open_dataset(path, group="truth", engine="h5netcdf") as data:
        assert data["point"].shape == (1, 6, 3)
        assert data["point_id"].values.tolist() == [*IDS, 20]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"point_id": [3.0, 0.0, 7.0, 1.0, 1.0]}, "each once"),
        ({"point_id": [3.0, 0.5, 7.0, 1.0, 12.0]}, "each once"),
        ({"point_id": [3.0, 0.0, 7.0, 1.0, 13.0]}, r"expected point\[12\]"),
        ({"point_id": None}, "no variable 'point_id'"),
        ({"point": None}, "no variable 'point'"),
    ],
)
def test_row_34_a_damaged_map_is_named(
    path: Path, change: dict[str, list[float] | None], words: str
) -> None:
    groups = read_groups(path, *FORMAT)
    variables = dict(groups["batch"].variables)
    for name, values in change.items():
        if values is None:
            del variables[name]
        else:
            old = variables[name]
            variables[name] = Variable(old.dimensions, np.array(values), old.attributes)
    groups["batch"] = replace(groups["batch"], variables=variables)
    write_groups(path, *FORMAT, groups)
    with pytest.raises(InputError, match=words) as caught:
        read_results(path)
    assert "batch" in str(caught.value)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_tables_have_a_row_for_each_point(tmp_path: Path) -> None:
    write_csv(tmp_path, [filtered(3), smoothed()])
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {f"{n}{e}.csv" for n in ("ekf", "batch") for e in ("", "_statics", "_point")}
    rows = rows_of(tmp_path / "batch_point.csv")
    assert [int(r["id"]) for r in rows] == list(IDS)
    assert list(rows[0]) == ["id", "x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m"]
    for row, i in zip(rows, IDS, strict=True):
        X = smoothed().value(f"point[{i}]")[0]
        assert [float(row[f"{a}_m"]) for a in "xyz"] == X.tolist()
    assert not [n for n in rows_of(tmp_path / "batch_statics.csv")[0] if "point" in n]
    timed = rows_of(tmp_path / "ekf_point.csv")
    assert len(timed) == 15
    assert [float(r["t_s"]) for r in timed[4:6]] == [0.0, 1.0]
    assert float(timed[5]["x_m"]) == filtered(3).value("point[3]")[1, 0]


def parsed(path: Path) -> dict[str, Array]:
    """An ordinary reader of ASCII PLY: vertices by property."""
    lines = path.read_text("ascii").splitlines()
    assert lines[:2] == ["ply", "format ascii 1.0"]
    end = lines.index("end_header")
    words = [line.split() for line in lines[:end]]
    (count,) = (int(w[2]) for w in words if w[:2] == ["element", "vertex"])
    names = [w[2] for w in words if w[0] == "property"]
    body = np.array([[float(v) for v in line.split()] for line in lines[end + 1 :]])
    assert body.shape == (count, len(names))
    return dict(zip(names, body.T, strict=True))


def test_the_map_is_a_point_cloud(tmp_path: Path) -> None:
    write_map(tmp_path, {"batch": smoothed(), "ekf": filtered()})
    cloud = parsed(tmp_path / "batch_map.ply")
    assert list(cloud)[:6] == ["x", "y", "z", "sigma_x", "sigma_y", "sigma_z"]
    assert cloud["id"].astype(int).tolist() == list(IDS)
    X = np.column_stack([cloud[a] for a in "xyz"])
    assert np.abs(X - POINTS).max() < 0.01
    np.testing.assert_array_equal(X[2], smoothed().value("point[7]")[-1])
    P = joint_covariance()[17:20, 17:20] / 40
    assert cloud["sigma_y"][2] == pytest.approx(np.sqrt(P[1, 1]))
    assert cloud["cov_xz"][2] == pytest.approx(P[0, 2])
    rows = rows_of(tmp_path / "ekf_map.csv")
    assert list(rows[0])[:5] == ["id", "x_m", "y_m", "z_m", "sigma_x_m"]
    assert float(rows[2]["cov_xz_m2"]) == pytest.approx(P[0, 2])
    assert float(rows[0]["x_m"]) == filtered().value("point[3]")[-1, 0]


def without_map() -> Track:
    return replace(smoothed(), statics=None)


def diverged() -> Track:
    own = smoothed().statics
    assert own is not None
    return replace(smoothed(), statics=replace(own, x=np.full_like(own.x, np.nan)))


@pytest.mark.parametrize("make", [without_map, diverged])
def test_without_a_map_there_is_no_file(tmp_path: Path, make: Callable[[], Track]) -> None:
    write_map(tmp_path, {"batch": make()})
    assert not list(tmp_path.iterdir())


def test_truth_of_points_is_a_table_by_id(tmp_path: Path) -> None:
    (tmp_path / "truth_point.csv").write_text("id,x_m,y_m,z_m\n3,1,2,3\n0,4,5,6\n", "utf-8")
    found = read_truth(tmp_path, {}, np.arange(3.0), "hand", (), {"point": POINT})
    assert found is not None
    assert set(found.values) == {"point[3]", "point[0]"}
    np.testing.assert_array_equal(found.values["point[0]"], np.tile([4.0, 5.0, 6.0], (3, 1)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("id,x_m,y_m,z_m\n3,1,2,3\n3,4,5,6\n", "line 3, column id: found 3.0, expected each"),
        ("id,x_m,y_m,z_m\n-1,1,2,3\n", "line 2, column id: found -1.0, expected a number"),
        ("id,x_m,y_m,z_m\n1.5,1,2,3\n", "line 2, column id: found 1.5"),
        ("t_s,id,x_m,y_m,z_m\n0,1,1,2,3\n", "line 1: found a column t_s, expected none"),
        ("id,x_m,y_m\n1,1,2\n", "line 1: no column 'z_m'"),
    ],
)
def test_row_42_a_bad_truth_of_points_is_named(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "truth_point.csv").write_text(text, "utf-8")
    with pytest.raises(InputError, match=r"truth_point\.csv") as caught:
        read_truth(tmp_path, {}, np.arange(3.0), "hand", (), {"point": POINT})
    assert words in str(caught.value)


def test_a_data_set_brings_the_truth_of_its_map(tmp_path: Path) -> None:
    spin = Path(__file__).parents[2] / "experiments" / "principal_spin.toml"
    folder = str(tmp_path / "pass")
    with pytest.raises(SystemExit, match="0"):
        main(["simulate", str(spin), "--set", "time.epochs=5", "-o", folder])
    rows = rows_of(tmp_path / "pass" / "truth_point.csv")
    assert list(rows[0]) == ["id", "x_m", "y_m", "z_m"]
    opened = open_dataset(tmp_path / "pass", ())
    truth = opened.recording.truth
    assert truth is not None
    assert len(rows) == 20 == len([n for n in truth.values if n.startswith("point[")])
    for line in rows:
        X = [float(line[c]) for c in ("x_m", "y_m", "z_m")]
        assert truth.values[f"point[{line['id']}]"][0].tolist() == X
