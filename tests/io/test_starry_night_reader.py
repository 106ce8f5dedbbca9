"""The reader of Starry Night data: its conventions, proved by reprojection and by rates."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import recorded
from scipy.io import loadmat, savemat

from relnav_graph.arrays import Array
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.readers import read_raw, readers
from relnav_graph.maths import so3

FRAMES, POINTS = 40, 7


def make_file() -> dict[str, Any]:
    """A pass as such a file has it, with Barfoot's formulas written out here."""
    rng = np.random.default_rng(1)
    t = 100.0 + np.cumsum(rng.uniform(0.04, 0.08, FRAMES))
    s = t - t[0]
    theta = np.stack([0.4 * np.sin(s) + 1.2, 0.3 * np.cos(1.3 * s), 0.8 - 0.2 * s])
    r_i = np.stack([0.2 * np.sin(s), 0.1 * s, 2 + 0.1 * np.cos(s)])
    rho = rng.uniform(-0.5, 0.5, (3, POINTS))
    C_c_v = barfoot(np.array([1.1, -0.4, 0.9]))
    rho_v_c_v = np.array([[0.02], [0.1], [-0.03]])
    fu, fv, cu, cv, b = 480.0, 470.0, 320.0, 240.0, 0.24
    y = np.full((4, FRAMES, POINTS), -1.0)
    w, v = np.empty((3, FRAMES)), np.empty((3, FRAMES))
    h = 1e-6
    for k in range(FRAMES):
        C_vi = barfoot(theta[:, k])
        p_c = C_c_v @ (C_vi @ (rho - r_i[:, k : k + 1]) - rho_v_c_v)
        x, yy, z = p_c
        pixels = np.stack(
            [fu * x / z + cu, fv * yy / z + cv, fu * (x - b) / z + cu, fv * yy / z + cv]
        )
        seen = (z > 0.1) & (rng.random(POINTS) < 0.7) & (k % 9 != 4)
        y[:, k, seen] = pixels[:, seen]
        dtheta = np.array([0.4 * np.cos(s[k]), -0.39 * np.sin(1.3 * s[k]), -0.2])
        rate = (barfoot(theta[:, k] + h * dtheta) - barfoot(theta[:, k] - h * dtheta)) / (2 * h)
        cross = -rate @ C_vi.T  # dC/dt = -w^x C (Barfoot 2017, eq. 6.45)
        w[:, k] = cross[2, 1], cross[0, 2], cross[1, 0]
        v[:, k] = C_vi @ [0.2 * np.cos(s[k]), 0.1, -0.1 * np.sin(s[k])]
    return {
        "t": t[None, :],
        "theta_vk_i": theta,
        "r_i_vk_i": r_i,
        "w_vk_vk_i": w,
        "v_vk_vk_i": v,
        "rho_i_pj_i": rho,
        "y_k_j": y,
        "C_c_v": C_c_v,
        "rho_v_c_v": rho_v_c_v,
        "w_var": np.array([[0.01], [0.02], [0.04]]),
        "v_var": np.array([[1e-4], [2e-4], [4e-4]]),
        "y_var": np.array([[1.0], [4.0], [9.0], [16.0]]),
        "fu": fu,
        "fv": fv,
        "cu": cu,
        "cv": cv,
        "b": b,
    }


def barfoot(phi: Array) -> Array:
    """C = cos(a) I + (1 - cos(a)) n n^T - sin(a) n^x (Barfoot 2017)."""
    a = float(np.linalg.norm(phi))
    n = phi / a
    cross = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    matrix: Array = np.cos(a) * np.eye(3) + (1 - np.cos(a)) * np.outer(n, n) - np.sin(a) * cross
    return matrix


def write(folder: Path, **changes: Any) -> Path:
    savemat(
        folder / "pass.mat", {k: v for k, v in (make_file() | changes).items() if v is not None}
    )
    return folder


def residuals(recording: Recording, sensor: str = "camera") -> Array:
    """Measured minus predicted pixels at the truth, (n, 4), by the model of a stereo camera."""
    camera = recording.settings["sensors"][sensor]
    points, R_cs = np.array(camera["points"]), np.array(camera["sensor_attitude"])
    assert recording.truth is not None
    found = []
    for m in recording.measurements:
        k = int(np.searchsorted(recording.truth.t, m.t))
        R_tc = recording.truth.values["relative_attitude"][k]
        r_tc_t = recording.truth.values["relative_position"][k]
        p_c = (points[m.ids] - r_tc_t) @ R_tc - camera["sensor_position"]
        x, y, z = (p_c @ R_cs).T
        ul, vl = camera["fu"] * x / z + camera["cu"], camera["fv"] * y / z + camera["cv"]
        ur = camera["fu"] * (x - camera["baseline"]) / z + camera["cu"]
        found.append(m.z - np.stack([ul, vl, ur, vl], axis=1))
    return np.concatenate(found)


