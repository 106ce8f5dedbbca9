"""Reader of a simulated Astrobee beside a tumbling target, as topic dumps in CSV.

The data of C. Oestreich et al., "On-orbit inspection of an unknown, tumbling target using
NASA's Astrobee robotic free-flyers", CVPR Workshops 2021: one run in a folder, one file per
topic, found by a part of its name. The inspector is the chaser. World axes, which do not
rotate, are o.

Nothing in the data says which axes the target has; here t are those of the chaser at the
first epoch, held by the target from then on. Odometry is T_c-c, present chaser axes to those
of the message before. Its messages and those of the authors' estimates bear the time of
receipt only; the others are stamped by the simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.state import UNIT_QUATERNION
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.packed import one_file, read_rows
from relnav_graph.maths import dense, so3
from relnav_graph.sim.truths.inertial import inertia_parameters

__all__ = ["authors_rate", "read"]


_PLACE = ("pose.position.x", "pose.position.y", "pose.position.z")
_TURN = tuple(f"pose.orientation.{axis}" for axis in "wxyz")
_RATE = tuple(f"angular_velocity.{axis}" for axis in "xyz")
_TWIST = tuple(f"twist.angular.{axis}" for axis in "xyz")
#: R_c,imu as a rotation vector, rad: a quarter turn about z (Astrobee's configuration).
_IMU = (0.0, 0.0, np.pi / 2)


@dataclass(frozen=True, eq=False)
class _Topic:
    """One topic: times (N,) s, strictly increasing, and some of its columns (N, n)."""

    path: Path
    t: Array
    values: Array

    def rotations(self, first: int) -> Array:
        """The attitudes (N, 3, 3) whose quaternions, scalar first, begin at a column."""
        q_wxyz = np.ascontiguousarray(self.values[:, first : first + 4])
        bad = np.abs(np.linalg.norm(q_wxyz, axis=1) - 1) > UNIT_QUATERNION
        if bad.any():
            raise InputError(
                f"{self.path}, at {self.t[bad][0]} s: found the quaternion {q_wxyz[bad][0]},"
                " expected one of length 1"
            )
        return dense.stacked((so3.from_quaternion(q) for q in q_wxyz), 3, 3)

    def at(self, t: Array, values: Array) -> Array:
        """Values (N, 3) or attitudes (N, 3, 3) of the samples, interpolated at t (M,), s.

        Between samples a, b, at the fraction s: a + s (b - a), or a Exp(s Log(a^T b)).
        """
        k = np.clip(np.searchsorted(self.t, t) - 1, 0, len(self.t) - 2)
        part = (t - self.t[k]) / (self.t[k + 1] - self.t[k])
        if values.ndim == 2:
            mixed: Array = values[k] + part[:, None] * (values[k + 1] - values[k])
            return mixed
        turns = (so3.log(a.T @ b) for a, b in zip(values[k], values[k + 1], strict=True))
        parts = (so3.exp(s * d) for s, d in zip(part, turns, strict=True))
        return np.asarray(values[k] @ dense.stacked(parts, 3, 3))


def _topic(
    folder: Path, topic: str, run: str, columns: Sequence[str], needed: bool = True
) -> _Topic | None:
    """A topic's file; None where there is none and it is not needed."""
    path = one_file(folder, f"*{topic}*.csv*", run, needed)
    if path is None:
        return None
    lines = read_rows(path)
    header, rows = (lines[0][1] if lines else []), [row for _, row in lines[1:]]
    names = ("%time", "header.stamp", *columns)
    where = [[i for i, h in enumerate(header) if h == n or h.endswith(f".{n}")] for n in names]
    for name, found in zip(names, where, strict=True):
        if len(found) != 1:
            raise InputError(f"{path}, line 1: found {len(found)} columns {name!r}, expected one")
    try:
        table = np.array([[float(row[i]) for (i,) in where] for row in rows]).reshape(
            -1, len(names)
        )
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: a row is cut off or holds no number: {error}") from error
    if len(table) < 2 or not np.isfinite(table).all():
        bad = np.nonzero(~np.isfinite(table).all(axis=1))[0]
        at = f"line {bad[0] + 2} is not finite" if len(bad) else f"{len(table)} rows"
        raise InputError(f"{path}: {at}, expected two rows or more of finite numbers")
    # Topics that the simulation does not stamp have zeros there.
    stamps = table[:, 1] if table[:, 1].all() else table[:, 0]
    _, first = np.unique(stamps, return_index=True)  # a few messages come twice
    return _Topic(path, 1e-9 * stamps[first], np.ascontiguousarray(table[first, 2:]))


