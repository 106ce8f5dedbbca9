"""Writer of tracks as Parquet tables, as that of CSV tables (extra: data)."""

from __future__ import annotations

from pathlib import Path

from relnav_graph.core.track import Track
from relnav_graph.io.track_tables import write_csv, write_one
from relnav_graph.io.writers import fills_folder

__all__ = ["FOLDER", "SUFFIXES", "write"]

SUFFIXES = (".parquet",)
FOLDER = True


def write(track: Track, path: Path) -> None:
    """Write the tables of a track into a folder, beside those of others, or as NAME.parquet. Raises
    InputError, also where pyarrow is missing."""
    if fills_folder("parquet", path):
        write_csv(path, [track], "parquet")
    else:
        write_one(path, track, "parquet")
