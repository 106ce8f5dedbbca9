"""The reader of STAR-loc runs: tags in a stereo camera, a gyro on a clock of its own, capture."""

from __future__ import annotations

import csv
import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, recorded, relnav

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.io.readers import read_raw
from relnav_graph.maths import so3

RUN, LATER = "walk_s9", 1.25
R_CS = so3.exp(np.array([0.2, -1.3, 0.7]))
PLACE_C = np.array([0.1, -0.2, 0.05])
#: R_s,imu of files whose camera and IMU have the same axes.
OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
RATE_C = np.array([0.1, -0.2, 0.3])
TAGS = {7: [1.0, 2.0, 3.0], 9: [4.0, 5.0, 6.0], 8: [7.0, 8.0, 9.0]}


def pose(t: float) -> tuple[Array, Array]:
    """R_tc and r_tc_t, m, at t, s."""
    return so3.exp(RATE_C * t), np.array([np.sin(t), np.cos(2 * t), 0.3 * t])


def scalar_last(R: Array) -> list[float]:
    q = so3.quaternion(np.ascontiguousarray(R))
    return [*q[1:].tolist(), float(q[0])]


def tables() -> dict[str, list[dict[str, Any]]]:
    frames, imu = [], []
    for k in range(40):
        t = 0.1 * k
        R, r = pose(t)
        camera = r + R @ PLACE_C
        for tag in (7, 8) if k % 2 else (9,):
            x, y, z, w = scalar_last(R)
            a, b, c, d = scalar_last((R @ R_CS).T)
            frames.append(
                {"time_s": t, "apriltag_id": tag, "left_u": 100 + tag, "left_v": k}
                | {"right_u": 90 + tag, "right_v": k, "x": r[0], "y": r[1], "z": r[2]}
                | {"rot_x": x, "rot_y": y, "rot_z": z, "w": w}
                | {"cam_x": camera[0], "cam_y": camera[1], "cam_z": camera[2]}
                | {"cam_rot_x": a, "cam_rot_y": b, "cam_rot_z": c, "cam_w": d}
                | {"gt_left_u": 1.0}
            )
    w_imu = (R_CS @ OPTICAL).T @ RATE_C
    for k in range(900):
        t = 0.005 * k - 0.1
        R, r = pose(t)
        x, y, z, w = scalar_last(R)
        imu.append(
            {"time_s": t + LATER, "angular_velocity_x": w_imu[0], "angular_velocity_y": w_imu[1]}
            | {"angular_velocity_z": w_imu[2], "x": r[0], "y": r[1], "z": r[2]}
            | {"w": w, "rot_x": x, "rot_y": y, "rot_z": z}
        )
    places = [
        {"id": n, "x": p[0], "y": p[1], "z": p[2], "april_id": tag}
        for n, (tag, p) in enumerate(TAGS.items(), 1)
    ]
    return {"apriltag_cal_global": frames, "imu": imu, "environment_v4": places}


def write(folder: Path, change: Callable[[dict[str, Any]], None] = lambda found: None) -> Path:
    """A folder with one run; change: what is done to its tables first."""
    found: dict[str, Any] = {
        **tables(),
        "calib": {"fu": 500.0, "fv": 510.0, "cu": 320.0, "cv": 240.0, "b": 0.12}
        | {"tf_cam_imu": {"rot_x": 0.0, "rot_y": 0.0, "rot_z": 0.0, "w": 1.0}},
        "params": [{"name": RUN, "landmarks": "v4"}],
    }
    change(found)
    (folder / RUN).mkdir(parents=True, exist_ok=True)
    for name in ("apriltag_cal_global", "imu", "environment_v4"):
        inside = folder if name.startswith("env") else folder / RUN
        path = inside / (f"{name}.csv" if name.startswith("env") else f"{name}.csv.gz")
        opened = gzip.open if path.suffix == ".gz" else open
        with opened(path, "wt", newline="") as stream:
            rows = csv.DictWriter(stream, list(found[name][0]))
            rows.writeheader()
            rows.writerows(found[name])
    (folder / RUN / "calib.json").write_text(json.dumps(found["calib"]))
    (folder / "dataset_params.json").write_text(json.dumps(found["params"]))
    return folder


def read(folder: Path, **options: Any) -> Any:
    return read_raw("starloc", folder, {"run": RUN, **options})


def test_frames_poses_and_mounting(tmp_path: Path) -> None:
    recording = read(write(tmp_path))
    assert recording.truth is not None
    assert len(recording.times) == len(recording.truth.t) == 40
    for k in (0, 17, 39):
        R, r = pose(0.1 * k)
        np.testing.assert_allclose(recording.truth.values["relative_attitude"][k], R, atol=1e-7)
        np.testing.assert_allclose(recording.truth.values["relative_position"][k], r, atol=1e-12)
    camera = recording.settings["sensors"]["camera"]
    np.testing.assert_allclose(camera["sensor_attitude"], R_CS, atol=1e-7)
    np.testing.assert_allclose(camera["sensor_position"], PLACE_C, atol=1e-12)
    np.testing.assert_allclose(camera["points"], list(TAGS.values()))
    assert camera["baseline"] == 0.12
    one, two = recording.measurements[:2]
    assert one.ids.tolist() == [1]
    assert two.ids.tolist() == [0, 2]
    np.testing.assert_allclose(two.z, [[107, 1, 97, 1], [108, 1, 98, 1]])


