"""Reader of bags: ROS 1 (.bag), ROS 2 (a folder, .mcap, .db3), or MCAP files of ROS messages.

Needs the extra ros. Which topics are what is declared::

    [data.options.topics."/imu"]
    inputs = { rate = "gyro", acceleration = "accelerometer" }

    [data.options.topics."/tracker/pose"]
    measured = "tracker"         # a sensor of the scenario
    covariance = true                # with the covariance of each message

    [data.options.topics."/vicon/pose"]
    truth = { position = "relative_position", attitude = "relative_attitude" }

Types: Imu (rate, acceleration, attitude), PoseStamped and PoseWithCovarianceStamped (position,
attitude), TwistWithCovarianceStamped (velocity, rate), Odometry (both), PointStamped (position);
see `relnav_graph.io.ros_messages` for axes and covariances.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.bags import bag_in, read_topics
from relnav_graph.io.clocks import Clock
from relnav_graph.io.declared import Collected, Roles
from relnav_graph.io.known import Known
from relnav_graph.io.ros_messages import TYPES, motion_of

__all__ = ["FILES", "check", "read"]

FILES = True
_OPTIONS = ("truth", "measured", "inputs", "inverse", "samples", "covariance")
_STAMPS = ("header", "receive")


def _roles(topics: Any) -> dict[str, Roles]:
    if not isinstance(topics, Mapping) or not topics:
        raise InputError(f"data.options.topics: found {topics!r}, expected a table by topic")
    found = {}
    for name, options in topics.items():
        where = f"data.options.topics.{name}"
        if not isinstance(options, Mapping):
            raise InputError(f"{where}: found {options!r}, expected a table")
        unknown = [key for key in options if key not in _OPTIONS]
        if unknown:
            known = ", ".join(_OPTIONS)
            raise InputError(f"{where}: unknown option {unknown[0]!r}; known are {known}")
        found[name] = Roles.of(where, **options)
    return found


def check(known: Known, topics: Any = None, **_: Any) -> None:
    """Raise InputError on roles that are none, and on names that the scenario does not have."""
    for roles in _roles(topics).values():
        roles.check(known)


def read(
    path: Path,
    known: Known,
    topics: Mapping[str, Mapping[str, Any]],
    stamps: str = "header",
    arrival: bool = False,
    clock: str = "unix",
    origin: str | int | float | None = None,
) -> Recording:
    """Some topics of a bag.

    topics: by name what they are to be, see `relnav_graph.io.declared`; stamps: "header", when it
    was so, or "receive", when the bag got it, for drivers that fill no header; arrival: what is
    measured becomes known when the bag got it; clock, origin: that of the stamps, see
    `relnav_graph.io.clocks.Clock` ("none" for a simulated one); whole nanoseconds are subtracted as
    such.

    Raises InputError on topics that the bag does not have, with those that it has, on another type,
    on what `relnav_graph.io.declared` refuses, and on a damaged bag.
    """
    roles, bag = _roles(topics), bag_in(path)
    if stamps not in _STAMPS:
        raise InputError(f"data.options.stamps: found {stamps!r}, expected header or receive")
    found = read_topics(bag, [*roles], [*TYPES], stamps == "header")
    read_by = Clock(clock, origin)
    begin = read_by.begin(str(bag), min(int(topic.stamps[0]) for topic in found.values()))
    collected = Collected(known, bag.name)
    for name, topic in found.items():
        t = read_by.seconds(topic.stamps, begin)
        known_at = read_by.seconds(topic.received, begin) if arrival else None
        motion = motion_of(topic.kind, topic.messages, t, topic.where, known_at)
        collected.add(motion, roles[name])
    return collected.recording(read_by.settings(begin))
