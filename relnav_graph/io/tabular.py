"""Tables of numbers in CSV or Parquet, read with errors that say where and what.

Numbers are written so that reading gives the same bits.
"""

from __future__ import annotations

import csv
import io
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.measurement import QUATERNION
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.files import file_in, read_file
from relnav_graph.maths import dense, so3
from relnav_graph.memory import check_room

__all__ = [
    "TIMES",
    "Format",
    "Table",
    "component_columns",
    "from_components",
    "note",
    "read_table",
    "sigma_columns",
    "tangent_columns",
    "to_components",
    "write_table",
]

Format = Literal["csv", "parquet"]

_LOG = logging.getLogger(__name__)

#: Columns of times, s, of which an origin is taken off.
TIMES = ("t_s", "t_start_s", "t_end_s", "t_from_s", "t_arrival_s")

#: What other programs separate columns by.
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}


@cache
def note(text: str) -> None:
    """Log a note once: a table may be read more than once."""
    _LOG.info(text)


def component_columns(block: Block) -> tuple[str, ...]:
    """Names of the columns of a block: ``q_w`` to ``q_z`` for an attitude (Hamilton,
    scalar first), ``x_m``, ``y_m``, ``z_m`` for three components, else ``1_m``, ..."""
    if block.manifold == "SO3":
        return QUATERNION
    unit = re.sub(r"[^\w]+", "", re.sub(r"[/*]", "_", block.unit))
    axes = "xyz" if block.dim == 3 else [str(i + 1) for i in range(block.dim)]
    return tuple(f"{axis}_{unit}" for axis in axes)


def tangent_columns(block: Block) -> tuple[str, ...]:
    """Names of the columns of an error, or of sigmas: as :func:`component_columns` of a vector."""
    return component_columns(replace(block, manifold="vector"))


def sigma_columns(block: Block) -> tuple[str, ...]:
    """Names of the columns of sigmas beside those of the block itself, such as ``sigma_x_rad``."""
    return tuple(f"sigma_{name}" for name in tangent_columns(block))


def to_components(block: Block, values: Array) -> Array:
    """Values (N, 3, 3) or (N, dim) as quaternions (N, 4) with w >= 0, or unchanged."""
    if block.manifold != "SO3":
        return np.asarray(values, dtype=np.float64)
    matrices = np.ascontiguousarray(values, dtype=np.float64)
    return dense.stacked((so3.quaternion(matrix) for matrix in matrices), 4)


def from_components(block: Block, components: Array) -> Array:
    """Quaternions (N, 4), w first, normalised here, as (N, 3, 3); or (N, dim) unchanged.

    The inverse of :func:`to_components`.
    """
    if block.manifold != "SO3":
        return components
    quaternions = np.ascontiguousarray(components, dtype=np.float64)
    return dense.stacked((so3.from_quaternion(q) for q in quaternions), 3, 3)


@dataclass(frozen=True, eq=False)
class Table:
    """Columns (rows,) of one file, by name, and lines (rows,): the line number of each row; origin:
    s, what was taken off the columns of times; faults: what is wrong with columns that are not all
    finite numbers, which may stand there as long as nobody asks for them."""

    path: Path
    columns: Mapping[str, Array]
    lines: Indices
    origin: float = 0.0
    faults: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, column: str) -> Array:
        if column in self.faults:
            raise InputError(self.faults[column])
        return self.columns[column]

    def stack(self, columns: Sequence[str]) -> Array:
        """Some columns side by side, (rows, columns)."""
        return np.column_stack([self[c] for c in columns])

    def refuse(self, bad: NDArray[np.bool_], column: str, expected: str) -> None:
        """Raise InputError at the first row where the mask `bad` (rows,) is true, if any."""
        if bad.any():
            raise InputError(self.fault(bad, column, expected))

    def fault(self, bad: NDArray[np.bool_], column: str, expected: str) -> str:
        """What is wrong at the first row where the mask `bad` (rows,) is true."""
        rows = np.nonzero(bad)[0]
        found = self.columns[column][rows[0]] + (self.origin if column in TIMES else 0.0)
        more = f" ({len(rows)} such rows)" if len(rows) > 1 else ""
        where = f"{self.path}, line {self.lines[rows[0]]}, column {column}"
        return f"{where}: found {found!s}, expected {expected}{more}"

    def sigmas(self, block: Block) -> Array | None:
        """The columns of sigmas (rows, dim) of a block, SI; None without any. Raises InputError
        where some are missing or below zero."""
        columns = sigma_columns(block)
        if not any(c in self.columns for c in columns):
            return None
        self.require(columns, tuple(self.columns))
        for name in columns:
            self.refuse(~(self[name] >= 0), name, "a sigma of zero or more")
        return self.stack(columns)

    def require(self, columns: Sequence[str], optional: Sequence[str] = ()) -> None:
        """Raise InputError where the table lacks one of `columns`, has one that is nearly one of
        `optional`, or one of either that is not all numbers; what else it has is said once, and not
        read."""
        for name in self.faults:
            if name in (*columns, *optional):
                raise InputError(self.faults[name])
        unknown = [c for c in self.columns if c not in (*columns, *optional)]
        for name in columns:
            if name not in self.columns:
                raise InputError(
                    f"{self.path}, line 1: no column {name!r}; found {', '.join(self.columns)};"
                    f" expected {', '.join(columns)}"
                )
        for name in unknown:
            meant = get_close_matches(name, [c for c in optional if c not in self.columns], 1, 0.85)
            if not meant and name.startswith(("sigma_", "cov_")):  # a noise must not be lost
                raise InputError(
                    f"{self.path}, line 1: unknown column {name!r}; expected of noise:"
                    f" {', '.join(c for c in optional if c[:4] in ('sigm', 'cov_')) or 'none'}"
                )
            if meant:
                raise InputError(
                    f"{self.path}, line 1: unknown column {name!r}; is it {meant[0]!r}?"
                )
        if unknown:
            note(f"{self.path}: not read: column{'s' * (len(unknown) > 1)} {', '.join(unknown)}")

    def sorted_by(self, column: str) -> Table:
        """The table with its rows in order of a column, those of the same value as they stood; says
        how many rows it moved, if any."""
        order = np.argsort(self[column], kind="stable")
        moved = int((order != np.arange(len(order))).sum())
        if not moved:
            return self
        back = int((np.diff(self[column]) < 0).sum())
        note(
            f"{self.path}: sorted by {column}: {moved} of {len(order)} rows moved; {back} stood"
            " before a row of an earlier time"
        )
        columns = {name: values[order] for name, values in self.columns.items()}
        return replace(self, columns=columns, lines=self.lines[order])

    def increasing(self, column: str, strictly: bool = True) -> None:
        """Raise InputError where a time is not after (or is before) the row above."""
        step = np.diff(self[column], prepend=-np.inf)
        bad = step <= 0 if strictly else step < 0
        self.refuse(bad, column, f"a time {'after' if strictly else 'not before'} the row above")


