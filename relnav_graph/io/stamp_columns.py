"""Columns of stamps as whole nanoseconds or decimals of seconds, as a mapping declares them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np

from relnav_graph.errors import InputError
from relnav_graph.io.clocks import CLOCKS, NANO, Clock, Stamps, decimal
from relnav_graph.io.columns import Columns
from relnav_graph.maths.instants import SCALES, Instant, calendar

__all__ = ["StampColumn"]

#: Seconds in a unit.
_UNITS = {
    "ns": Decimal("1e-9"),
    "us": Decimal("1e-6"),
    "ms": Decimal("1e-3"),
    "s": Decimal(1),
    "min": Decimal(60),
    "h": Decimal(3600),
    "days": Decimal(86400),
}
_KEYS = ("column", "unit", "clock", "calendar", "day_zero", "origin")
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_GREGORIAN = re.compile(r"(\d\d) ([A-Z][a-z]{2}) (\d{4}) (\S+)")
_UNIX_DAY = CLOCKS["tai"][0]
_MJD = Decimal("2400000.5")


@dataclass(frozen=True)
class StampColumn:
    """Which column has the stamps, and what they are.

    Numbers of a clock: `column`, its name; `unit`, ns, us, ms, s, min, h or days; `clock`, "none"
    or another name of `relnav_graph.io.clocks.Clock`; and maybe `origin`, the stamp of t = 0, s.
    Or dates: `calendar`, a time scale, of texts as 2021-07-17T00:00:00.5 or
    17 Jul 2021 00:00:00.5, or, with the unit "days", of days after `day_zero`, a Julian date: by
    default modified Julian days, GMAT's are 2430000.
    """

    where: str
    column: str
    unit: str
    clock: Clock
    calendar: str
    day_zero: Decimal

    @staticmethod
    def of(where: str, given: Any) -> StampColumn:
        """From a table of options. Raises InputError on another form; nothing is guessed."""
        if not isinstance(given, Mapping) or not isinstance(given.get("column"), str):
            raise InputError(
                f"{where}: found {given!r}, expected {{ column = NAME, unit = UNIT, clock = NAME }}"
            )
        unknown = [key for key in given if key not in _KEYS]
        if unknown:
            known = ", ".join(_KEYS)
            raise InputError(f"{where}: unknown key {unknown[0]!r}; known are {known}")
        scale, unit = str(given.get("calendar", "")), str(given.get("unit", ""))
        if ("clock" in given) == bool(scale):
            raise InputError(
                f"{where}: found {'both' if scale else 'neither'} of clock, one of none,"
                f" {', '.join(CLOCKS)}, and calendar, one of {', '.join(SCALES)}; expected one"
            )
        if scale and scale not in SCALES:
            raise InputError(f"{where}.calendar: found {scale!r}, expected {', '.join(SCALES)}")
        expected = ("", "days") if scale else tuple(_UNITS)
        if unit not in expected:
            listed = ", ".join(u or "none" for u in expected)
            raise InputError(f"{where}.unit: found {unit!r}, expected one of {listed}")
        zero = decimal(f"{where}.day_zero", str(given.get("day_zero", _MJD)))
        clock = Clock("tai") if scale else Clock(str(given["clock"]), given.get("origin"))
        return StampColumn(where, given["column"], unit, clock, scale, zero)

    def read(self, columns: Columns) -> Stamps:
        """The stamps (N,) of a file: of `self.clock`. Raises InputError, with the row, on what is
        no such stamp."""
        found = columns.get(self.column)
        if found.ndim != 1:
            raise InputError(
                f"{columns.path}: found stamps {self.column!r} of {found.shape}, expected (N,)"
            )
        if found.dtype.kind in "iu" and not self.calendar:
            scaled = _UNITS[self.unit] * NANO
            if found.dtype.kind == "u" and len(found) and int(found.max()) >= 2**63:
                raise InputError(f"{columns.path}: found the stamp {found.max()}, above 2^63")
            return found.astype(np.int64) * int(scaled)
        texts = (
            [str(x) for x in found] if found.dtype.kind in "UO" else [repr(float(x)) for x in found]
        )
        if not self.calendar:
            factor = _UNITS[self.unit]
            return [decimal(columns.where(k), x) * factor for k, x in enumerate(texts)]
        return np.array([self._date(columns.where(k), x) for k, x in enumerate(texts)], np.int64)

    def _date(self, where: str, text: str) -> int:
        """Nanoseconds of a date since 1970, of TAI."""
        try:
            if self.unit == "days":
                days = decimal(where, text) + self.day_zero - _MJD
                whole = days.to_integral_value("ROUND_FLOOR")
                tai = Instant.of(int(whole), float((days - whole) * 86400), self.calendar).tai
            else:
                tai = calendar(_iso(text.strip()), self.calendar)
        except InputError as error:
            raise InputError(
                f"{where}: {error}" if where not in str(error) else str(error)
            ) from error
        return tai - _UNIX_DAY * 86400 * NANO


def _iso(text: str) -> str:
    """A date in the form of ISO 8601, of one as GMAT writes it."""
    match = _GREGORIAN.fullmatch(text)
    if match is None or match[2] not in _MONTHS:
        return text
    return f"{match[3]}-{_MONTHS.index(match[2]) + 1:02d}-{match[1]}T{match[4]}"
