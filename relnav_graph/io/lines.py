"""Texts of numbers separated by blanks or commas: rows with the numbers of their lines."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.io.clocks import decimal
from relnav_graph.io.packed import one_file

__all__ = ["Rows", "file_of", "numbers", "rising", "text_of"]


def file_of(path: Path, patterns: Sequence[str], part: str = "", option: str = "file") -> Path:
    """`path` itself if it is a file, else the one file of a folder that fits the first of the
    patterns that any fits, and has `part` in its name, which [data.options] says.

    Raises InputError on none, and on several.
    """
    if path.is_file():
        return path
    for pattern in patterns:
        found = [p for p in path.glob(pattern) if part in p.name]
        if found:
            one = one_file(path, pattern, part, option=option)
            assert one is not None
            return one
    raise InputError(f"{path}: no file {' or '.join(patterns)}" + (part and f" with {part!r}"))


def text_of(path: Path) -> str:
    """The text of a file, packed by gzip or not, without a byte order mark. Raises InputError on
    what is no text."""
    content = read_file(path)
    try:
        packed = path.suffix == ".gz"
        return (gzip.decompress(content) if packed else content).decode("utf-8-sig")
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a readable text: {error}") from error


@dataclass(frozen=True, eq=False)
class Rows:
    """Numbers of lines, stamps as written, and values (N, n) of a file."""

    path: Path
    lines: list[int]
    stamps: list[Decimal]
    values: Array

    def where(self, row: int) -> str:
        """File and line of a row."""
        return f"{self.path}, line {self.lines[row]}"


def _words(line: str, separator: str | None) -> list[str]:
    return [word.strip() for word in line.split(separator)]


def numbers(
    path: Path,
    names: Sequence[str],
    separator: str | None = None,
    stamped: bool = True,
    more: bool = False,
) -> Rows:
    """Rows of a text without a header; empty lines, and those that begin with #, are left out.

    names: of the columns, the first of them a stamp if `stamped`; separator: None for blanks; more:
    rows may have more columns than that. Raises InputError, with file and line, on another number
    of columns, on what is no finite number, and on a file without any row.
    """
    lines, stamps, values = list[int](), list[Decimal](), list[list[float]]()
    for number, line in _with_something(text_of(path)):
        words, where = _words(line, separator), f"{path}, line {number}"
        if len(words) < len(names) or (len(words) > len(names) and not more):
            raise InputError(
                f"{where}: found {len(words)} columns, expected {len(names)}: {' '.join(names)}"
            )
        lines.append(number)
        if stamped:
            stamps.append(decimal(where, words[0]))
        values.append(_floats(where, words[stamped:]))
    if not lines:
        raise InputError(f"{path}: found no row, expected {' '.join(names)}")
    if len({len(row) for row in values}) > 1:
        odd = next(i for i, row in enumerate(values) if len(row) != len(values[0]))
        raise InputError(
            f"{path}, line {lines[odd]}: found {len(values[odd]) + stamped} columns, and"
            f" {len(values[0]) + stamped} in the first row"
        )
    return Rows(path, lines, stamps, np.array(values, dtype=np.float64))


def _with_something(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def _floats(where: str, words: Sequence[str]) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    if not np.isfinite(found).all():
        raise InputError(f"{where}: found a number that is not finite")
    return found


def rising(where: Callable[[int], str], t: Array, strictly: bool = True) -> None:
    """Raise InputError unless times t (N,), s, rise, or at least do not fall."""
    step = np.diff(t)
    bad = np.nonzero(~(step > 0) if strictly else ~(step >= 0))[0]
    if len(bad):
        raise InputError(
            f"{where(int(bad[0]) + 1)}: found a time that is"
            f" {'not after' if strictly else 'before'} the one before"
        )
