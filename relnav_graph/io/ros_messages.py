"""Messages of ROS, of one topic, as the motion that they tell.

Values are SI and quaternions have their scalar last (REP 103). A pose is that of the body in the
axes of ``header.frame_id``; covariances of poses are about these fixed axes, and are turned to the
body's. An `Imu` tells rate and specific force of its own axes, and, unless its first covariance is
-1, an attitude. The twist of an `Odometry` is in the body's axes (child_frame_id): its velocity is
turned to those of the pose. That of a `TwistWithCovarianceStamped` is in those of header.frame_id
and is taken as it is. A covariance whose first number is -1, or of nothing but zeros, is not given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.io.poses import Motion, Where, from_quaternions, in_body_axes

__all__ = ["TYPES", "motion_of"]


def _vectors(messages: Sequence[Any], get: Callable[[Any], Any], names: str = "xyz") -> Array:
    return np.array([[getattr(get(m), a) for a in names] for m in messages], dtype=np.float64)


def _covariances(messages: Sequence[Any], get: Callable[[Any], Any], n: int) -> Array:
    """(N, n, n), NaN where not given."""
    P = np.array([get(m) for m in messages], dtype=np.float64).reshape(-1, n, n)
    P[(P[:, 0, 0] == -1.0) | ~P.any(axis=(1, 2))] = np.nan
    return P


def _pose(
    messages: Sequence[Any], where: Where, get: Callable[[Any], Any]
) -> tuple[dict[str, Array], dict[str, Array]]:
    values = {
        "position": _vectors(messages, lambda m: get(m).position),
        "attitude": from_quaternions(
            where, _vectors(messages, lambda m: get(m).orientation, "xyzw"), "xyzw"
        ),
    }
    return values, {}


def _pose_with_covariance(
    messages: Sequence[Any], where: Where, get: Callable[[Any], Any]
) -> tuple[dict[str, Array], dict[str, Array]]:
    values, _ = _pose(messages, where, lambda m: get(m).pose)
    P = _covariances(messages, lambda m: get(m).covariance, 6)
    return values, {"pose": in_body_axes(values["attitude"], P)}


def _twist_with_covariance(
    messages: Sequence[Any], get: Callable[[Any], Any]
) -> tuple[dict[str, Array], dict[str, Array]]:
    values = {
        "velocity": _vectors(messages, lambda m: get(m).twist.linear),
        "rate": _vectors(messages, lambda m: get(m).twist.angular),
    }
    P = _covariances(messages, lambda m: get(m).covariance, 6)
    return values, {
        "velocity": P[:, :3, :3].copy(),
        "rate": P[:, 3:, 3:].copy(),
    }


def _odometry(messages: Sequence[Any], where: Where) -> tuple[dict[str, Array], dict[str, Array]]:
    values, P = _pose_with_covariance(messages, where, lambda m: m.pose)
    twist, of_twist = _twist_with_covariance(messages, lambda m: m.twist)
    R = values["attitude"]
    twist["velocity"] = np.einsum("nij,nj->ni", R, twist["velocity"])
    of_twist["velocity"] = R @ of_twist["velocity"] @ np.swapaxes(R, 1, 2)
    return values | twist, P | of_twist


def _imu(messages: Sequence[Any], where: Where) -> tuple[dict[str, Array], dict[str, Array]]:
    values = {
        "rate": _vectors(messages, lambda m: m.angular_velocity),
        "acceleration": _vectors(messages, lambda m: m.linear_acceleration),
    }
    P = {
        "rate": _covariances(messages, lambda m: m.angular_velocity_covariance, 3),
        "acceleration": _covariances(messages, lambda m: m.linear_acceleration_covariance, 3),
    }
    if all(m.orientation_covariance[0] != -1.0 for m in messages):
        q = _vectors(messages, lambda m: m.orientation, "xyzw")
        if q.any():  # drivers without an attitude leave all of it zero
            R = from_quaternions(where, q, "xyzw")
            fixed = _covariances(messages, lambda m: m.orientation_covariance, 3)
            values["attitude"] = R
            P["attitude"] = np.swapaxes(R, 1, 2) @ fixed @ R
    return values, P


#: What to make of the messages of a type; ROS 1 has the same without "msg/".
TYPES: Mapping[str, Callable[..., tuple[dict[str, Array], dict[str, Array]]]] = {
    "sensor_msgs/msg/Imu": _imu,
    "geometry_msgs/msg/PoseStamped": lambda ms, where: _pose(ms, where, lambda m: m.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda ms, where: _pose_with_covariance(
        ms, where, lambda m: m.pose
    ),
    "geometry_msgs/msg/TwistWithCovarianceStamped": lambda ms, where: _twist_with_covariance(
        ms, lambda m: m.twist
    ),
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PointStamped": lambda ms, where: (
        {"position": _vectors(ms, lambda m: m.point)},
        {},
    ),
}


def motion_of(
    kind: str, messages: Sequence[Any], t: Array, where: Where, arrival: Array | None = None
) -> Motion:
    """The motion that messages of one type tell, at t (N,), s. where: names one for messages.

    Raises InputError on a type that is none of `TYPES`, on quaternions whose length is not one
    within 1e-3, on numbers that are not finite, and where frames change on the way.
    """
    if kind not in TYPES:
        raise InputError(f"{where(0)}: found {kind}, expected one of {', '.join(TYPES)}")
    frames = [(m.header.frame_id, getattr(m, "child_frame_id", "")) for m in messages]
    other = next((k for k, frame in enumerate(frames) if frame != frames[0]), None)
    if other is not None:
        raise InputError(
            f"{where(other)}: found the frames {frames[other]}, and {frames[0]} in the first"
            " message of the topic"
        )
    values, covariances = TYPES[kind](messages, where)
    for name, value in values.items():
        bad = np.nonzero(~np.isfinite(value.reshape(len(value), -1)).all(axis=1))[0]
        if 0 < len(bad) < len(value):
            raise InputError(f"{where(int(bad[0]))}: found a {name} that is not finite")
    given = {n: v for n, v in values.items() if np.isfinite(v).all()}
    return Motion(t, given, where, covariances, arrival)