def _truth(folder: Path, run: str, t: Array, inertia: Array | None) -> Truth | None:
    """Truth at t (N,), s, where the folder has it. inertia: J of the target, kg m^2, about
    the axes of its own ground truth."""
    pose = (*_PLACE, *_TURN)
    chaser = _topic(folder, "chaser_gt_pose", run, pose, needed=False)
    target = _topic(folder, "target_gt_pose", run, pose, needed=False)
    twist = _topic(folder, "target_gt_twist", run, _TWIST, needed=False)
    if chaser is None or target is None or twist is None:
        return None
    for topic in (chaser, target, twist):
        if topic.t[0] > t[0] or topic.t[-1] < t[-1]:
            raise InputError(f"{topic.path}: does not cover {t[0]} s to {t[-1]} s")
    R_oc = chaser.at(t, chaser.rotations(3))
    R_ob = target.at(t, target.rotations(3))  # b: the target's axes in its ground truth
    w_ti_o = twist.at(t, twist.values)  # its angular part is in world axes
    R_bt = R_ob[0].T @ R_oc[0]
    R_ot = R_ob @ R_bt
    r_tc_o = chaser.at(t, chaser.values[:, :3]) - target.at(t, target.values[:, :3])
    values = {
        "chaser_attitude": R_oc,
        "target_attitude": R_ot,
        "relative_position": r_tc_o,
        "body_rate": np.einsum("nji,nj->ni", R_ot, w_ti_o),
        "target_rate": np.einsum("nji,nj->ni", R_oc, w_ti_o),
    }
    if inertia is not None:
        k = inertia_parameters(R_bt.T @ inertia @ R_bt)
        values["inertia_matrix_parameters"] = np.tile(k, (len(t), 1))
    return Truth(t - t[0], values, f"simulation, {chaser.path.name} and {target.path.name}")


def read(
    folder: Path,
    sensor: str = "odometry",
    run: str = "",
    imu_attitude: Sequence[float] = _IMU,
    target_inertia: Sequence[float] | None = None,
) -> Recording:
    """The recording of one run.

    sensor: name that the odometry gets; run: a part of the file names, where a folder holds
    several runs; imu_attitude: R_c,imu as a rotation vector, rad; target_inertia: true
    principal moments, kg m^2, about the axes of the target's ground truth, for scoring.
    Times start at zero with the first odometry message, which only says when the second
    one's interval starts.

    Measurements: T_c-c as r, m, and q_wxyz, (1, 7). Inputs: "gyro", w_ci_c, rad/s, the mean
    of the samples at both ends of each interval between them.
    Truth, where the folder has it: chaser_attitude, target_attitude, relative_position
    r_tc_o, m, body_rate w_ti_t and target_rate w_ti_c, rad/s, inertia_matrix_parameters.

    Raises InputError on files that are missing, damaged, or not of one run, on quaternions
    that are not of length one, and when the gyro does not cover the odometry.
    """
    odometry = _topic(folder, "chaser_deltapose", run, (*_PLACE, *_TURN))
    imu = _topic(folder, "chaser_imu", run, _RATE)
    assert odometry is not None  # both are needed
    assert imu is not None
    odometry.rotations(3)
    t = odometry.t
    if imu.t[0] > t[0] or imu.t[-1] < t[-1]:
        raise InputError(f"{imu.path}: does not cover {t[0]} s to {t[-1]} s")
    rate = imu.values @ so3.exp(np.array(imu_attitude, dtype=np.float64)).T
    stamps = imu.t - t[0]
    gyro = InputSeries("gyro", stamps[:-1], stamps[1:], 0.5 * (rate[:-1] + rate[1:]))
    ids = np.zeros(1, dtype=np.int64)
    measurements = tuple(
        Measurement(sensor, float(t[k] - t[0]), odometry.values[k][None], ids)
        for k in range(1, len(t))
    )
    inertia = None if target_inertia is None else np.diag(np.array(target_inertia, dtype=float))
    truth = _truth(folder, run, t, inertia)
    return Recording(t - t[0], measurements, {"gyro": gyro}, truth)


def authors_rate(folder: Path, run: str = "") -> tuple[Array, Array, Array]:
    """The authors' own estimates and the truth: times (N,), s, since the first odometry
    message, the target's rate estimated and true, w_ti_c (N, 3), rad/s.

    Their twist turns the world as seen from the target: in the axes of their own estimate
    of the pose, with the sign of the chaser's motion. (Of all readings this one is nearest
    to the truth.) Raises InputError as :func:`read` does.
    """
    found = _topic(folder, "target_est_twist", run, _TWIST)
    pose = _topic(folder, "target_est_pose", run, _TURN)
    odometry = _topic(folder, "chaser_deltapose", run, _PLACE)
    chaser = _topic(folder, "chaser_gt_pose", run, _TURN)
    truth = None if found is None else _truth(folder, run, found.t, None)
    if found is None or pose is None or odometry is None or chaser is None or truth is None:
        raise InputError(f"{folder}: no ground truth to compare with")
    w_ti_o = -np.einsum("nij,nj->ni", pose.at(found.t, pose.rotations(0)), found.values)
    R_oc = chaser.at(found.t, chaser.rotations(0))
    estimate = np.einsum("nji,nj->ni", R_oc, w_ti_o)
    return found.t - odometry.t[0], estimate, truth.values["target_rate"]