def rate_errors(recording: Recording) -> Array:
    """Gyro minus the mean rate of the true attitude over each interval, (n, 3), rad/s."""
    assert recording.truth is not None
    R_tc, gyro = recording.truth.values["relative_attitude"], recording.inputs["gyro"]
    turned = np.array([so3.log(a.T @ b) for a, b in pairwise(R_tc)])
    errors: Array = gyro.values - turned / (gyro.t_end - gyro.t_start)[:, None]
    return errors


def test_conventions_agree_with_barfoot(tmp_path: Path) -> None:
    recording = read_raw("starry_night", write(tmp_path))
    assert np.abs(residuals(recording)).max() < 1e-9
    assert np.abs(rate_errors(recording)).max() < 2e-3  # trapezium rule at 0.08 s
    assert recording.truth is not None
    velocity = recording.inputs["velocity"]
    R_tc, r_tc_t = (recording.truth.values[n] for n in ("relative_attitude", "relative_position"))
    moved = np.diff(r_tc_t, axis=0) / np.diff(recording.times)[:, None]
    held = np.einsum("kij,kj->ki", R_tc[:-1], velocity.values)
    assert np.abs(moved - held).max() < 0.02  # held over 0.08 s at 0.2 m/s^2


def test_what_the_recording_holds(tmp_path: Path) -> None:
    raw = make_file()
    recording = read_raw("starry_night", write(tmp_path), {"sensor": "stereo"})
    seen = (raw["y_k_j"] != -1).all(axis=0)
    assert recording.times[0] == 0
    assert len(recording.times) == FRAMES
    assert len(recording.measurements) == seen.any(axis=1).sum() < FRAMES
    assert sum(len(m.z) for m in recording.measurements) == seen.sum()
    m = recording.measurements[3]
    k = int(np.argmin(np.abs(recording.times - m.t)))
    np.testing.assert_array_equal(m.ids, np.nonzero(seen[k])[0])
    np.testing.assert_array_equal(m.z, raw["y_k_j"][:, k, m.ids].T)
    assert m.sensor == "stereo"
    gyro = recording.inputs["gyro"]
    np.testing.assert_array_equal(gyro.t_start, recording.times[:-1])
    np.testing.assert_array_equal(gyro.t_end, recording.times[1:])
    np.testing.assert_allclose(gyro.values[5], raw["w_vk_vk_i"][:, 5:7].mean(axis=1), atol=1e-15)
    np.testing.assert_array_equal(recording.inputs["velocity"].values[5], raw["v_vk_vk_i"][:, 5])
    camera = recording.settings["sensors"]["stereo"]
    assert camera["pixel_sigma"] == [1, 2, 3, 4]
    assert camera["baseline"] == 0.24
    np.testing.assert_array_equal(np.array(camera["sensor_attitude"]).T, raw["C_c_v"])


def test_a_range_of_frames_and_turned_arrays(tmp_path: Path) -> None:
    whole = read_raw("starry_night", write(tmp_path))
    raw = make_file()
    turned = {
        "t": raw["t"].T,
        "theta_vk_i": raw["theta_vk_i"].T,
        "rho_i_pj_i": raw["rho_i_pj_i"].T,
        "y_k_j": raw["y_k_j"].transpose(2, 1, 0),
    }
    part = read_raw("starry_night", write(tmp_path, **turned), {"frames": [11, 30]})
    np.testing.assert_allclose(part.times, whole.times[10:30] - whole.times[10], atol=1e-13)
    assert np.abs(residuals(part)).max() < 1e-9
    np.testing.assert_array_equal(part.inputs["gyro"].values, whole.inputs["gyro"].values[10:29])


