"""Raw tables in CSV, packed by gzip or not: rows with the numbers of their lines."""

from __future__ import annotations

import csv
import gzip
import io
from pathlib import Path
from typing import IO

from relnav_graph.errors import InputError
from relnav_graph.files import read_file

__all__ = ["one_file", "read_rows"]


def one_file(
    folder: Path, pattern: str, part: str = "", needed: bool = True, option: str = "run"
) -> Path | None:
    """The file of a folder that fits a pattern and has `part` in its name, which an option of
    [data.options] says; None where there is none and none is needed. Raises InputError on
    several."""
    found = sorted(p for p in folder.glob(pattern) if part in p.name)
    if len(found) > 1:
        names = ", ".join(p.name for p in found)
        raise InputError(
            f"{folder}: found {names}; name the {option} by a part, data.options.{option}"
        )
    if not found and needed:
        raise InputError(f"{folder}: no file {pattern} {part and f'with {part!r}'}".rstrip())
    return found[0] if found else None


def read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """The rows that are not empty, each with the number of its line, from one. Raises InputError on
    a file that is damaged."""
    content: IO[bytes] = io.BytesIO(read_file(path))
    try:
        packed = gzip.GzipFile(fileobj=content) if path.suffix == ".gz" else content
        with io.TextIOWrapper(packed, "utf-8") as stream:
            rows = csv.reader(stream)
            return [(rows.line_num, row) for row in rows if row]
    except (OSError, EOFError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a readable CSV table: {error}") from error
