"""Absolute time: whole nanoseconds of TAI, from and to other time scales.

TT = TAI + 32.184 s; GPS = TAI - 19 s; UTC = TAI - leap seconds, from 1972 on; TDB is within 2 ms of
TT (Fairhead and Bretagnon 1990, as in ERFA). Leap seconds: the table of pyerfa, which says itself
that it expired years ago; `REVIEWED` is up to when it was compared with the IERS's bulletins.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from functools import cache
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError

__all__ = ["REVIEWED", "SCALES", "Instant", "calendar", "moved", "since_first"]

_LOG = logging.getLogger(__name__)
SCALES = ("TT", "TAI", "UTC", "GPS", "TDB")
EXAMPLE = '"2021-07-17T00:00:00 TT"'
DAY = 86400.0
#: Nanoseconds of a second and of a day.
NS = 10**9
DAY_NS = 86400 * NS
#: TT - TAI and TAI - GPS, s.
TT_TAI, TAI_GPS = 32.184, 19.0
#: What is added to each scale for TAI, ns.
_TO_TAI = {"TT": -32184000000, "TAI": 0, "GPS": 19 * NS}
#: A date as year-month-day or year-day of the year, and a time of day.
_FORM = re.compile(r"(\d{4}-(?:\d\d-\d\d|\d{3}))[T ](\d\d):(\d\d):(\d\d)(?:\.(\d*))?Z?", re.ASCII)
_SCALED = re.compile(r"(.*?)(?:\s*([A-Za-z]\w*))?", re.ASCII)
#: `date.toordinal` of the modified Julian day 0, 1858-11-17.
_ORDINAL = 678576
#: Up to this day no leap second has been added that the table lacks: as announced (IERS
#: Bulletin C 70, for the end of 2025; one is announced half a year before). From there on, a table
#: that has not got a later one may be too old by a second: 465 m at the equator.
REVIEWED = date(2026, 6, 28)


@cache
def _leaps() -> tuple[tuple[int, int], ...]:
    """From which modified Julian day of UTC on TAI - UTC is how many seconds, from 1972 on."""
    table = erfa.leap_seconds.get()
    rows = [(date(int(y), int(m), 1), int(s)) for y, m, s in table if y >= 1972]
    return tuple((day.toordinal() - _ORDINAL, s) for day, s in rows)


@cache
def leap_seconds(day: int) -> int:
    """TAI - UTC, s, on a modified Julian day of UTC; says once of a day that leap seconds may be
    missing. Raises InputError before 1972."""
    found = [seconds for start, seconds in _leaps() if start <= day]
    if not found:
        raise InputError(
            f"found a time in UTC on {_written(day)}, expected one from 1972 on, when UTC began to"
            " differ from TAI by whole seconds"
        )
    last = max(REVIEWED, date.fromordinal(_leaps()[-1][0] + _ORDINAL))
    if day + _ORDINAL > last.toordinal():
        _LOG.warning(
            "leap seconds are known until %s; on %s UTC counts as TAI - %d s",
            *(last, _written(day), found[-1]),
        )
    return found[-1]


@cache
def _written(day: int) -> str:
    ordinal = day + _ORDINAL
    return date.fromordinal(ordinal).isoformat() if 0 < ordinal < 3652060 else f"MJD {day}"


@cache
def _day(text: str) -> int:
    """The modified Julian day of a date, "2021-07-17" or "2021-198"."""
    if len(text) == 10:
        return date.fromisoformat(text).toordinal() - _ORDINAL
    year, of_year = int(text[:4]), int(text[5:])
    first = date(year, 1, 1).toordinal()
    if not 0 < of_year <= date(year, 12, 31).toordinal() - first + 1:
        raise ValueError(f"day {of_year} is not in the year {year}")
    return first - _ORDINAL + of_year - 1


def calendar(text: str, scale: str) -> int:
    """Nanoseconds of TAI since 1858-11-17 of a date and time in a scale, one of `SCALES`: as
    "2021-07-17T00:00:00.5" or "2021-198T00:00:00.5Z"; what is finer than that is rounded.

    Raises InputError on another form, on a day or a time of day that does not exist (a second 60
    does where it is a leap second of UTC), on another scale, on UTC before 1972.
    """
    match = _FORM.fullmatch(text)
    if match is None:
        raise InputError(f"found {text!r}, expected a date and a time as 2021-07-17T00:00:00.5")
    try:
        day = _day(match[1])
    except ValueError as error:
        raise InputError(f"found {text!r}: {error}") from error
    hour, minute, second = int(match[2]), int(match[3]), int(match[4])
    if not (hour < 24 and minute < 60 and second < 60) and not (
        (hour, minute, second, scale) == (23, 59, 60, "UTC")
        and leap_seconds(day + 1) > leap_seconds(day)
    ):
        raise InputError(f"found {text!r}: there is no such time on that day")
    fraction, ns = match[5] or "", (3600 * hour + 60 * minute + second) * NS
    if fraction:
        digits = int(fraction)
        ns += digits * 10 ** (9 - len(fraction)) if len(fraction) < 10 else _rounded(fraction)
    return _tai(day, ns, scale)


def _rounded(fraction: str) -> int:
    """Digits of a fraction of a second as whole nanoseconds."""
    unit: int = 10 ** (len(fraction) - 9)
    return (int(fraction) + unit // 2) // unit


def _tai(day: int, ns: int, scale: str) -> int:
    """Nanoseconds of TAI of a modified Julian day and nanoseconds of it in a scale."""
    own = day * DAY_NS + ns
    if scale in _TO_TAI:
        return own + _TO_TAI[scale]
    if scale == "UTC":
        return own + leap_seconds(day) * NS
    if scale == "TDB":
        return own + _TO_TAI["TT"] - _tdb_ahead(own)
    raise InputError(f"found the time scale {scale!r}, expected one of {', '.join(SCALES)}")


def _tdb_ahead(ns: int) -> int:
    """TDB - TT, ns, at a time (ns since day 0) of either: they differ too little for more."""
    day, of_day = divmod(ns, DAY_NS)
    at = of_day / DAY_NS
    return round(float(erfa.dtdb(2400000.5, day + at, at, 0.0, 0.0, 0.0)) * NS)


def since_first(ns: Sequence[int]) -> Array:
    """Seconds (N,) since the first of whole nanoseconds, each the double nearest to it."""
    return np.array([n - ns[0] for n in ns], dtype=np.int64) / NS


def moved(t: Any, by: int) -> Any:
    """Times t, s, whole nanoseconds nearest to them, moved by whole nanoseconds: so that one
    instant has one number, from whichever epoch it was counted."""
    seconds = np.floor(np.asarray(t, dtype=np.float64))
    rest: NDArray[np.int64] = np.rint((t - seconds) * NS).astype(np.int64)  # of t itself: it rounds
    return (seconds.astype(np.int64) * NS + rest + by) / NS


@dataclass(frozen=True, order=True)
class Instant:
    """An absolute time: tai, whole nanoseconds of TAI since 1858-11-17."""

    tai: int

    @staticmethod
    def of(day: int, seconds: float, scale: str) -> Instant:
        """From a modified Julian day and seconds of it in a time scale, one of `SCALES`, to the
        nearest nanosecond.

        Raises InputError on another scale, on UTC before 1972, on numbers that are not finite.
        """
        return Instant(_tai(int(day), _ns(seconds), scale))

    @staticmethod
    def parse(text: str) -> Instant:
        """From a text as "2021-07-17T00:00:00.5 TT", in one of `SCALES`, which must be named.

        Raises InputError on another form, on a day or a time of day that does not exist.
        """
        match = _SCALED.fullmatch(text.strip())
        if match is None or _FORM.fullmatch(match[1]) is None:
            raise InputError(f"found {text!r}, expected a date, a time and a scale as {EXAMPLE}")
        if match[2] is None or match[2] == "Z":
            raise InputError(
                f"found {text!r} without a time scale, expected one of {', '.join(SCALES)} after"
                f" it, as {EXAMPLE}"
            )
        try:
            return Instant(calendar(match[1], match[2]))
        except InputError as error:
            raise InputError(str(error).replace(repr(match[1]), repr(text))) from error

    def after(self, t: float) -> Instant:
        """The instant t seconds later, to the nearest nanosecond."""
        return Instant(self.tai + _ns(t))

    def since(self, other: Instant) -> float:
        """Seconds from another instant to this one."""
        return self.ns_since(other) / NS

    def ns_since(self, other: Instant) -> int:
        """Nanoseconds from another instant to this one."""
        return self.tai - other.tai

    @property
    def day(self) -> int:
        """The modified Julian day of TT."""
        return self.in_scale("TT")[0]

    @property
    def seconds(self) -> float:
        """Seconds of the day of TT."""
        return self.in_scale("TT")[1] / NS

    @property
    def tai_utc(self) -> int:
        """TAI - UTC, s, here. Raises InputError before 1972."""
        return leap_seconds(self.in_scale("UTC")[0])

    def in_scale(self, scale: str) -> tuple[int, int]:
        """The modified Julian day in a scale, and nanoseconds of it: in a leap second of UTC those
        of a day and more. Raises InputError on another scale, and on UTC before 1972."""
        if scale == "UTC":
            day = (self.tai - leap_seconds(self.tai // DAY_NS) * NS) // DAY_NS
            while _tai(day + 1, 0, scale) <= self.tai:
                day += 1
            while _tai(day, 0, scale) > self.tai:
                day -= 1
            return day, self.tai - _tai(day, 0, scale)
        if scale == "TDB":
            tt = self.tai - _TO_TAI["TT"]
            return divmod(tt + _tdb_ahead(tt), DAY_NS)
        return divmod(self.tai - (_tai(0, 0, scale)), DAY_NS)

    def calendar(self, scale: str) -> str:
        """As `calendar` reads it, without the scale: "2021-07-17T00:00:00.5"."""
        day, ns = self.in_scale(scale)
        second, ns = divmod(ns, NS)
        minute = min(second // 60, 1439)  # a leap second is the 61st of the last minute
        fraction = f".{ns:09d}".rstrip("0").rstrip(".")
        clock = f"{minute // 60:02d}:{minute % 60:02d}:{second - 60 * minute:02d}"
        return f"{_written(day)}T{clock}{fraction}"

    def __str__(self) -> str:
        """As `parse` reads it, in TT."""
        return f"{self.calendar('TT')} TT"


def _ns(seconds: float) -> int:
    """Whole nanoseconds nearest to seconds. Raises InputError on a number that is not finite."""
    if not math.isfinite(seconds):
        raise InputError(f"found {seconds} seconds, expected a finite number")
    whole = math.floor(seconds)
    return whole * NS + round((seconds - whole) * NS)
