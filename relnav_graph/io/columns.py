"""Columns of files of others by their names: texts of columns, MATLAB's .mat, NumPy's .npz.

``NAME`` is a column, or an array with a row for each time; ``NAME[k]`` its column k, from zero. A
field of a MATLAB struct is ``STRUCT.FIELD``. Of a text without a header columns are "1", "2", ...
"""

from __future__ import annotations

import csv
import difflib
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.io.lines import text_of

__all__ = ["SEPARATORS", "Columns", "read_columns"]

SEPARATORS: Mapping[str, str | None] = {",": ",", ";": ";", "tab": "\t", "blanks": None}
_INDEXED = re.compile(r"(.+)\[(\d+)\]")


@dataclass(frozen=True, eq=False)
class Columns:
    """What a file has: arrays (N, ...) by name, of a text (N,) of its words; lines (N,): the number
    of the line of each row, of a text."""

    path: Path
    arrays: Mapping[str, NDArray[Any]]
    lines: Sequence[int] | None = None

    def where(self, row: int) -> str:
        """File and line, or row, from zero."""
        if self.lines is None:
            return f"{self.path}, row {row}"
        return f"{self.path}, line {self.lines[row]}"

    def get(self, name: str, transpose: bool = False) -> NDArray[Any]:
        """A column, or an array, of rows (N, ...), as it is in the file: of a text its words.

        transpose: the file has a column for each time. Raises InputError on a name that is not
        there, with those that are.
        """
        match = None if name in self.arrays else _INDEXED.fullmatch(name)
        stem = match[1] if match else name
        if stem not in self.arrays:
            close = difflib.get_close_matches(stem, list(self.arrays), 3, 0.5)
            hint = f"; is {' or '.join(map(repr, close))} meant?" if close else ""
            listed = ", ".join(f"{n} {_shape(a)}".strip() for n, a in self.arrays.items())
            raise InputError(f"{self.path}: found no {stem!r}{hint}; there are {listed or 'none'}")
        array = self.arrays[stem]
        array = array.T if transpose and array.ndim > 1 else array
        if match is None:
            return array
        k = int(match[2])
        if array.ndim != 2 or k >= array.shape[1]:
            raise InputError(f"{self.path}: found {name!r} of an array {array.shape}")
        return np.ascontiguousarray(array[:, k])

    def numbers(self, name: str, transpose: bool = False) -> Array:
        """`get` as float64, NaN among them. Raises InputError, with the line, on a word that is no
        number."""
        found = self.get(name, transpose)
        if found.dtype.kind in "fiu":
            return np.ascontiguousarray(found, dtype=np.float64)
        if found.dtype.kind not in "UO" or found.ndim != 1:
            raise InputError(f"{self.path}: {name!r} is of type {found.dtype}, expected numbers")
        out = np.empty(len(found))
        for k, word in enumerate(found):
            try:
                out[k] = float(word) if word.strip() else np.nan
            except ValueError as error:
                raise InputError(
                    f"{self.where(k)}, column {name}: found {word[:60]!r}, expected a number"
                ) from error
        return out

    @cached_property
    def is_text(self) -> bool:
        """Whether it is a text, whose words are as written."""
        return self.lines is not None


def _shape(array: NDArray[Any]) -> str:
    return f"({', '.join(map(str, array.shape))})" if array.ndim > 1 else ""


