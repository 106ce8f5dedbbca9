"""Results files: round trip, other programs, damage."""

import csv
import resource
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray

from relnav_graph.core.catalogue import GYRO_BIAS, INERTIA, RELATIVE_ATTITUDE, RELATIVE_POSITION_T
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.netcdf import Group, write_groups
from relnav_graph.io.results import read_results, write_results
from relnav_graph.io.track_tables import write_csv

LAYOUT = Layout([RELATIVE_POSITION_T, RELATIVE_ATTITUDE, INERTIA])
ATTRIBUTES = {"scenario": "starry_night", "title": "x_0 · π", "empty": ""}


def make_track(name: str = "batch", epochs: int = 20, seed: int = 0) -> Track:
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(epochs, LAYOUT.dim))
    x = np.array([LAYOUT.retract(LAYOUT.identity, row) for row in d])
    half = rng.normal(size=(epochs, LAYOUT.dim, LAYOUT.dim))
    t = np.cumsum(rng.uniform(0, 1, epochs))
    return Track(name, "smoothed", LAYOUT, t, x, half @ half.transpose(0, 2, 1), runtime_s=1.25)


def make_online() -> Track:
    return replace(
        make_track("incremental"),
        kind="filtered",
        status="degraded",
        message="NEES out of bounds: 3.1",
        step_s=np.linspace(1e-3, 2e-3, 20),
        rejected={"camera": 3, "range": 0},
        smoothed=make_track("incremental_smoothed", seed=1),
    )


def make_truth(track: Track) -> Truth:
    values = {b.name: track.value(b.name).copy() for b in LAYOUT}
    values["relative_position"][3] = np.nan
    values["gyro_bias"] = np.ones((len(track.t), 3))
    return Truth(track.t, values, "motion capture")


def assert_same(got: Track, want: Track) -> None:
    assert got.layout == want.layout
    for key in ("name", "kind", "status", "message", "runtime_s", "rejected"):
        assert getattr(got, key) == getattr(want, key)
    np.testing.assert_array_equal(got.t, want.t)
    np.testing.assert_array_equal(got.P, want.P)
    np.testing.assert_allclose(got.x, want.x, rtol=0, atol=1e-12)
    for a, b in ((got.step_s, want.step_s),):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            np.testing.assert_array_equal(a, b)
    assert (got.smoothed is None) == (want.smoothed is None)
    if got.smoothed is not None and want.smoothed is not None:
        assert_same(got.smoothed, want.smoothed)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    track = make_track()
    file = tmp_path / "results.nc"
    write_results(file, [track, make_online()], make_truth(track), ATTRIBUTES, [GYRO_BIAS])
    return file


def test_round_trip(path: Path) -> None:
    tracks, truth, attributes = read_results(path)
    assert attributes == ATTRIBUTES
    for got, want in zip(tracks, [make_track(), make_online()], strict=True):
        assert_same(got, want)
    want_truth = make_truth(make_track())
    assert truth is not None
    assert truth.source == want_truth.source
    assert set(truth.values) == set(want_truth.values)
    for name, values in want_truth.values.items():
        np.testing.assert_allclose(truth.values[name], values, rtol=0, atol=1e-12)


def test_truth_without_a_definition_is_left_out(tmp_path: Path) -> None:
    track = make_track()
    write_results(tmp_path / "r.nc", [track], make_truth(track), {})
    _, truth, _ = read_results(tmp_path / "r.nc")
    assert truth is not None
    assert "gyro_bias" not in truth.values
    write_results(tmp_path / "r.nc", [], None, {})
    assert read_results(tmp_path / "r.nc") == ([], None, {})


def test_a_diverged_track_keeps_its_nan(tmp_path: Path) -> None:
    track = make_track()
    x, P = track.x.copy(), track.P.copy()
    x[5:], P[5:] = np.nan, np.nan
    write_results(tmp_path / "r.nc", [replace(track, x=x, P=P, status="diverged")], None, {})
    (got,), _, _ = read_results(tmp_path / "r.nc")
    np.testing.assert_array_equal(np.isnan(got.x), np.isnan(x))
    np.testing.assert_array_equal(got.P, P)