def test_gyro_is_turned_and_put_on_the_clock_of_the_frames(tmp_path: Path) -> None:
    gyro = read(write(tmp_path)).inputs["gyro"]
    assert gyro.t_start[0] == pytest.approx(-0.1, abs=1e-3)
    np.testing.assert_allclose(gyro.values, np.tile(RATE_C, (899, 1)), atol=1e-7)
    turned = read(tmp_path, imu_attitude=["0 deg", "0 deg", "0 deg"]).inputs["gyro"]
    np.testing.assert_allclose(turned.values[0], (R_CS @ OPTICAL).T @ RATE_C, atol=1e-7)


def test_tags_that_are_one_for_the_other_and_a_later_beginning(tmp_path: Path) -> None:
    found = read(write(tmp_path), swapped={"v4": [[7, 8]], "v1": [[1, 2]]}, begin=0.25)
    assert found.measurements[0].t == pytest.approx(0.3)
    assert found.measurements[0].ids.tolist() == [2, 0]
    for wrong in ({"v4": [[7, 10]]}, {"v4": [[7]]}, [7, 8]):
        with pytest.raises(InputError, match=r"data\.options\.swapped: found"):
            read(tmp_path, swapped=wrong)


def test_a_capture_that_lost_the_rig_is_no_truth(tmp_path: Path, caplog: Any) -> None:
    def held(found: dict[str, Any]) -> None:
        rows = found["apriltag_cal_global"]
        x, y, z, w = scalar_last(pose(2.0)[0] @ so3.exp(np.array([0.0, 0.0, 0.2])))
        for row in rows:
            if 1.95 < row["time_s"] < 2.15:
                row |= {"rot_x": x, "rot_y": y, "rot_z": z, "w": w}

    recording = read(write(tmp_path, held))
    unknown = np.isnan(recording.truth.values["relative_position"]).all(axis=1)
    np.testing.assert_array_equal(
        unknown, np.isnan(recording.truth.values["relative_attitude"]).any(axis=(1, 2))
    )
    lost = recording.times[unknown]
    assert 0 < len(lost) < 10
    assert 1.6 < lost.min() < lost.max() < 2.5
    assert "turns otherwise than the gyro and is no truth" in caplog.text


def first(name: str, **values: Any) -> Callable[[dict[str, Any]], None]:
    """Change the third row, on line 4, of a table."""
    return lambda found: found[name][2].update(values)


def without_pixels(found: dict[str, Any]) -> None:
    for row in found["apriltag_cal_global"]:
        del row["left_u"]


def elsewhere(found: dict[str, Any]) -> None:
    for row in found["imu"]:
        row["x"] += 9.0


BAD: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "tag": (first("apriltag_cal_global", apriltag_id=99), r"line 4: found tag 99, which .*_v4"),
    "nan": (first("imu", x="nan"), r"imu\.csv\.gz, line 4: found a number that is not finite"),
    "word": (first("imu", x="none"), r"imu\.csv\.gz, line 4: could not convert"),
    "time": (first("imu", time_s=-9.0), "line 4: found a time before that of the row before"),
    "quaternion": (
        first("apriltag_cal_global", w=3.0),
        "line 4: found the quaternion .*, expected one of length 1",
    ),
    "twice": (lambda found: found["environment_v4"][2].update(april_id=7), "tag 7 a second time"),
    "run": (lambda found: found["params"].clear(), f"found 0 runs '{RUN}', expected one"),
    "number": (lambda found: found["calib"].update(fu="wide"), "fu: found 'wide', expected a num"),
    "column": (
        without_pixels,
        "line 1: found 0 columns 'left_u'",
    ),
    "other": (
        elsewhere,
        r"found captured places .* m from those of the frames at best",
    ),
}


@pytest.mark.parametrize("fault", BAD)
def test_what_is_wrong_is_refused_by_file_and_line(tmp_path: Path, fault: str) -> None:
    change, message = BAD[fault]
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, change))


def test_a_run_that_is_none(tmp_path: Path) -> None:
    write(tmp_path)
    for run in ("", "other"):
        with pytest.raises(InputError, match=f"found '{run}', expected one of {RUN}"):
            read_raw("starloc", tmp_path, {"run": run})


@pytest.fixture
def real() -> Path:
    return recorded("starloc")


@pytest.mark.parametrize(("run", "most"), [("eight_s2", 0.055), ("loop-2d_s1", 0.045)])
def test_real_runs_with_the_mounting_found_on_one_of_them(
    real: Path, run: str, most: float, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["compare", EXPERIMENTS / "starloc.toml", "--data", real, "-e", "rts", "--json"]
    code, out, err = relnav(capsys, *arguments, "--set", f"data.options.run={run}")
    assert code == 0, err
    row = json.loads(out)["estimators"]["rts"]
    assert row["status"] == "ok"
    assert row["states"]["relative_position"]["rmse"] < most
    assert row["states"]["relative_attitude"]["rmse"] < 1.1
    assert row["anees"] < 2.0