def _text(path: Path) -> str:
    content = read_file(path)
    # What rows of short texts come to is six times as much.
    check_room(f"a table, {path}, whose rows", 6 / 8 * len(content))
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        utf_16 = content.startswith((b"\xff\xfe", b"\xfe\xff"))
        hint = "; it is UTF-16, as some spreadsheets write" if utf_16 else ""
        raise InputError(
            f"{path}, line {line}: found the byte 0x{content[error.start]:02x}, expected"
            f" UTF-8{hint}"
        ) from error


def _csv_rows(path: Path, text: str) -> Iterator[tuple[int, list[str]]]:
    """Lines with something on them, and their numbers."""
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        for row in reader:
            if row:
                yield reader.line_num, row
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: {error}") from error


def _header(path: Path, line: int, names: Sequence[str]) -> tuple[str, ...]:
    """Names of columns. Raises InputError when they are none, or not once each."""
    names = [name.strip() for name in names]
    if not names:
        raise InputError(f"{path}, line {line}: found nothing, expected names of columns")
    for name in names:
        if not name or names.count(name) > 1:
            found = f"{name!r} {names.count(name)} times" if name else "a column without a name"
            raise InputError(f"{path}, line {line}: found {found}, expected names, once each")
    if len(names) == 1:
        for mark, called in _SEPARATORS.items():
            if mark in names[0]:
                raise InputError(
                    f"{path}, line {line}: found names separated by {called}, expected commas"
                    " (and points in numbers)"
                )
    if not any(np.isnan(_number(name)) for name in names):
        raise InputError(
            f"{path}, line {line}: found numbers, {', '.join(names)}; expected the names of columns"
        )
    return tuple(names)


def _read_csv(path: Path, origin: float) -> Table:
    """All columns of a file, fast; one that is not plain numbers goes to the parser that can say
    what is wrong, and where. origin: see `read_table`."""
    text = _text(path)
    return _read_plain(path, text, origin) or _read_with_care(path, text, origin)


def _since(origin: float, columns: dict[str, Array], cells: Callable[[int], list[str]]) -> None:
    """Take the origin off the columns of times, as decimals, as they are written: a float64 of 1e9
    has steps of 100 ns. cells: the texts of the column of that number."""
    begin = Decimal(repr(origin))
    for j, name in enumerate(columns):
        if origin and name in TIMES and np.isfinite(columns[name]).all():
            columns[name] = np.array([float(Decimal(text) - begin) for text in cells(j)])