def test_opens_in_xarray_with_units_and_frames(path: Path) -> None:
    with xarray.open_dataset(path, group="batch", engine="h5netcdf") as data:
        track = make_track()
        assert data["time"].attrs["units"] == "s"
        np.testing.assert_array_equal(data["time"], track.t)
        attitude, position = data["relative_attitude"], data["relative_position"]
        assert attitude.dims == ("time", "relative_attitude_component")
        assert attitude.attrs["frame"] == "tc"
        assert "q_wxyz" in attitude.attrs["long_name"]
        assert (attitude[:, 0] >= 0).all()
        assert (position.attrs["units"], position.attrs["frame"]) == ("m", "t")
        covariance = data["covariance"]
        assert covariance.attrs["block_order"].split() == [b.name for b in LAYOUT]
        assert len(covariance.attrs["state_names"].split()) == LAYOUT.dim == covariance.shape[1]
        assert data.attrs["kind"] == "smoothed"
    with xarray.open_dataset(path, group="incremental_smoothed", engine="h5netcdf") as data:
        assert data.sizes == {**data.sizes, "time": 20, "state": LAYOUT.dim}


def test_only_types_that_netcdf_knows(path: Path) -> None:
    def check(name: str, item: h5py.Dataset | h5py.Group) -> None:
        if isinstance(item, h5py.Dataset) and name.split("/")[-1] not in ("state", "state_2"):
            assert item.dtype.kind == "f"
        for value in item.attrs.values():
            assert np.asarray(value).dtype.kind in "fiuSOUV"
            assert not isinstance(value, (bool, complex, h5py.Empty))

    with h5py.File(path, "r") as file:
        file.visititems(check)
        assert not file.attrs.get("_Unsupported")


def test_a_flipped_bit_is_noticed(path: Path, tmp_path: Path) -> None:
    data, rng = path.read_bytes(), np.random.default_rng(2)
    want, refused = make_track(), 0
    for at in rng.integers(0, len(data), 40):
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        (tmp_path / "damaged.nc").write_bytes(damaged)
        try:
            tracks, _, _ = read_results(tmp_path / "damaged.nc")
        except InputError:
            refused += 1
        else:  # the bit was in a gap between the structures of the file
            assert_same(tracks[0], want)
    assert refused > 20


@pytest.mark.parametrize("part", [0.0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(path: Path, part: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(InputError, match=r"results\.nc: not a readable file"):
        read_results(path)


def test_other_files_and_versions_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_results(tmp_path / "none.nc")
    xarray.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="not a file of relnav-graph results"):
        read_results(tmp_path / "other.nc")
    write_groups(tmp_path / "next.nc", "relnav-graph results", 2, {"": Group({})})
    with pytest.raises(InputError, match="found format version 2, expected 1"):
        read_results(tmp_path / "next.nc")


def test_a_changed_number_is_refused(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["batch/covariance"][3, 0, 0] *= 1 + 1e-15
    with pytest.raises(InputError, match="damaged or changed"):
        read_results(path)


def test_names_that_clash_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "r.nc"
    online = make_online()
    for tracks in ([make_track(), make_track()], [online, online.smoothed or online]):
        with pytest.raises(InputError, match="taken"):
            write_results(file, tracks, None, {})
    for name in ("truth", "a/b", ""):
        with pytest.raises(InputError, match="cannot be called"):
            write_results(file, [make_track(name)], None, {})
    with pytest.raises(InputError, match="'tracks' is the format's own"):
        write_results(file, [], None, {"tracks": "mine"})
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_what_was_there(path: Path) -> None:
    before = path.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8000, hard))
    try:
        with pytest.raises(InputError, match=r"results\.nc: cannot be written: File too large"):
            write_results(path, [make_track(seed=3)], None, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["results.nc"]


def test_csv_has_units_and_sigmas(tmp_path: Path) -> None:
    online = make_online()
    write_csv(tmp_path / "tables", [make_track(), online])
    names = sorted(p.name for p in (tmp_path / "tables").iterdir())
    assert names == ["batch.csv", "incremental.csv", "incremental_smoothed.csv"]
    with (tmp_path / "tables" / "incremental.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0])[:4] == [
        "t_s",
        "relative_position_x_m",
        "relative_position_y_m",
        "relative_position_z_m",
    ]
    assert float(rows[7]["relative_position_y_m"]) == online.value("relative_position")[7, 1]
    rows_of = LAYOUT.tangent("relative_attitude")
    want = np.sqrt(online.P[7, rows_of, rows_of][2, 2])
    assert float(rows[7]["sigma_relative_attitude_z_rad"]) == want
    assert "inertia_parameters_1_1" in rows[0]
