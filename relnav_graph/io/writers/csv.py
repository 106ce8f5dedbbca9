"""Writer of tracks as CSV tables, one for each track in a folder, or one track alone: see
`io.track_tables`."""

from __future__ import annotations

from pathlib import Path

from relnav_graph.core.track import Track
from relnav_graph.io.track_tables import write_csv, write_one
from relnav_graph.io.writers import fills_folder

__all__ = ["FOLDER", "SUFFIXES", "write"]

SUFFIXES = (".csv",)
FOLDER = True


def write(track: Track, path: Path) -> None:
    """Write the tables of a track into a folder, beside those of others, or as NAME.csv without
    the smoothed one, and maybe NAME_statics.csv beside it. Raises InputError."""
    if fills_folder("csv", path):
        write_csv(path, [track])
    else:
        write_one(path, track)
