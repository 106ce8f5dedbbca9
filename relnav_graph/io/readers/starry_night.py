"""Reader of "Starry Night" data: a stereo camera and a gyro among known points.

Laboratory data of the University of Toronto (Clement, Peretroukhin, Lambert, Kelly,
CRV 2015; Barfoot, State Estimation for Robotics, 2017): one MATLAB v5 file. The points,
fixed in the laboratory, play the target, so the laboratory frame is ``t``; the vehicle
that carries camera and gyro plays the chaser, ``c``. Truth is from motion capture.

The file's ``C_vi`` takes laboratory to vehicle components and is kept as the axis-angle
``theta_vk_i`` with ``C = cos(a) I + (1 - cos(a)) n n^T - sin(a) n^x`` (Barfoot 2017,
eq. 6.20), so that ``R_tc = C_vi^T = Exp(theta)``: what the gyro also says, whose mean
over an interval is ``log(R_tc,k^T R_tc,k+1) / dt``.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.state import check_rotation
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.maths import dense, so3

__all__ = ["read"]


_CAMERA = ("fu", "fv", "cu", "cv", "b")


def _load(folder: Path) -> tuple[Path, dict[str, Any]]:
    """The only .mat file of a folder, read."""
    files = sorted(folder.glob("*.mat"))
    if len(files) != 1:
        raise InputError(f"{folder}: found {len(files)} files *.mat, expected one")
    content: Any = io.BytesIO(read_file(files[0]))
    try:
        return files[0], loadmat(content)
    except Exception as error:  # a damaged file raises whatever its bytes lead scipy to
        raise InputError(f"{files[0]}: not a readable MATLAB v5 file: {error}") from error


def _fits(found: tuple[int, ...], want: tuple[int | None, ...]) -> bool:
    return len(found) == len(want) and all(
        w is None or w == n for n, w in zip(found, want, strict=True)
    )


class _Variables:
    """The variables of a file, checked: real, finite, of the expected shape."""

    def __init__(self, folder: Path) -> None:
        self.path, self._raw = _load(folder)

    def array(self, name: str, shape: tuple[int | None, ...] | None = None) -> Array:
        """A variable of a shape, in whatever order of its axes the file has it.

        None in a shape stands for any length; no shape at all for a vector.
        """
        if name not in self._raw:
            found = sorted(key for key in self._raw if not key.startswith("_"))
            raise InputError(f"{self.path}: no variable {name!r}; found {', '.join(found)}")
        value = np.asarray(self._raw[name])
        where = f"{self.path}, variable {name!r}"
        if value.dtype.kind not in "fiu":
            raise InputError(f"{where}: found {value.dtype}, expected real numbers")
        if not np.isfinite(value).all():
            index = tuple(int(i) + 1 for i in np.argwhere(~np.isfinite(value))[0])
            raise InputError(f"{where}: element {index} is {value[~np.isfinite(value)][0]}")
        value = value.astype(np.float64)
        if shape is None:
            return value.reshape(-1)
        # MATLAB drops trailing axes of length one.
        value = value.reshape(value.shape + (1,) * (len(shape) - value.ndim))
        for axes in permutations(range(value.ndim)):
            turned = value.transpose(axes)
            if _fits(turned.shape, shape):
                return np.ascontiguousarray(turned)
        want = tuple("n" if n is None else n for n in shape)
        raise InputError(f"{where}: found shape {value.shape}, expected {want}")

    def number(self, name: str) -> float:
        """A variable that is one number."""
        value = self.array(name)
        if len(value) != 1:
            raise InputError(f"{self.path}, variable {name!r}: found {len(value)} numbers, not one")
        return float(value[0])

    def sigma(self, name: str, length: int) -> list[float]:
        """Square roots of a variable of variances."""
        variances = self.array(name)
        if len(variances) != length or (variances <= 0).any():
            raise InputError(
                f"{self.path}, variable {name!r}: found {variances.tolist()}, expected"
                f" {length} positive variances"
            )
        return [float(s) for s in np.sqrt(variances)]


def _frames(frames: Sequence[int] | None, count: int) -> slice:
    """Rows of frames [first, last], counted from one, both included."""
    if frames is None:
        return slice(0, count)
    match frames:
        case [int(first), int(last)] if 1 <= first < last <= count:
            return slice(first - 1, last)
    raise InputError(f"frames: found {frames!r}, expected [first, last] within 1 to {count}")


def _times(file: _Variables) -> Array:
    t = file.array("t")
    if len(t) < 2 or (np.diff(t) <= 0).any():
        k = int(np.argmax(np.diff(t) <= 0)) + 2 if len(t) > 1 else 1
        raise InputError(f"{file.path}, variable 't': does not increase at frame {k}")
    return t


def _truth(file: _Variables, t: Array, rows: slice, count: int) -> Truth:
    theta = file.array("theta_vk_i", (3, count)).T
    largest = float(np.linalg.norm(theta, axis=1).max())
    if largest > 2 * np.pi:
        raise InputError(
            f"{file.path}, variable 'theta_vk_i': found an angle of {largest:.4g} rad,"
            " expected at most 2 pi: is it in degrees?"
        )
    turns = np.ascontiguousarray(theta[rows])
    values = {
        "relative_attitude": dense.stacked((so3.exp(phi) for phi in turns), 3, 3),
        "relative_position": np.ascontiguousarray(file.array("r_i_vk_i", (3, count)).T[rows]),
    }
    return Truth(t, values, source=f"motion capture, {file.path.name}")


def _settings(file: _Variables, sensor: str, points: Array) -> dict[str, Any]:
    """Camera constants, points and noise, as tables of a scenario."""
    camera: dict[str, Any] = {"points": points.T.tolist()}
    camera |= {"baseline" if key == "b" else key: file.number(key) for key in _CAMERA}
    # The file's C_c_v takes vehicle to camera components: the inverse of R_cs.
    R_sc = file.array("C_c_v")
    where = f"{file.path}, variable 'C_c_v'"
    if len(R_sc) != 9:
        raise InputError(f"{where}: not a rotation, {len(R_sc)} numbers")
    check_rotation(where, R_sc.reshape(3, 3))
    camera["sensor_attitude"] = R_sc.reshape(3, 3).T.tolist()
    camera["sensor_position"] = file.array("rho_v_c_v", (3, 1))[:, 0].tolist()
    camera["pixel_sigma"] = file.sigma("y_var", 4)
    return {"sensors": {sensor: camera}}


def read(folder: Path, sensor: str = "camera", frames: Sequence[int] | None = None) -> Recording:
    """The recording of the one ``*.mat`` file in `folder`.

    sensor: name that the camera gets; frames: [first, last] of the file to restrict to,
    counted from one, both included. Times start at zero with the first frame taken.

    Measurements: pixels (k, 4) in the order ul, vl, ur, vr, one per frame that sees a
    point, ids the index of the point from zero. Inputs over each interval between
    frames: "gyro", w_ci_c in rad/s, the mean of the samples at both ends, because a
    sample is taken at a frame and the rate changes much until the next one (a third less
    error over 0.5 s than with the sample of the start held); "velocity", v_ct_c in m/s,
    the sample of the start held, because its sum over seconds stays closer to the true
    displacement than that of the mean of both ends.
    Truth: relative_attitude R_tc and relative_position r_tc_t in m. Settings: what the
    file says of the camera, its points (in t, m), and noise per sample.

    Raises InputError on none or several files, a damaged one, a variable that is missing,
    not finite or of the wrong shape, times that do not increase, frames out of range.
    """
    file = _Variables(folder)
    stamps = _times(file)
    count, rows = len(stamps), _frames(frames, len(stamps))
    t = stamps[rows] - stamps[rows][0]
    points = file.array("rho_i_pj_i", (3, None))
    # Frames by points by the four pixel coordinates.
    pixels = file.array("y_k_j", (4, count, points.shape[1])).transpose(1, 2, 0)[rows]
    seen = (pixels != -1).all(axis=2)
    measurements = tuple(
        Measurement(sensor, float(t[k]), pixels[k, seen[k]], np.nonzero(seen[k])[0])
        for k in range(len(t))
        if seen[k].any()
    )
    rate = file.array("w_vk_vk_i", (3, count)).T[rows]
    velocity = file.array("v_vk_vk_i", (3, count)).T[rows]
    inputs = {
        "gyro": InputSeries("gyro", t[:-1], t[1:], 0.5 * (rate[:-1] + rate[1:])),
        "velocity": InputSeries("velocity", t[:-1], t[1:], velocity[:-1]),
    }
    truth = _truth(file, t, rows, count)
    return Recording(t, measurements, inputs, truth, _settings(file, sensor, points))
