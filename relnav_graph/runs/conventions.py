"""Whether attitudes that do not fit would, had they been written in another convention.

A unit quaternion in another order, or of the inverse rotation, is a unit quaternion too: nothing in
a file tells. But beside a gyro, or known motion, it does not fit, and the right one does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.measurement import QUATERNION
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.core.turning import TURNING
from relnav_graph.errors import RelnavError
from relnav_graph.estimators import try_estimator
from relnav_graph.io.poses import Motion, from_quaternions, quaternions
from relnav_graph.scenario.first_estimate import with_measured

__all__ = ["pass_cautions"]

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


def _read_as(problem: Problem, sensor: str, turn: Callable[[Array], Array]) -> Problem:
    """The problem with the rows of a sensor in another convention, and what was measured of the
    prior measured again. Raises EstimationError when that is impossible."""
    epochs = tuple(
        replace(
            epoch,
            measurements=tuple(
                replace(m, z=turn(m.z)) if m.sensor == sensor else m for m in epoch.measurements
            ),
        )
        for epoch in problem.epochs
    )
    return with_measured(replace(problem, epochs=epochs), problem.measured)


def _misfit(problem: Problem, sensor: str, turn: Callable[[Array], Array] | None = None) -> float:
    """Mean square of a sensor's innovations at an epoch, in their own sigmas: the median over the
    second half, 1 or less where all is as declared; infinite where the filter is lost."""
    try:
        track = try_estimator("iekf", _read_as(problem, sensor, turn) if turn else problem)
    except RelnavError:
        return np.inf
    found = track.innovations.get(sensor)
    if track.status == "diverged" or found is None or len(found.t) < 4:
        return np.inf
    own = (found.nis / found.rows)[len(found.t) // 2 :]
    return float(np.median(own)) if np.isfinite(own).all() else np.inf


def pass_cautions(problem: Problem, tracks: Sequence[Track]) -> tuple[Caution, ...]:
    """What is doubtful about the pass of some tracks. Where one of them is not ok, and no caution
    of the problem says why, also attitudes that fit badly, and far better in another convention:
    the pass is filtered once for each."""
    told = any(caution.name == TURNING for caution in problem.cautions)
    if told or all(track.status == "ok" for track in tracks):
        return problem.cautions
    return problem.cautions + _convention_cautions(problem)


def _convention_cautions(problem: Problem) -> tuple[Caution, ...]:
    found = []
    for name, sensor in problem.sensors.items():
        columns = tuple(sensor.columns)
        if columns[-4:] != QUATERNION:
            continue
        as_read = _misfit(problem, name)
        if as_read < _WRONG:
            continue
        others = dict(_OTHERS)
        if columns == _POSE:
            others["the inverse pose"] = _inverse_pose
        fits = {what: _misfit(problem, name, turn) for what, turn in others.items()}
        best = min(fits, key=lambda what: fits[what])
        if fits[best] * _BETTER < as_read:
            ratio = "far" if np.isinf(as_read) else f"{np.sqrt(as_read / fits[best]):.2g} times"
            text = (
                f"the attitudes of {name!r} fit {ratio} better if what was read is {best}: which"
                " order have its quaternions, and which way round are they?"
            )
            found.append(Caution("other convention", text))
    return tuple(found)
