"""Any table by a mapping: texts, .mat of both versions, .npz; units, attitudes, stamps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from pose_tracks import rotations
from relnav_factors.sensors.pose_measurement import PoseMeasurement
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from relnav_graph.core.catalogue import INERTIA, RELATIVE_ATTITUDE, RELATIVE_POSITION_T
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.known import Known
from relnav_graph.io.readers import read_raw
from relnav_graph.maths.instants import Instant

RNG = np.random.default_rng(0)
N = 5
NS = 1403636579763555584 + 100_000_001 * np.arange(N)
R, PLACES, SPINS = rotations(N, RNG), RNG.normal(size=(N, 3)), RNG.normal(size=(N, 3))
XYZW = Rotation.from_matrix(R).as_quat()
MRP = Rotation.from_matrix(R).as_mrp()
ARRAYS = {"t": NS, "r": PLACES / 1e3, "q": XYZW, "sigma_BN": MRP, "w": np.rad2deg(SPINS)}
ARRAYS["BN"] = R.transpose(0, 2, 1)
UNIX = {"column": "t", "unit": "ns", "clock": "unix"}
POSITION = {"columns": "r", "unit": "km"}
SENSOR = PoseMeasurement(position_sigma=np.ones(3), attitude_sigma=np.ones(3))
KNOWN = Known(
    sensors={"board": SENSOR},
    inputs={"gyro": ("wx_rad_s", "wy_rad_s", "wz_rad_s")},
    blocks={b.name: b for b in (RELATIVE_ATTITUDE, RELATIVE_POSITION_T)},
)
ALL: dict[str, Any] = {
    "time": UNIX,
    "sensors": {"board": {**POSITION, "quaternion": "q", "order": "xyzw"}},
    "inputs": {"gyro": {"columns": "w", "unit": "deg/s", "samples": "instant"}},
    "truth": {"relative_position": POSITION, "relative_attitude": {"mrp": "sigma_BN"}},
}


def npz(folder: Path, **changes: Any) -> Path:
    np.savez(folder / "pass.npz", **(ARRAYS | changes))
    return folder / "pass.npz"


def mat5(folder: Path) -> Path:
    savemat(folder / "pass.mat", {"sim": {k: v for k, v in ARRAYS.items() if k != "t"}, "t": NS})
    return folder / "pass.mat"


def mat73(folder: Path) -> Path:
    """HDF5 as MATLAB writes it: below 512 bytes of its own, the axes of arrays reversed."""
    with h5py.File(folder / "pass.mat", "w", userblock_size=512) as file:
        for name, array in ARRAYS.items():
            own = array[:, None] if array.ndim == 1 else array
            file["t" if name == "t" else f"sim/{name}"] = own.T
    with (folder / "pass.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    return folder / "pass.mat"


def csv(folder: Path) -> Path:
    names = ["t", *(f"r{i}" for i in range(3)), *(f"q{i}" for i in range(4))]
    names += [f"s{i}" for i in range(3)] + [f"w{i}" for i in range(3)]
    table = np.hstack([ARRAYS["r"], XYZW, MRP, ARRAYS["w"]])
    rows = [",".join([str(t), *map(repr, r.tolist())]) for t, r in zip(NS, table, strict=True)]
    path = folder / "pass.csv"
    path.write_bytes(("\ufeff" + "\r\n".join([",".join(names), *rows]) + "\r\n").encode())
    return path


def named(found: Any, **names: Any) -> Any:
    """The mapping with other names of columns."""
    if isinstance(found, dict):
        return {k: named(v, **names) for k, v in found.items()}
    return names.get(found, found) if isinstance(found, str) else found


IN_MAT = named(ALL, r="sim.r", q="sim.q", w="sim.w", sigma_BN="sim.sigma_BN")
IN_CSV = named(
    ALL,
    r=["r0", "r1", "r2"],
    q=["q0", "q1", "q2", "q3"],
    w=["w0", "w1", "w2"],
    sigma_BN=["s0", "s1", "s2"],
)


@pytest.mark.parametrize(
    ("make", "options"), [(npz, ALL), (mat5, IN_MAT), (mat73, IN_MAT), (csv, IN_CSV)]
)
def test_a_pass_of_every_kind_of_file(tmp_path: Path, make: Any, options: Any) -> None:
    make(tmp_path)
    found = read_raw("table", tmp_path, options, KNOWN)
    t = (NS - 1403636579 * 10**9) / 1e9
    assert found.times.tolist() == t.tolist()
    assert found.epoch == Instant.parse("2014-06-24T19:02:59 UTC")
    z = np.vstack([m.z for m in found.measurements])
    np.testing.assert_allclose(z[:, :3], PLACES, rtol=1e-14)
    q = Rotation.from_matrix(R).as_quat(canonical=True)
    np.testing.assert_allclose(z[:, 3:], q[:, [3, 0, 1, 2]], atol=1e-14)
    assert found.truth is not None
    np.testing.assert_allclose(found.truth.values["relative_attitude"], R, atol=1e-14)
    gyro = found.inputs["gyro"]
    np.testing.assert_allclose(gyro.values, 0.5 * (SPINS[1:] + SPINS[:-1]), rtol=1e-13)
    assert gyro.t_end.tolist() == t[1:].tolist()


def truth(path: Path, name: str, table: dict[str, Any], **more: Any) -> Any:
    options = {"time": UNIX, "truth": {name: table}} | more
    found: Recording = read_raw("table", path, options)
    assert found.truth is not None
    return found.truth.values[name]


def test_indices_matrices_inverses_and_transposed_arrays(tmp_path: Path) -> None:
    path = npz(tmp_path, r_T=PLACES.T, flat=R.reshape(N, 9))
    one = truth(path, "r", {"columns": ["r[2]", "w[0]"], "unit": ["km", "deg/s"]})
    np.testing.assert_allclose(one, np.column_stack([PLACES[:, 2], SPINS[:, 0]]), rtol=1e-13)
    # [BN] takes N to B: the inverse of R_nb.
    for table in ({"matrix": "BN", "inverse": True}, {"matrix": "flat"}):
        np.testing.assert_allclose(truth(path, "R", table), R, atol=1e-14)
    turned = truth(path, "r", {"columns": "r_T", "unit": "m", "transpose": True})
    np.testing.assert_array_equal(turned, PLACES)


@pytest.mark.parametrize(
    ("stamps", "time", "first", "step"),
    [
        (["1626480000.1", "1626480000.2000000001"], {"unit": "s", "clock": "unix"}, 0.1, 0.1),
        (["1310515218250", "1310515218750"], {"unit": "ms", "clock": "gps"}, 0.25, 0.5),
        (["2021-07-17T00:00:00.25", "2021-07-17T00:00:01"], {"calendar": "UTC"}, 0.25, 0.75),
        (["17 Jul 2021 00:00:00.250", "17 Jul 2021 00:00:01.000"], {"calendar": "UTC"}, 0.25, 0.75),
        (
            ["29412.5", "29412.75"],
            {"calendar": "UTC", "unit": "days", "day_zero": 2430000},
            0,
            21600,
        ),
        (["59412", "59412.25"], {"calendar": "UTC", "unit": "days"}, 0.0, 21600),
    ],
)
def test_stamps_as_others_write_them(
    tmp_path: Path, stamps: list[str], time: dict[str, Any], first: float, step: float
) -> None:
    """All of them begin in the second of midnight of 2021-07-17, UTC."""
    path = tmp_path / "report.csv"
    path.write_text("when,x\n" + "".join(f"{s},1\n" for s in stamps))
    options = {"time": {"column": "when", **time}, "sensors": {"a": {"columns": "x", "unit": "m"}}}
    found = read_raw("table", path, options)
    begin = Instant.parse("2021-07-17T00:00:00 UTC")
    assert found.epoch == begin
    np.testing.assert_allclose(found.times, [first, first + step], rtol=0, atol=2e-10)


def test_a_text_of_blanks_without_a_header_and_rows_without_numbers(tmp_path: Path) -> None:
    path = tmp_path / "qn.42"  # of 42: x, y, z, w, from ECI to body
    rows = [" ".join(map(repr, [0.5 * k, *XYZW[k].tolist()])) for k in range(N)]
    rows[2] = "1.0 nan nan nan nan"
    path.write_text("% of a program\n" + "\n".join(rows) + "\n")
    table = {"quaternion": ["2", "3", "4", "5"], "order": "xyzw"}
    options = {"time": {"column": "1", "unit": "s", "clock": "none"}, "skip": 1, "header": False}
    with pytest.raises(InputError, match=r"qn\.42, line 4: .*not finite.*1 such rows.*\"skip\""):
        truth(path, "R", table, **options)
    found = read_raw(
        "table", path, {**options, "sensors": {"star": {**table, "missing": "skip", "id": 3}}}
    )
    assert [m.t for m in found.measurements] == [0.0, 0.5, 1.5, 2.0]
    assert {int(i) for m in found.measurements for i in m.ids} == {3}


def test_sigmas_are_covariances_of_a_sensor(tmp_path: Path) -> None:
    path = npz(tmp_path, s=np.full((N, 3), 0.5))
    table = {**POSITION, "sigma": "s", "sigma_unit": "cm"}
    found = read_raw("table", path, {"time": UNIX, "sensors": {"fix": table}})
    P = found.measurements[3].covariance
    assert P is not None
    np.testing.assert_allclose(P[0], 2.5e-5 * np.eye(3))


GYRO = {"columns": "w", "unit": "deg/s"}
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "nothing": ({}, "found nothing named, expected tables of sensors, inputs or truth"),
    "clock": ({"time": {"column": "t", "unit": "s"}, "inputs": {"gyro": GYRO}}, "neither of clock"),
    "unit of time": ({"time": {"column": "t", "clock": "unix"}, "inputs": {"g": GYRO}}, "found ''"),
    "column": (
        {"inputs": {"gyro": {"columns": "sigma_NB", "unit": "rad/s"}}},
        r"found no 'sigma_NB'; is 'sigma_BN' meant\?; there are t, r \(5, 3\), q",
    ),
    "index": (
        {"inputs": {"gyro": {"columns": "r[3]", "unit": "rad/s"}}},
        r"'r\[3\]' of an array",
    ),
    "no unit": (
        {"truth": {"relative_position": {"columns": "r"}}},
        "unit: found None, expected a unit such as 'm', or one for each of 3; '1' is that of numb",
    ),
    "other unit": (
        {"truth": {"relative_position": {"columns": "r", "unit": "km/s"}}},
        "truth.relative_position.unit: found unit 'km/s', expected one like 'm'",
    ),
    "input unit": (
        {"inputs": {"gyro": {"columns": "w", "unit": "m"}}},
        "expected one like 'rad/s'",
    ),
    "order": ({"truth": {"relative_attitude": {"quaternion": "q"}}}, "no order, expected wxyz or"),
    "key": ({"truth": {"r": {"column": "r"}}}, "unknown key 'column'; known are file, time, col"),
    "two": ({"truth": {"R": {"mrp": "sigma_BN", "matrix": "BN"}}}, "found mrp, matrix, expected"),
    "width": ({"truth": {"R": {"mrp": "q"}}}, "R.mrp: found 4 columns, expected 3"),
    "length": (
        {"inputs": {"g": {"columns": "short", "unit": "m"}}},
        r"'short' of \(4,\), expected 5",
    ),
    "transposed": ({"inputs": {"g": {"columns": "r_T", "unit": "m"}}}, "is transpose = true meant"),
    "nan": (
        {"inputs": {"g": {"columns": "bad", "unit": "m"}}},
        "row 1: found a number of 'g' that",
    ),
    "long": ({"truth": {"R": {"quaternion": "big", "order": "wxyz"}}}, "row 0: found the quatern"),
    "no columns": ({"sensors": {"board": {"mrp": "sigma_BN"}}}, "expected 3 columns"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_refused(tmp_path: Path, name: str) -> None:
    options, message = BAD[name]
    bad = np.where(np.arange(N) == 1, np.nan, 1.0)
    path = npz(tmp_path, short=np.ones(4), r_T=PLACES.T, bad=bad, big=2 * XYZW)
    with pytest.raises(InputError, match=message):
        read_raw("table", path, {"time": UNIX, **options}, KNOWN)


def test_numbers_without_a_unit_need_none(tmp_path: Path) -> None:
    """Where the scenario says that they have none; else nobody knows, and "1" says so."""
    known = Known(blocks={INERTIA.name: INERTIA})
    path, options = npz(tmp_path), {"columns": ["w[0]", "w[1]"]}
    given = {"time": UNIX, "truth": {INERTIA.name: options}}
    found = read_raw("table", path, given, known).truth
    assert found is not None
    np.testing.assert_array_equal(found.values[INERTIA.name], ARRAYS["w"][:, :2])
    with pytest.raises(InputError, match="found None, expected a unit, or one for each of 2; '1'"):
        read_raw("table", path, given)
    with pytest.raises(InputError, match="found unit 'm', expected one like '1'"):
        read_raw("table", path, given | {"truth": {INERTIA.name: options | {"unit": "m"}}}, known)


def test_objects_that_nobody_names_stay_unread(tmp_path: Path) -> None:
    """A recorder's settings beside its arrays; to read them may run code."""
    path = npz(tmp_path, settings=np.array({"rate": 10}, dtype=object))
    found = read_raw("table", path, {"time": UNIX, "truth": {"R": {"mrp": "sigma_BN"}}}, KNOWN)
    assert found.truth is not None
    assert found.truth.values["R"].shape == (N, 3, 3)
    with pytest.raises(InputError, match="'settings' is of type object, expected numbers"):
        read_raw("table", path, {"time": UNIX, "truth": {"R": {"mrp": "settings"}}}, KNOWN)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"t,x\n1,2\n2\n", "line 3: found 1 columns, expected 2: t, x"),
        ("a.csv", b"t,x\n1,2\n2,one\n", "line 3, column x: found 'one', expected a number"),
        ("a.csv", b"t,x\n2,2\n1,1\n", "line 3: found a time that is before the one before"),
        ("a.csv", b"t,t\n2,2\n", "line 1: found the column 't' twice"),
        ("a.npz", b"PK no zip", "not a readable .npz file"),
        ("a.mat", b"no mat at all", "not a readable .mat file"),
        ("a.mat", b"MATLAB 7.3 MAT-file", "not a readable .mat file"),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    options = {
        "time": {"column": "t", "unit": "s", "clock": "none"},
        "sensors": {"a": {"columns": "x", "unit": "m"}},
    }
    with pytest.raises(InputError, match=message):
        read_raw("table", tmp_path, options)
