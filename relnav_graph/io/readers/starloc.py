"""Reader of STAR-loc runs: a stereo camera that sees AprilTags, with a gyro and motion capture.

Laboratory data of the University of Toronto (Dümbgen, Shalaby, Cossette, Barfoot, Forbes, 2023,
arXiv:2309.05518): a folder for each run, ``apriltag_cal_global.csv``, ``imu.csv``, both packed or
not, and ``calib.json``; beside the runs the places of the tags, ``environment_vN.csv``, N by run in
``dataset_params.json``. The tags, fixed in the laboratory, play the target, so that t are the
laboratory's axes; the rig, whose pose is captured, is the chaser.

Quaternions of the files have their scalar last: of the rig they take its axes to t, of the camera
(``cam_*``) t to its own: x right, y down, z ahead. Both tables begin at zero of their own, and
bear the captured pose: where that is alike tells how much later the stamps of the IMU are. Columns
``gt_*`` are computed from the captured pose, and no measurements.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.io.packed import one_file, read_rows
from relnav_graph.io.poses import from_quaternions
from relnav_graph.maths import so3
from relnav_graph.units import Quantity

__all__ = ["read"]

_LOG = logging.getLogger(__name__)
_PIXELS = ("left_u", "left_v", "right_u", "right_v")
_RIG = ("x", "y", "z", "w", "rot_x", "rot_y", "rot_z")
_CAMERA = tuple(f"cam_{name}" for name in _RIG)
_RATE = tuple(f"angular_velocity_{axis}" for axis in "xyz")
#: From the IMU's maker's axes of a camera (x ahead, y left, z up) to those of images.
_OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
#: The captured pose is none where, from so long before to so long after, s, it turns otherwise than
#: the gyro by more than that, rad: the capture has lost the rig, and holds what it had.
_AROUND, _OTHERWISE = 0.3, 0.05
#: By how much the clocks of both tables are searched, s, and how finely; how alike the captured
#: places must be, m.
_APART, _STEP, _ALIKE = 5.0, 0.01, 0.05


@dataclass(frozen=True, eq=False)
class _Table:
    """Numbers of lines (N,), and columns (N, n) of a file."""

    path: Path
    lines: list[int]
    values: Array

    def where(self, row: int) -> str:
        return f"{self.path}, line {self.lines[row]}"

    def rotations(self, first: int) -> Array:
        """(N, 3, 3) of the quaternions w, x, y, z that begin at a column."""
        return from_quaternions(self.where, self.values[:, first : first + 4])


def _table(path: Path, columns: Sequence[str]) -> _Table:
    """Some columns of a table with a header, the first of them times that do not fall."""
    rows = read_rows(path)
    header = rows[0][1] if rows else []
    for name in columns:
        if header.count(name) != 1:
            raise InputError(f"{path}, line 1: found {header.count(name)} columns {name!r}")
    where = [header.index(name) for name in columns]
    lines, values = [], []
    for number, row in rows[1:]:
        if len(row) != len(header):
            raise InputError(
                f"{path}, line {number}: found {len(row)} columns, expected {len(header)}"
            )
        try:
            values.append([float(row[i]) for i in where])
        except ValueError as error:
            raise InputError(f"{path}, line {number}: {error}") from error
        if not np.isfinite(values[-1]).all():
            raise InputError(f"{path}, line {number}: found a number that is not finite")
        lines.append(number)
    if len(values) < 2:
        raise InputError(f"{path}: found {len(values)} rows, expected two or more")
    out = _Table(path, lines, np.array(values))
    back = np.nonzero(np.diff(out.values[:, 0]) < 0)[0]
    if len(back):
        raise InputError(f"{out.where(back[0] + 1)}: found a time before that of the row before")
    return out


def _json(path: Path) -> Any:
    try:
        return json.loads(read_file(path))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: not a readable JSON file: {error}") from error


def _number(path: Path, table: Any, *keys: str) -> float:
    for key in keys:
        table = table.get(key) if isinstance(table, dict) else None
    if isinstance(table, bool) or not isinstance(table, int | float) or not np.isfinite(table):
        raise InputError(f"{path}: {'.'.join(keys)}: found {table!r}, expected a number")
    return float(table)


def _tags(
    folder: Path, run: str, swapped: Mapping[str, Sequence[Sequence[int]]]
) -> tuple[Path, Array, dict[int, int]]:
    """Places of the tags (n, 3), m, in t, and the row of each by its number."""
    params = one_file(folder, "dataset_params.json")
    assert params is not None
    known = _json(params)
    names = [one for one in known if isinstance(one, dict)] if isinstance(known, list) else []
    found = [one.get("landmarks") for one in names if one.get("name") == run]
    if len(found) != 1:
        raise InputError(f"{params}: found {len(found)} runs {run!r}, expected one")
    path = one_file(folder, f"environment_{found[0]}.csv")
    assert path is not None
    table = _table(path, ("id", "x", "y", "z", "april_id"))
    numbers = [int(n) for n in table.values[:, 4]]
    for row, number in enumerate(numbers):
        if number in numbers[:row]:
            raise InputError(f"{table.where(row)}: found tag {number} a second time")
    rows = {number: row for row, number in enumerate(numbers)}
    for pair in swapped.get(str(found[0]), ()):
        if len(pair) != 2 or not set(pair) <= set(rows):
            raise InputError(f"data.options.swapped: found {pair}, expected two tags of {path}")
        rows[pair[0]], rows[pair[1]] = rows[pair[1]], rows[pair[0]]
    return path, table.values[:, 1:4].copy(), rows


def _frames(
    table: _Table, path: Path, rows: dict[int, int], sensor: str
) -> tuple[Array, Indices, tuple[Measurement, ...]]:
    """Times (N,), s, of the frames, the row that each begins with, and what is seen in them."""
    t, begins = np.unique(table.values[:, 0], return_index=True)
    ids = np.empty(len(table.lines), dtype=np.int64)
    for k, number in enumerate(table.values[:, 1]):
        if number not in rows:
            raise InputError(f"{table.where(k)}: found tag {number:g}, which {path} does not know")
        ids[k] = rows[int(number)]
    seen = []
    for k, (a, b) in enumerate(zip(begins, [*begins[1:], len(ids)], strict=True)):
        if len(set(ids[a:b])) < b - a:
            raise InputError(f"{table.where(b - 1)}: found a tag twice at {t[k]} s")
        seen.append(Measurement(sensor, float(t[k]), table.values[a:b, 2:6], ids[a:b]))
    return t, begins, tuple(seen)


def _nominal(table: _Table) -> tuple[Array, Array]:
    """R_cs (3, 3) and r_sc_c (3,), m, of the camera in the rig, by the middle of all frames."""
    R_tc, R_st = table.rotations(9), table.rotations(16)
    every = np.einsum("nji,nkj->nik", R_tc, R_st)
    u, _, v = np.linalg.svd(np.median(every, axis=0))
    R_cs = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    places = np.einsum("nji,nj->ni", R_tc, table.values[:, 13:16] - table.values[:, 6:9])
    return R_cs, np.median(places, axis=0)


def _clocks(t: Array, places: Array, imu: _Table) -> float:
    """How much later the IMU's stamps are than the frames', s, by the captured places (N, 3), m."""
    own, there = imu.values[:, 0], imu.values[:, 4:7]

    def apart(by: float) -> float:
        inside = (t + by >= own[0]) & (t + by <= own[-1])
        if inside.sum() < 0.5 * len(t):
            return np.inf
        at = np.stack([np.interp(t[inside] + by, own, x) for x in there.T], axis=1)
        return float(np.median(np.linalg.norm(at - places[inside], axis=1)))

    coarse = np.arange(-_APART, _APART + _STEP / 2, _STEP)
    best = coarse[int(np.argmin([apart(by) for by in coarse]))]
    fine = best + np.arange(-_STEP, _STEP, _STEP / 20)
    costs = [apart(by) for by in fine]
    if not min(costs) < _ALIKE:
        raise InputError(
            f"{imu.path}: found captured places {min(costs):.3g} m from those of the frames at"
            f" best, within {_APART:g} s; expected less than {_ALIKE:g} m (another run?)"
        )
    return float(fine[int(np.argmin(costs))])


def _captured(t: Array, R_tc: Array, stamps: Array, rate: Array) -> NDArray[np.bool_]:
    """At which of the times t (N,), s, the rig was captured: its attitude there (N, 3, 3) turns as
    the gyro does, whose samples (M, 3), rad/s, have stamps (M,)."""
    whole = [np.eye(3)]
    for h, w in zip(np.diff(stamps), 0.5 * (rate[1:] + rate[:-1]), strict=True):
        whole.append(whole[-1] @ so3.exp(np.ascontiguousarray(h * w)))
    at = np.clip(np.searchsorted(stamps, t), 0, len(stamps) - 1)
    good = np.ones(len(t), dtype=np.bool_)
    for k in range(len(t)):
        near = np.nonzero(np.abs(t - t[k]) <= _AROUND)[0]
        a, b = near[0], near[-1]
        captured, turned = R_tc[a].T @ R_tc[b], whole[at[a]].T @ whole[at[b]]
        off = so3.log(np.ascontiguousarray(turned.T @ captured))
        good[k] = float(np.linalg.norm(off)) <= _OTHERWISE
    return good


def read(
    folder: Path,
    run: str,
    sensor: str = "camera",
    imu_attitude: Sequence[float] | None = None,
    swapped: Mapping[str, Sequence[Sequence[int]]] | None = None,
    begin: float = 0.0,
) -> Recording:
    """The recording of one run, of the folder that holds all runs.

    run: its name; sensor: name that the camera gets; imu_attitude: R_c,imu as a rotation vector,
    rad, by default from the camera's nominal mounting and the file's own between the two; swapped:
    by environment ("v1"), pairs of tags that it has one for the other; begin: s, images
    earlier than that after the first are left out. Times are those of the frames.

    Measurements: pixels (k, 4) in the order ul, vl, ur, vr of the tags' centres, ids the row of the
    tag among the places, from zero. Inputs: "gyro", w_ci_c, rad/s, the mean of the samples at both
    ends of each interval between them, on the clock of the frames.
    Truth: relative_attitude R_tc and relative_position r_tc_t of the rig, m, at the frames but for
    those where it turns otherwise than the gyro: NaN, the capture had lost the rig. Settings: what
    the files say of the camera, its nominal mounting on the rig (in the frames, that of ``cam_*``),
    and places of the tags in t, m.

    Raises InputError, with file and line, on files that are missing, damaged, or not of one run, on
    tags that have no place, and quaternions that are not of length one.
    """
    if swapped is not None and not isinstance(swapped, Mapping):
        raise InputError(
            f"data.options.swapped: found {swapped!r}, expected pairs of tags by environment"
        )
    inside = folder / str(run)
    if not run or not inside.is_dir():
        runs = sorted(p.parent.name for p in folder.glob("*/calib.json"))
        raise InputError(f"data.options.run: found {run!r}, expected one of {', '.join(runs)}")
    files = [one_file(inside, name) for name in ("apriltag*.csv*", "imu*.csv*", "calib.json")]
    seen_in, moved_in, calibrated = (f for f in files if f is not None)
    table = _table(seen_in, ("time_s", "apriltag_id", *_PIXELS, *_RIG, *_CAMERA))
    path, points, rows = _tags(folder, run, swapped or {})
    t, begins, measurements = _frames(table, path, rows, sensor)
    measurements = tuple(m for m in measurements if m.t >= t[0] + begin)
    R_cs, r_sc_c = _nominal(table)
    calib = _json(calibrated)
    q_wxyz = [_number(calibrated, calib, "tf_cam_imu", k) for k in ("w", "rot_x", "rot_y", "rot_z")]
    R_c_imu = R_cs @ _OPTICAL @ so3.from_quaternion(np.array(q_wxyz))
    if imu_attitude is not None:
        turn = Quantity("rad", (3,)).parse(imu_attitude)
        R_c_imu = so3.exp(np.array(turn, dtype=np.float64))
    imu = _table(moved_in, ("time_s", *_RATE, *_RIG))
    places = np.ascontiguousarray(table.values[begins, 6:9])
    stamps = imu.values[:, 0] - _clocks(t, places, imu)
    rate = imu.values[:, 1:4] @ R_c_imu.T
    later = np.nonzero(np.diff(stamps) <= 0)[0]
    if len(later):
        raise InputError(f"{imu.where(later[0] + 1)}: found the time of the row before, again")
    gyro = InputSeries("gyro", stamps[:-1], stamps[1:], 0.5 * (rate[:-1] + rate[1:]))
    R_tc = table.rotations(9)[begins]
    good = _captured(t, R_tc, stamps, rate)
    if not good.all():
        _LOG.warning(
            "%s: the captured pose of %d of %d frames, from %g s on, turns otherwise than the gyro"
            " and is no truth",
            *(seen_in, len(t) - good.sum(), len(t), t[~good][0]),
        )
    R_tc[~good], places[~good] = np.nan, np.nan
    values = {"relative_attitude": R_tc, "relative_position": places}
    truth = Truth(t, values, f"motion capture, {run}/{seen_in.name}")
    camera = {k: _number(calibrated, calib, k) for k in ("fu", "fv", "cu", "cv")}
    settings: dict[str, Any] = {
        **camera,
        "baseline": _number(calibrated, calib, "b"),
        "points": points.tolist(),
        "sensor_attitude": R_cs.tolist(),
        "sensor_position": r_sc_c.tolist(),
    }
    return Recording(t, measurements, {"gyro": gyro}, truth, {"sensors": {sensor: settings}})
