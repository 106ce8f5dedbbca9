"""Writer of tracks as bags: of ROS 1 a file .bag, of ROS 2 a folder. Needs the extra ros; see
`relnav_graph.io.track_messages`."""

from __future__ import annotations

from pathlib import Path

from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.io.track_messages import write_track_bag

__all__ = ["SUFFIXES", "write"]

SUFFIXES = (".bag",)
_STORAGES = {"mcap": "ros2", "sqlite3": "sqlite3"}


def write(
    track: Track,
    path: Path,
    attitude: str = "",
    position: str = "",
    inverse: bool = False,
    rate: str = "",
    velocity: str = "",
    origin: str | int = 0,
    epoch: str = "",
    storage: str = "mcap",
) -> None:
    """A file of ROS 1 where the name ends with .bag, else a folder of ROS 2.

    storage: of ROS 2, "mcap" or "sqlite3". The other options, and what raises InputError, are those
    of `relnav_graph.io.track_messages.write_track_bag`.
    """
    if storage not in _STORAGES:
        raise InputError(f"found storage {storage!r}, expected one of {', '.join(_STORAGES)}")
    form = "ros1" if path.suffix == ".bag" else _STORAGES[storage]
    write_track_bag(track, path, form, attitude, position, inverse, rate, velocity, origin, epoch)
