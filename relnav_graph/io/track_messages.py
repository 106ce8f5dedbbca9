"""A track as messages of ROS in a bag: poses with and without covariance, and twists."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import BODY_RATE, TARGET_RATE
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.bags import Topic, topics_in, types, write_bag
from relnav_graph.io.clocks import NANO, nanoseconds
from relnav_graph.io.poses import in_fixed_axes, quaternions
from relnav_graph.io.track_poses import TrackPose, pose_of, twist_of

__all__ = ["FORMS", "write_track_bag"]

FORMS = ("mcap", "ros2", "sqlite3", "ros1")
_GEOMETRY = "geometry_msgs/msg/"
_OURS = re.compile(r"/\w+/(pose|pose_with_covariance|position|twist)")


class _Maker:
    """Makes messages of one type store, with the stamps (N,), ns, of a track."""

    def __init__(self, store: Any, stamps: NDArray[np.int64]) -> None:
        self._types, self._stamps = store.types, stamps
        fields = dataclasses.fields(store.types["std_msgs/msg/Header"])
        self._more = {"seq": 0} if any(f.name == "seq" for f in fields) else {}  # ROS 1

    def make(self, name: str, **fields: Any) -> Any:
        return self._types[_GEOMETRY + name](**fields)

    def vector(self, v: Array, name: str = "Vector3") -> Any:
        return self.make(name, **dict(zip("xyz", v.tolist(), strict=True)))

    def pose(self, r: Array, q_xyzw: Array) -> Any:
        turn = self.make("Quaternion", **dict(zip("xyzw", q_xyzw.tolist(), strict=True)))
        return self.make("Pose", position=self.vector(r, "Point"), orientation=turn)

    def topic(self, name: str, kind: str, frame: str, field: str, bodies: Sequence[Any]) -> Topic:
        """Stamped messages of a kind, one for each of the bodies."""
        when, header = (
            self._types["builtin_interfaces/msg/Time"],
            self._types["std_msgs/msg/Header"],
        )
        messages = []
        for stamp, body in zip(self._stamps.tolist(), bodies, strict=True):
            second, ns = divmod(stamp, NANO)
            own = header(**self._more, stamp=when(sec=second, nanosec=ns), frame_id=frame)
            messages.append(self.make(kind, header=own, **{field: body}))
        return Topic(name, _GEOMETRY + kind, messages, self._stamps, self._stamps)


def _pose_topics(make: _Maker, name: str, pose: TrackPose) -> list[Topic]:
    values, frame = pose.motion.values, pose.frame
    if "attitude" not in values:
        points = [make.vector(r, "Point") for r in values["position"]]
        return [make.topic(f"/{name}/position", "PointStamped", frame, "point", points)]
    R = values["attitude"]
    q = quaternions(R, "xyzw")
    poses = [make.pose(r, one) for r, one in zip(values["position"], q, strict=True)]
    P = in_fixed_axes(R, pose.motion.covariances["pose"]).reshape(-1, 36)
    both = [
        make.make("PoseWithCovariance", pose=p, covariance=c) for p, c in zip(poses, P, strict=True)
    ]
    kind = "PoseWithCovarianceStamped"
    return [
        make.topic(f"/{name}/pose", "PoseStamped", frame, "pose", poses),
        make.topic(f"/{name}/pose_with_covariance", kind, frame, "pose", both),
    ]


def _twist_topic(make: _Maker, name: str, pose: TrackPose) -> Topic:
    """Velocity, then rate; NaN for one of them that is not there."""
    motion, n = pose.motion, len(pose.motion.t)
    nothing = np.full((n, 3), np.nan)
    v, w = (motion.values.get(part, nothing) for part in ("velocity", "rate"))
    P = np.full((n, 6, 6), np.nan)
    joint = motion.covariances["twist"]
    at = [i for i, part in ((0, "velocity"), (3, "rate")) if part in motion.values]
    rows = np.concatenate([np.arange(i, i + 3) for i in at])
    P[:, rows[:, None], rows] = joint
    twists = [
        make.make(
            "TwistWithCovariance",
            twist=make.make("Twist", linear=make.vector(a), angular=make.vector(b)),
            covariance=c,
        )
        for a, b, c in zip(v, w, P.reshape(-1, 36), strict=True)
    ]
    kind = "TwistWithCovarianceStamped"
    return make.topic(f"/{name}/twist", kind, pose.frame, "twist", twists)


def _ours(path: Path) -> bool:
    """Whether it is an empty folder, or a bag with nothing but the topics of a track."""
    if path.is_dir() and not any(path.iterdir()):
        return True
    try:
        return all(_OURS.fullmatch(name) for name in topics_in(path))
    except InputError:
        return False


def write_track_bag(
    track: Track,
    path: Path,
    form: str,
    attitude: str = "",
    position: str = "",
    inverse: bool = False,
    rate: str = "",
    velocity: str = "",
    origin: str | int = 0,
    epoch: str = "",
) -> None:
    """Write a track as a bag of one of `FORMS`, of topics ``/NAME/pose`` (PoseStamped),
    ``/NAME/pose_with_covariance`` and, with a rate or a velocity, ``/NAME/twist``
    (TwistWithCovarianceStamped, in the axes that header.frame_id names); a track without an
    attitude has ``/NAME/position`` (PointStamped). NAME is the track's, letters and digits alone.

    attitude, position, inverse: which pose, see `relnav_graph.io.track_poses.pose_of`; rate,
    velocity: blocks of the track, in one frame, by default the target's rate, if it is there;
    origin: the stamp of t = 0, s, as text or a whole number, or epoch: its absolute time, for
    stamps in Unix time. Stamps are whole nanoseconds, the nearest ones; ROS 1 has none below zero.

    Raises InputError on what the track lacks, on estimates that are not finite, on two epochs
    within a nanosecond, over what is no bag with these topics alone, and where nothing can be
    written.
    """
    if form not in FORMS:
        raise InputError(f"found the form {form!r}, expected one of {', '.join(FORMS)}")
    if path.exists() and not _ours(path):
        raise InputError(f"{path}: is no bag of this package; name another one")
    pose = pose_of(track, attitude, position, inverse)
    stamps = nanoseconds(track.t, origin, epoch)
    if len(stamps) == 0 or (np.diff(stamps) <= 0).any() or stamps[0] < 0:
        raise InputError(
            f"track {track.name!r}: found {len(stamps)} stamps, the first of them"
            f" {stamps[:1].tolist()} ns; expected some, of zero or more, that rise by a nanosecond"
            " or more; option origin is added to them"
        )
    make = _Maker(types(1 if form == "ros1" else 2), stamps)
    name = "".join(c if c.isascii() and c.isalnum() else "_" for c in track.name) or "track"
    pose.check()
    topics = _pose_topics(make, name, pose)
    if not rate and not velocity:
        names = [b.name for b in track.layout]
        rate = next((b.name for b in (TARGET_RATE, BODY_RATE) if b.name in names), "")
    if rate or velocity:
        twist = twist_of(track, rate, velocity)
        twist.check()
        topics.append(_twist_topic(make, name, twist))
    with atomic(path) as staged:
        write_bag(staged, form, topics)