def _text(path: Path, separator: str, header: bool, skip: int) -> Columns:
    if separator not in ("", *SEPARATORS):
        known = ", ".join(map(repr, SEPARATORS))
        raise InputError(f"data.options.separator: found {separator!r}, expected one of {known}")
    mark = SEPARATORS[separator] if separator else {".csv": ",", ".tsv": "\t"}.get(path.suffix)
    lines = text_of(path).splitlines()
    numbered = [(n, s) for n, s in enumerate(lines, 1) if n > skip and s.strip()]
    words = [_words(f"{path}, line {n}", s, mark) for n, s in numbered]
    if header and words and words[0] and words[0][0].startswith("#"):
        words[0] = [w for w in (words[0][0].lstrip("# "), *words[0][1:]) if w]
    if len(words) < 1 + header:
        raise InputError(f"{path}: found {len(lines)} lines, expected a table")
    names = words[0] if header else [str(k + 1) for k in range(len(words[0]))]
    repeated = [n for n in names if names.count(n) > 1]
    if repeated:
        raise InputError(f"{path}, line {numbered[0][0]}: found the column {repeated[0]!r} twice")
    rows = words[1:] if header else words
    kept = [n for n, _ in numbered][len(words) - len(rows) :]
    for number, row in zip(kept, rows, strict=True):
        if len(row) != len(names):
            raise InputError(
                f"{path}, line {number}: found {len(row)} columns, expected {len(names)}:"
                f" {', '.join(names)}"
            )
    arrays = {name: np.array([r[k] for r in rows], dtype=object) for k, name in enumerate(names)}
    return Columns(path, arrays, kept)


def _words(where: str, line: str, mark: str | None) -> list[str]:
    if mark is None:
        return line.split()
    try:
        return [word.strip() for word in next(csv.reader([line], delimiter=mark))]
    except csv.Error as error:
        raise InputError(f"{where}: {error}") from error


def _flat(found: Any, name: str = "") -> dict[str, NDArray[Any]]:
    """Arrays of nested structs, by their paths."""
    if isinstance(found, Mapping):
        parts = [_flat(v, f"{name}.{k}" if name else k) for k, v in found.items()]
        return {key: array for part in parts for key, array in part.items()}
    array = np.atleast_1d(np.asarray(found))
    return {name: array} if array.dtype.kind in "fiuU" else {}


def _mat(path: Path) -> Columns:
    content = read_file(path)
    if content[:128].startswith(b"MATLAB 7.3") or content[512:516] == b"\x89HDF":
        return Columns(path, _hdf(path, content))
    from scipy.io import loadmat

    try:
        found = loadmat(BytesIO(content), simplify_cells=True)  # type: ignore[arg-type]
    except Exception as error:  # scipy raises of many kinds
        raise InputError(f"{path}: not a readable .mat file: {error}") from error
    return Columns(path, _flat({k: v for k, v in found.items() if not k.startswith("__")}))


def _hdf(path: Path, content: bytes) -> dict[str, NDArray[Any]]:
    """Numbers of a .mat file of version 7.3, which is HDF5 with the axes of arrays reversed."""
    import h5py

    arrays: dict[str, NDArray[Any]] = {}

    def visit(name: str, item: Any) -> None:
        usual = isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu"
        if usual and not name.startswith("#") and "MATLAB_empty" not in item.attrs:
            array = np.asarray(item[()]).T
            arrays[name.replace("/", ".")] = (
                array.reshape(-1) if array.ndim == 2 and 1 in array.shape else array
            )

    try:
        with h5py.File(BytesIO(content), "r") as file:
            file.visititems(visit)
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path}: not a readable .mat file: {error}") from error
    return arrays


def _npz(path: Path) -> Columns:
    try:
        with np.load(BytesIO(read_file(path)), allow_pickle=False) as found:
            return Columns(path, {n: _member(found, n) for n in found.files})
    except (OSError, ValueError, AttributeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a readable .npz file: {error}") from error


def _member(found: Any, name: str) -> NDArray[Any]:
    """An array of an .npz file; of one of objects, none of them: to read these may run code."""
    try:
        return np.atleast_1d(found[name])
    except ValueError as error:
        if "Object arrays" in str(error):
            return np.empty((0, 0), dtype=object)
        raise


def read_columns(path: Path, separator: str = "", header: bool = True, skip: int = 0) -> Columns:
    """The columns of a file: .npz, .mat (versions 5 and 7.3), else a text, packed by gzip or not.

    Of a text, separator: one of `SEPARATORS`, by default commas of .csv, tabs of .tsv, else blanks;
    header: whether its first line has the names; skip: lines above it that are none of it. Raises
    InputError on a file that is damaged.
    """
    if path.suffix == ".npz":
        return _npz(path)
    return _mat(path) if path.suffix == ".mat" else _text(path, separator, header, skip)
