"""Writer of tracks as CSV tables in a folder, one for each track: see `io.track_tables`."""

from __future__ import annotations

from pathlib import Path

from relnav_graph.core.track import Track
from relnav_graph.io.track_tables import write_csv

__all__ = ["FOLDER", "write"]

FOLDER = True


def write(track: Track, path: Path) -> None:
    """Write the tables of a track into a folder, beside those of others. Raises InputError."""
    write_csv(path, [track])
