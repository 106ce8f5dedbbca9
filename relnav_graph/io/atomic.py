"""Files and folders that appear complete or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from relnav_graph.errors import InputError

__all__ = ["atomic"]


def _sync(path: Path) -> None:
    """Push the files at `path` to the disk, so that a rename never precedes their content."""
    for file in [path, *path.rglob("*")]:
        if file.is_file():
            with file.open("rb+") as stream:
                os.fsync(stream.fileno())


def _swap(staged: Path, target: Path) -> None:
    """Move `staged` to `target`; only a folder that is not empty has to step aside first."""
    if not (staged.is_dir() and target.is_dir() and any(target.iterdir())):
        os.replace(staged, target)
        return
    old = staged.with_name(staged.name + ".old")
    os.replace(target, old)
    try:
        os.replace(staged, target)
    except OSError:
        os.replace(old, target)
        raise


@contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path for the file or folder `path`, renamed when the block ends.

    The temporary path stands beside the final one and does not exist yet: write a file
    there, or make it a folder. What stood at `path` stays untouched until all is written,
    also when the block raises; it is then replaced, folders included. Missing parent
    folders are made. Raises InputError when nothing can be written (no permission, disk
    full, a folder where a file should go).
    """
    target = Path(path).resolve()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as staging:
            staged = Path(staging) / target.name
            yield staged
            _sync(staged)
            _swap(staged, target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot be written: {reason}; nothing was changed") from error
