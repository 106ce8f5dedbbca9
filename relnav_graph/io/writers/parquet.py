"""Writer of tracks as Parquet tables in a folder, one for each track (extra: data)."""

from __future__ import annotations

from pathlib import Path

from relnav_graph.core.track import Track
from relnav_graph.io.track_tables import write_csv

__all__ = ["FOLDER", "write"]

FOLDER = True


def write(track: Track, path: Path) -> None:
    """Write the tables of a track into a folder, beside those of others. Raises InputError, also
    where pyarrow is missing."""
    write_csv(path, [track], "parquet")
