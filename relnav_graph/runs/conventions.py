"""Whether attitudes that do not fit would, had they been written in another convention.

A unit quaternion in another order, or of the inverse rotation, is a unit quaternion too: nothing in
a file tells. But beside a gyro, or known motion, it does not fit, and the right one does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.measurement import QUATERNION
from relnav_graph.core.track import Recording
from relnav_graph.errors import RelnavError
from relnav_graph.estimators import try_estimator
from relnav_graph.io.poses import Motion, from_quaternions, quaternions
from relnav_graph.runs.passes import Pass

__all__ = ["convention_cautions"]

_POSE = ("x_m", "y_m", "z_m", *QUATERNION)
#: Mean square of innovations, in sigmas, from which on something is wrong; and how many times
#: smaller it must be where it would be mended.
_WRONG, _BETTER = 5.0, 4.0


def _inverse_pose(z: Array) -> Array:
    R = from_quaternions(lambda k: f"row {k}", z[:, 3:])
    pose = {"position": z[:, :3], "attitude": R}
    back = Motion(np.zeros(len(z)), pose, lambda k: f"row {k}").inverse().values
    return np.hstack([back["position"], quaternions(back["attitude"])])


def _turned(order: list[int], sign: float) -> Callable[[Array], Array]:
    """Takes the last four columns in another order, and the rotation the other way round."""
    return lambda z: np.hstack([z[:, :-4], z[:, -4:][:, order] * [1, sign, sign, sign]])


#: What each other convention would be called, and what makes it ours: of rows (N, columns).
_OTHERS: Mapping[str, Callable[[Array], Array]] = {
    "their inverse": _turned([0, 1, 2, 3], -1),
    "written with the scalar last": _turned([3, 0, 1, 2], 1),
    "written with the scalar last, and their inverse": _turned([3, 0, 1, 2], -1),
    "written with the scalar first": _turned([1, 2, 3, 0], 1),
    "written with the scalar first, and their inverse": _turned([1, 2, 3, 0], -1),
}


def _misfit(opened: Pass, recording: Recording, sensor: str) -> float:
    """Mean square of a sensor's innovations at an epoch, in their own sigmas: the median over the
    second half, 1 or less where all is as declared; infinite where the filter is lost."""
    try:
        problem = opened.scenario.problem(recording, opened.seed, opened.run)
        track = try_estimator("iekf", problem)
    except RelnavError:
        return np.inf
    found = track.innovations.get(sensor)
    if track.status == "diverged" or found is None or len(found.t) < 4:
        return np.inf
    own = (found.nis / found.rows)[len(found.t) // 2 :]
    return float(np.median(own)) if np.isfinite(own).all() else np.inf


def convention_cautions(opened: Pass) -> tuple[Caution, ...]:
    """Of recorded attitudes that fit badly, and far better in another convention. It filters the
    pass once for each convention: ask where an estimate is not ok."""
    found = []
    for name, sensor in opened.scenario.sensors.items():
        columns = tuple(sensor.columns)
        if columns[-4:] != QUATERNION:
            continue
        as_read = _misfit(opened, opened.recording, name)
        if as_read < _WRONG:
            continue
        others = dict(_OTHERS)
        if columns == _POSE:
            others["the inverse pose"] = _inverse_pose
        fits = {}
        for what, turn in others.items():
            rows = tuple(
                replace(m, z=turn(m.z)) if m.sensor == name else m
                for m in opened.recording.measurements
            )
            fits[what] = _misfit(opened, replace(opened.recording, measurements=rows), name)
        best = min(fits, key=lambda what: fits[what])
        if fits[best] * _BETTER < as_read:
            ratio = "far" if np.isinf(as_read) else f"{np.sqrt(as_read / fits[best]):.2g} times"
            text = (
                f"the attitudes of {name!r} fit {ratio} better if what was read is {best}: which"
                " order have its quaternions, and which way round are they?"
            )
            found.append(Caution("other convention", text))
    return tuple(found)