def test_one_point_only(tmp_path: Path) -> None:
    raw = make_file()
    one = {"rho_i_pj_i": raw["rho_i_pj_i"][:, :1], "y_k_j": raw["y_k_j"][:, :, 0]}
    recording = read_raw("starry_night", write(tmp_path, **one))
    assert {tuple(m.ids) for m in recording.measurements} == {(0,)}
    assert np.abs(residuals(recording)).max() < 1e-9


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "missing": ({"y_var": None}, "no variable 'y_var'; found C_c_v, b"),
    "not finite": ({"fu": np.nan}, r"'fu': element \(1, 1\) is nan"),
    "text": ({"w_vk_vk_i": "none"}, "'w_vk_vk_i': found <U4, expected real numbers"),
    "complex": ({"r_i_vk_i": 1j * np.ones((3, FRAMES))}, "expected real numbers"),
    "shape": ({"r_i_vk_i": np.ones((3, FRAMES - 1))}, r"found shape \(3, 39\), expected \(3, 40\)"),
    "not a number": ({"cu": [1.0, 2.0]}, "'cu': found 2 numbers, not one"),
    "time": ({"t": np.ones((1, FRAMES))}, "'t': does not increase at frame 2"),
    "variance": ({"y_var": [1.0, 0.0, 1.0, 1.0]}, r"'y_var': found .*, expected 4"),
    "mounting": ({"C_c_v": 2 * np.eye(3)}, "'C_c_v': not a rotation"),
    "degrees": ({"theta_vk_i": 50 * np.ones((3, FRAMES))}, "is it in degrees"),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_wrong_variable_is_named(tmp_path: Path, fault: str) -> None:
    changes, message = BAD[fault]
    with pytest.raises(InputError, match=message):
        read_raw("starry_night", write(tmp_path, **changes))


def test_wrong_folders_files_and_options(tmp_path: Path) -> None:
    assert readers()["starry_night"] == "relnav_graph.io.readers.starry_night"
    with pytest.raises(InputError, match=r"'rosbag'; known are .*starry_night"):
        read_raw("rosbag", tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        read_raw("starry_night", tmp_path / "none")
    with pytest.raises(InputError, match=r"found 0 files \*\.mat, expected one"):
        read_raw("starry_night", tmp_path)
    write(tmp_path)
    with pytest.raises(InputError, match="unknown option 'frame'; known are"):
        read_raw("starry_night", tmp_path, {"frame": 1})
    for frames in ([0, 5], [5, 5], [1, FRAMES + 1], [1], 7, "ab", [1.5, 3]):
        with pytest.raises(InputError, match=r"expected \[first, last\] within 1 to 40"):
            read_raw("starry_night", tmp_path, {"frames": frames})
    data = (tmp_path / "pass.mat").read_bytes()
    for damaged in (data[:4000], data[:100], b"", b"not a file of MATLAB" * 40):
        (tmp_path / "pass.mat").write_bytes(damaged)
        with pytest.raises(InputError, match=r"pass\.mat"):
            read_raw("starry_night", tmp_path)
    (tmp_path / "second.mat").touch()
    with pytest.raises(InputError, match="found 2 files"):
        read_raw("starry_night", tmp_path)


@pytest.fixture
def real() -> Path:
    return recorded("starry_night")


def test_conventions_agree_with_the_real_data(real: Path) -> None:
    recording = read_raw("starry_night", real)
    errors = residuals(recording)
    sigma = recording.settings["sensors"]["camera"]["pixel_sigma"]
    # The file's own variances describe the residuals of its own truth.
    np.testing.assert_allclose(errors.std(axis=0), sigma, rtol=0.25)
    assert (np.abs(errors.mean(axis=0)) < 0.25 * np.array(sigma)).all()
    # A wrong sense of rotation is as far from the gyro as the rate itself is large.
    rates = rate_errors(recording)
    assert (np.median(np.abs(rates), axis=0) < [0.03, 0.04, 0.1]).all()
    assert recording.truth is not None
    R_tc = recording.truth.values["relative_attitude"]
    moved = np.diff(recording.truth.values["relative_position"], axis=0)
    moved /= np.diff(recording.times)[:, None]
    velocity = np.einsum("kji,kj->ki", R_tc[:-1], moved)
    assert np.median(np.abs(velocity - recording.inputs["velocity"].values)) < 0.02


def test_any_range_of_the_real_frames(real: Path) -> None:
    count = loadmat(next(real.glob("*.mat")), variable_names=["t"])["t"].size
    part = read_raw("starry_night", real, {"frames": [count // 2, count]})
    assert len(part.times) == count - count // 2 + 1
    assert part.times[0] == 0
    assert len(residuals(part))
