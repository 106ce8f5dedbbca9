"""Writer of tracks as one MCAP file of ROS 2 messages, which Foxglove, Lichtblick, rerun and ROS 2
open. Needs the extra ros; see `relnav_graph.io.track_messages`."""

from __future__ import annotations

from pathlib import Path

from relnav_graph.core.track import Track
from relnav_graph.io.track_messages import write_track_bag

__all__ = ["SUFFIXES", "write"]

SUFFIXES = (".mcap",)


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
) -> None:
    """One file. Options, and what raises InputError, are those of
    `relnav_graph.io.track_messages.write_track_bag`."""
    write_track_bag(track, path, "mcap", attitude, position, inverse, rate, velocity, origin, epoch)
