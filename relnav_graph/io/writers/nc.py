"""Writer of a track as NetCDF, as `relnav compare -o` writes its results."""

from __future__ import annotations

from pathlib import Path

from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.io.results import read_results, write_results

__all__ = ["SUFFIXES", "write"]

SUFFIXES = (".nc",)


def write(track: Track, path: Path) -> None:
    """Write a track as a file of results. Raises InputError where one of others stands."""
    if path.exists():
        try:
            read_results(path)
        except InputError as error:
            raise InputError(f"{path}: is not of this package; name another file") from error
    write_results(path, [track], None, {})
