"""Absolute time: days and seconds of Terrestrial Time, from and to other time scales.

TT = TAI + 32.184 s; GPS = TAI - 19 s; UTC = TAI - leap seconds, from 1972 on; TDB is within 2 ms of
TT (Fairhead and Bretagnon 1990, as in ERFA). Leap seconds: the table of pyerfa.
"""

from __future__ import annotations

import logging
import math
import re
from dataclasses import dataclass
from datetime import date
from functools import cache

import erfa

from relnav_graph.errors import InputError

__all__ = ["SCALES", "Instant"]

_LOG = logging.getLogger(__name__)
SCALES = ("TT", "TAI", "UTC", "GPS", "TDB")
EXAMPLE = '"2021-07-17T00:00:00 TT"'
DAY = 86400.0
#: TT - TAI and TAI - GPS, s.
TT_TAI, TAI_GPS = 32.184, 19.0
_FORM = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d):(\d\d(?:\.\d*)?)(?:\s*([A-Za-z]\w*))?", re.ASCII
)
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
def _told(day: int) -> None:
    """Say once of a day that leap seconds may be missing."""
    last = date.fromordinal(_leaps()[-1][0] + _ORDINAL)
    if day + _ORDINAL > max(REVIEWED, last).toordinal():
        _LOG.warning(
            "leap seconds are known until %s; on %s UTC counts as TAI - %d s",
            *(max(REVIEWED, last), date.fromordinal(day + _ORDINAL), _leaps()[-1][1]),
        )


def leap_seconds(day: int) -> int:
    """TAI - UTC, s, on a modified Julian day of UTC. Raises InputError before 1972."""
    found = [seconds for start, seconds in _leaps() if start <= day]
    if not found:
        raise InputError(
            f"found a time in UTC on {_written(day)}, expected one from 1972 on, when UTC began to"
            " differ from TAI by whole seconds"
        )
    _told(day)
    return found[-1]


def _written(day: int) -> str:
    ordinal = day + _ORDINAL
    return date.fromordinal(ordinal).isoformat() if 0 < ordinal < 3652060 else f"MJD {day}"


@dataclass(frozen=True)
class Instant:
    """An absolute time: day, the modified Julian day of TT, and seconds of it, 0 to 86400.

    Raises InputError on numbers that are not finite.
    """

    day: int
    seconds: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.seconds):
            raise InputError(f"found {self.seconds} seconds of a day, expected a finite number")
        whole = math.floor(self.seconds / DAY)
        object.__setattr__(self, "day", int(self.day) + whole)
        object.__setattr__(self, "seconds", float(self.seconds) - whole * DAY)

    @staticmethod
    def of(day: int, seconds: float, scale: str) -> Instant:
        """From a modified Julian day and seconds of it in a time scale, one of `SCALES`.

        Raises InputError on another scale, and on UTC before 1972.
        """
        if scale not in SCALES:
            raise InputError(f"found the time scale {scale!r}, expected one of {', '.join(SCALES)}")
        if scale == "UTC":
            return Instant(day, seconds + leap_seconds(day) + TT_TAI)
        if scale == "TDB":
            ahead = erfa.dtdb(2400000.5, day + seconds / DAY, seconds / DAY % 1.0, 0.0, 0.0, 0.0)
            return Instant(day, seconds - float(ahead))
        return Instant(day, seconds + {"TT": 0.0, "TAI": TT_TAI, "GPS": TAI_GPS + TT_TAI}[scale])

    @staticmethod
    def parse(text: str) -> Instant:
        """From a text as "2021-07-17T00:00:00.5 TT", in one of `SCALES`, which must be named.

        Raises InputError on another form, on a day or a time of day that does not exist.
        """
        match = _FORM.fullmatch(text.strip())
        if match is None:
            raise InputError(f"found {text!r}, expected a date, a time and a scale as {EXAMPLE}")
        *numbers, scale = match.groups()
        if scale is None:
            raise InputError(
                f"found {text!r} without a time scale, expected one of {', '.join(SCALES)} after"
                f" it, as {EXAMPLE}"
            )
        year, month, of_month, hour, minute = (int(n) for n in numbers[:5])
        second = float(numbers[5])
        try:
            day = date(year, month, of_month).toordinal() - _ORDINAL
        except ValueError as error:
            raise InputError(f"found {text!r}: {error}") from error
        last = 60.0
        if scale == "UTC" and (hour, minute) == (23, 59):
            last += leap_seconds(day + 1) - leap_seconds(day)
        if not (hour < 24 and minute < 60 and second < last):
            raise InputError(f"found {text!r}: there is no such time on that day")
        try:
            return Instant.of(day, 3600.0 * hour + 60.0 * minute + second, scale)
        except InputError as error:
            raise InputError(f"{text!r}: {error}") from error

    def after(self, t: float) -> Instant:
        """The instant t seconds later."""
        return Instant(self.day, self.seconds + t)

    def since(self, other: Instant) -> float:
        """Seconds from another instant to this one."""
        return (self.day - other.day) * DAY + (self.seconds - other.seconds)

    @property
    def tai_utc(self) -> int:
        """TAI - UTC, s, here. Raises InputError before 1972."""
        in_tai = self.after(-TT_TAI)
        found = [s for start, s in _leaps() if Instant(start, s).since(in_tai) <= 0]
        if not found:
            return leap_seconds(self.day)  # which says why there is none
        _told(self.day)
        return found[-1]

    def __str__(self) -> str:
        """As `parse` reads it, in TT."""
        micro = round(self.seconds * 1e6)
        day, micro = self.day + micro // 86400000000, micro % 86400000000
        minutes, micro = divmod(micro, 60000000)
        seconds = f"{micro / 1e6:09.6f}".rstrip("0").rstrip(".")
        return f"{_written(day)}T{minutes // 60:02d}:{minutes % 60:02d}:{seconds} TT"
