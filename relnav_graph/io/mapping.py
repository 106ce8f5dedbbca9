"""What columns of a table are: sensors, inputs and truth, as a mapping declares them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import QUATERNION
from relnav_graph.errors import InputError
from relnav_graph.io.columns import Columns
from relnav_graph.io.declared import SAMPLES, Collected
from relnav_graph.io.known import Known
from relnav_graph.io.poses import ORDERS, from_matrices, from_mrp, from_quaternions, quaternions
from relnav_graph.io.stamp_columns import StampColumn
from relnav_graph.units import column_unit, si_scale, unit_scale

__all__ = ["Target", "targets_of"]

_LOG = logging.getLogger(__name__)
_ATTITUDES = ("quaternion", "mrp", "matrix")
_COMMON = ("file", "time", "columns", "unit", "transpose", "missing", "sigma", "sigma_unit")
_KEYS = {
    "sensors": (*_COMMON, *_ATTITUDES, "order", "inverse", "id"),
    "inputs": (*(k for k in _COMMON if not k.startswith("sigma")), "samples"),
    "truth": (*_COMMON, *_ATTITUDES, "order", "inverse"),
}
_CHOICES = {"missing": ("refuse", "skip"), "samples": SAMPLES, "order": tuple(ORDERS)}


def _names(where: str, given: Any) -> list[str]:
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise InputError(f"{where}: found {given!r}, expected the name of a column, or several")
    return names


@dataclass(frozen=True)
class Target:
    """One sensor, input or block: role, one of the keys of the mapping; name; time: its stamps;
    options: its table; units: SI of its columns, where the scenario says them, None where not."""

    where: str
    role: str
    name: str
    time: StampColumn
    options: Mapping[str, Any]
    units: Sequence[str | None] | None

    @property
    def file(self) -> str:
        """The name of its own file, "" for that of all."""
        return str(self.options.get("file", ""))

    @property
    def _attitude(self) -> str:
        return next((key for key in _ATTITUDES if key in self.options), "")

    def _stacked(self, columns: Columns, key: str, count: int, width: int | None) -> Array:
        """Columns side by side (N, width). Raises InputError on others."""
        where, transpose = f"{self.where}.{key}", bool(self.options.get("transpose", False))
        parts = []
        for name in _names(where, self.options[key]):
            part = columns.numbers(name, transpose)
            if len(part) != count:
                hint = "; is transpose = true meant?" if count in part.shape[1:] else ""
                raise InputError(
                    f"{where}: {columns.path}: found {name!r} of {part.shape}, expected {count}"
                    f" rows, one for each stamp of {self.time.column!r}{hint}"
                )
            parts.append(part.reshape(count, -1))
        found = np.hstack(parts)
        if width is not None and found.shape[1] != width:
            raise InputError(f"{where}: found {found.shape[1]} columns, expected {width}")
        return found

    def _scaled(self, columns: Columns, key: str, unit: str, count: int, si: Any) -> Array:
        """Columns in SI. si: their SI units, where known."""
        found = self._stacked(columns, key, count, None)
        factors = _factors(f"{self.where}.{unit}", self.options.get(unit), found.shape[1], si)
        scaled: Array = found * np.array(factors)
        return scaled

    def _rotations(self, columns: Columns, rows: NDArray[np.int64], count: int) -> Array:
        """Attitudes (rows, 3, 3) of some of the `count` rows."""
        key = self._attitude
        numbers = self._stacked(columns, key, count, {"quaternion": 4, "mrp": 3, "matrix": 9}[key])

        def where(k: int) -> str:
            return columns.where(int(rows[k]))

        own = np.ascontiguousarray(numbers[rows])
        if key == "quaternion":
            if "order" not in self.options:
                raise InputError(f"{self.where}: found no order, expected wxyz or xyzw")
            R = from_quaternions(where, own, str(self.options["order"]))
        elif key == "mrp":
            R = from_mrp(own)
        else:
            R = from_matrices(where, own.reshape(-1, 3, 3))
        return np.ascontiguousarray(np.swapaxes(R, 1, 2)) if self.options.get("inverse") else R

    def add(self, found: Collected, columns: Columns, t: Array) -> None:
        """Read it at t (N,), s, the times of all rows of its file, into a recording.

        Raises InputError on what the file does not have, and on NaN where it is not to be skipped.
        """
        n, parts = len(t), dict[str, Array]()
        if "columns" in self.options:
            parts["columns"] = self._scaled(columns, "columns", "unit", n, self.units)
        if "sigma" in self.options:
            parts["sigma"] = self._scaled(columns, "sigma", "sigma_unit", n, None)
        if self._attitude:
            parts["attitude"] = self._stacked(columns, self._attitude, n, None)
        rows = self._known(columns, parts, n)
        t, sigma = t[rows], parts["sigma"][rows] if "sigma" in parts else None
        values = [parts["columns"][rows]] if "columns" in parts else []
        R = self._rotations(columns, rows, n) if self._attitude else None
        if self.role == "inputs":
            samples = str(self.options.get("samples", "mean"))
            found.add_input(columns.where, self.name, t, values[0], samples)
        elif self.role == "truth":
            value = R if R is not None else values[0]
            found.known.check_truth(self.where, self.name)
            found.add_truth(self.where, self.name, t, value, sigma)
        else:
            z = np.hstack(values if R is None else [*values, quaternions(R)])
            P = None if sigma is None else np.einsum("ni,ij->nij", sigma**2, np.eye(sigma.shape[1]))
            found.add_rows(self.name, t, z, self._ids(columns, rows, n), None, P)

    def _known(self, columns: Columns, parts: Mapping[str, Array], count: int) -> NDArray[np.int64]:
        """Rows without NaN."""
        good = np.ones(count, dtype=np.bool_)
        for part in parts.values():
            good &= np.isfinite(part).all(axis=1)
        bad = np.nonzero(~good)[0]
        if len(bad) and self.options.get("missing", "refuse") == "refuse":
            raise InputError(
                f"{columns.where(int(bad[0]))}: found a number of {self.name!r} that is not finite"
                f' ({len(bad)} such rows); {self.where}.missing = "skip" leaves them out'
            )
        if len(bad):
            _LOG.info(f"{columns.path}: {self.name!r}: {len(bad)} of {count} rows have no numbers")
        return np.nonzero(good)[0]

    def _ids(self, columns: Columns, rows: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        given = self.options.get("id", 0)
        if isinstance(given, int) and not isinstance(given, bool):
            return np.full(len(rows), given, dtype=np.int64)
        ids = columns.numbers(str(given))
        if len(ids) != count:
            raise InputError(f"{self.where}.id: found {len(ids)} rows, expected {count}")
        ids = ids[rows]
        bad = np.nonzero(~((ids == np.rint(ids)) & (np.abs(ids) < 2.0**53)))[0]
        if len(bad):
            where = columns.where(int(rows[bad[0]]))
            raise InputError(f"{where}: found the id {ids[bad[0]]}, expected a whole number")
        return ids.astype(np.int64)


def _factors(where: str, given: Any, n: int, si: Sequence[str | None] | None) -> list[float]:
    """Factors to SI of n columns, of one unit or a list; si: their SI units, where known: columns
    that have none need none. Raises InputError on other units."""
    if given is None and si and all(unit == "1" for unit in si):
        return [1.0] * n
    units = [given] * n if isinstance(given, str) else given
    if not isinstance(units, list) or len(units) != n or not all(isinstance(u, str) for u in units):
        like = f" such as {si[0]!r}" if si and si[0] else ""
        each = f", or one for each of {n}" if n > 1 else ""
        raise InputError(
            f"{where}: found {given!r}, expected a unit{like}{each}; '1' is that of numbers"
            " without any"
        )
    expected = si if si is not None and len(si) == n else [None] * n
    try:
        return [
            si_scale(u) if e is None else unit_scale(u, e)
            for u, e in zip(units, expected, strict=True)
        ]
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _check_units(
    where: str, options: Mapping[str, Any], units: Sequence[str | None] | None
) -> None:
    """Raise InputError on units that are none, or of something else, before there is a file."""
    for key, unit, si in (("columns", "unit", units), ("sigma", "sigma_unit", None)):
        if key in options:
            given, named = options.get(unit), options[key]
            # How many there are only the file knows: of what says nothing itself, one.
            lists = (x for x in (given, si, named) if isinstance(x, list) and x)
            _factors(f"{where}.{unit}", given, len(next(lists, "1")), si)


def _units(role: str, name: str, known: Known) -> tuple[list[str | None] | None, int | None]:
    """SI units of the columns, without those of a quaternion, and how many there are."""
    if role == "truth":
        block = known.blocks.get(name)
        if block is None:
            return None, None
        return ([], 0) if block.manifold == "SO3" else ([block.unit] * block.dim, block.dim)
    if role == "sensors" and name in known.sensors:
        columns = tuple(known.sensors[name].columns)
    elif role == "inputs" and name in known.inputs:
        columns = known.inputs[name]
    else:
        return None, None
    own = [c for c in columns if c not in QUATERNION]
    return [column_unit(c) for c in own], len(own)


def targets_of(
    given: Mapping[str, Any], time: Mapping[str, Any] | None, known: Known
) -> list[Target]:
    """All that a mapping names: given, tables by name of "sensors", "inputs" and "truth"; time: the
    stamps of those without their own. Raises InputError on another form, and on nothing."""
    targets = []
    for role, tables in given.items():
        for name, options in _tables(f"data.options.{role}", tables).items():
            where = f"data.options.{role}.{name}"
            options = _tables(where, options)
            _check(where, role, options)
            stamps = StampColumn.of(
                f"{where}.time" if "time" in options else "data.options.time",
                options.get("time", time),
            )
            units, count = _units(role, name, known)
            if count is not None and (count > 0) != ("columns" in options):
                raise InputError(f"{where}: found {', '.join(options)}, expected {count} columns")
            _check_units(where, options, units)
            targets.append(Target(where, role, name, stamps, options, units))
    if not targets:
        raise InputError(
            "data.options: found nothing named, expected tables of sensors, inputs or truth by name"
        )
    return targets


def _tables(where: str, found: Any) -> Mapping[str, Any]:
    if not isinstance(found, Mapping | None):
        raise InputError(f"{where}: found {found!r}, expected a table")
    return found or {}


def _check(where: str, role: str, options: Mapping[str, Any]) -> None:
    """Raise InputError on keys and words that a target does not have."""
    unknown = [key for key in options if key not in _KEYS[role]]
    if unknown:
        raise InputError(f"{where}: unknown key {unknown[0]!r}; known are {', '.join(_KEYS[role])}")
    for key, words in _CHOICES.items():
        if key in options and options[key] not in words:
            found = f"{where}.{key}: found {options[key]!r}"
            raise InputError(f"{found}, expected {' or '.join(words)}")
    for key in ("inverse", "transpose"):
        if not isinstance(options.get(key, False), bool):
            raise InputError(f"{where}.{key}: found {options[key]!r}, expected true or false")
    attitudes = [key for key in _ATTITUDES if key in options]
    if len(attitudes) > 1 or not (attitudes or "columns" in options):
        raise InputError(
            f"{where}: found {', '.join(attitudes) or 'neither'}, expected columns or one of"
            f" {', '.join(_ATTITUDES)}"
        )
    if role == "truth" and attitudes and "columns" in options:
        raise InputError(f"{where}: found columns and an attitude, expected one block")