def _read_plain(path: Path, text: str, origin: float = 0.0) -> Table | None:
    """The table of a text without quotes, whose lines all have as many numbers as there are names,
    None of another: the same bits, four times as fast as `_read_with_care`."""
    names, _, body = text.partition("\n")
    if '"' in text or not names.strip() or not body.strip():
        return None
    header = _header(path, 1, next(csv.reader([names])))
    try:
        values = np.loadtxt(io.StringIO(body), delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None
    # As many rows as lines: none was empty, so that each row's line is known.
    if values.shape != (body.rstrip("\r\n").count("\n") + 1, len(header)):
        return None
    columns = {name: np.ascontiguousarray(values[:, j]) for j, name in enumerate(header)}
    lines = body.rstrip("\r\n").split("\n") if origin else []
    _since(origin, columns, lambda j: [line.split(",", j + 1)[j] for line in lines])
    return Table(path, columns, np.arange(2, len(values) + 2), origin)


def _read_with_care(path: Path, text: str, origin: float = 0.0) -> Table:
    rows = _csv_rows(path, text)
    first, names = next(rows, (1, []))
    header = _header(path, first, names)
    lines, cells = [], []
    for line, row in rows:
        if len(row) != len(header):
            many = len(row) > len(header) and all(cell.strip("+- ").isdigit() for cell in row)
            hint = "; are there commas in the numbers?" if many else ""
            raise InputError(
                f"{path}, line {line}: found {len(row)} of {len(header)} columns{hint}"
            )
        lines.append(line)
        cells.append(row)
    values = np.array([[_number(cell) for cell in row] for row in cells]).reshape(-1, len(header))
    faults = {}
    for j in np.flatnonzero(np.isnan(values).any(axis=0)).tolist():
        i = int(np.argmax(np.isnan(values[:, j])))
        found = cells[i][j]
        hint = ", with a point" if re.fullmatch(r"[\d\s+-]+,\d+", found) else ""
        found = repr(found) if len(found) < 60 else repr(found[:60]) + "..."
        where = f"{path}, line {lines[i]}, column {header[j]}"
        faults[header[j]] = f"{where}: found {found}, expected a number{hint}"
    columns = {name: np.ascontiguousarray(values[:, j]) for j, name in enumerate(header)}
    _since(origin, columns, lambda j: [row[j] for row in cells])
    return Table(path, columns, np.array(lines, dtype=np.int64), origin, faults)


def _number(text: str) -> float:
    try:
        return np.nan if "_" in text else float(text)  # Python reads 1_1, a column, as 11
    except ValueError:
        return np.nan


def _pyarrow() -> Any:
    try:
        import pyarrow.parquet  # an extra: most data sets are CSV
    except ImportError as error:
        raise InputError("Parquet tables need pyarrow: install relnav-graph[data]") from error
    return pyarrow


def _read_parquet(path: Path, origin: float) -> Table:
    pyarrow, content = _pyarrow(), read_file(path)
    try:
        file = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content))
        size = file.metadata.num_rows, file.metadata.num_columns
        check_room(f"a table, {path}, whose rows", float(size[0]) * size[1])
        names = _header(path, 1, file.schema_arrow.names)
        table = file.read()
        columns = {
            name: np.array(table.column(name).to_numpy(), dtype=np.float64)
            - (origin if name in TIMES else 0.0)
            for name in names
        }
    except InputError:
        raise
    except (OSError, TypeError, ValueError, pyarrow.ArrowException) as error:
        raise InputError(f"{path}: not a readable Parquet table of numbers: {error}") from error
    # Numbered as the same table would be in CSV, below a line of names.
    return Table(path, columns, np.arange(table.num_rows) + 2, origin)


def read_table(folder: Path, stem: str, origin: float = 0.0) -> Table | None:
    """The table of that name, all that is read of it finite; None when there is none. origin: s,
    taken off all columns of times (`TIMES`), in CSV without loss of a digit.

    Raises InputError, naming file, line and column, on a file that is no table, and on a name that
    is a path; on what is no finite number when its column is asked for.
    """
    found = [p for end in ("csv", "parquet") if (p := file_in(folder, f"{stem}.{end}")).exists()]
    if len(found) > 1:
        raise InputError(f"{folder}: found both {found[0].name} and {found[1].name}")
    if not found:
        return None
    of_csv = found[0].suffix == ".csv"
    table = _read_csv(found[0], origin) if of_csv else _read_parquet(found[0], origin)
    bad = {name: ~np.isfinite(values) for name, values in table.columns.items()}
    more = {n: table.fault(b, n, "a finite number") for n, b in bad.items() if b.any()}
    return replace(table, faults={**more, **table.faults})


def write_table(path: Path, columns: Mapping[str, NDArray[Any]], origin: float = 0.0) -> None:
    """Write columns of numbers (rows,) as CSV or Parquet, as the suffix of `path` says. origin: s,
    put on all columns of times (`TIMES`), in CSV without loss of a digit."""
    if path.suffix == ".parquet":
        pyarrow = _pyarrow()
        added = {n: c + origin if n in TIMES else c for n, c in columns.items()}
        pyarrow.parquet.write_table(pyarrow.table(added), path)
        return
    begin = Decimal(repr(float(origin)))

    def stamp(t: float) -> str:
        return format(Decimal(repr(t)) + begin, "f")

    # repr is the shortest text that reads back as the same number.
    texts = [
        map(stamp if origin and name in TIMES else repr, np.asarray(column).tolist())
        for name, column in columns.items()
    ]
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*texts, strict=True))
