"""The clocks of files: stamps as whole nanoseconds or decimal texts, and seconds of a pass.

A float64 at a time of 1.7e9 s has steps of 240 ns: what is subtracted from stamps is subtracted
while they are whole numbers, or decimals as written, and only the difference becomes a float64.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import LATEST
from relnav_graph.errors import InputError
from relnav_graph.maths.instants import Instant, leap_seconds

__all__ = ["CLOCKS", "NANO", "Clock", "Stamps", "decimal", "nanoseconds"]

#: Stamps of a file: whole nanoseconds, or seconds as decimals.
Stamps = NDArray[np.int64] | Sequence[Decimal]

NANO = 1_000_000_000
_DAY = 86400
#: Of each clock that is absolute: the modified Julian day and the second of it of its zero, and its
#: time scale.
CLOCKS: dict[str, tuple[int, int, str]] = {
    "unix": (40587, 0, "UTC"),
    "gps": (44244, 0, "GPS"),
    "tai": (40587, 0, "TAI"),
    "tt": (51544, 43200, "TT"),
    "gps2000": (51544, 43200, "GPS"),
}
#: 1972-01-01, from when on UTC and leap seconds are known, in Unix time, s.
_UTC_BEGAN = 63072000
#: 2000-01-01 in Unix time, s: a thousand times what is before 1972 but reaches that are stamps in s
#: that somebody declared as ms.
_LIKELY = 946_684_800
#: Stamps of an absolute clock beyond that, s, about 2200, are no seconds.
_LAST = 7_258_118_400


def decimal(where: str, text: str) -> Decimal:
    """A stamp as it is written, with all its digits. Raises InputError on what is no number."""
    try:
        found = Decimal(text.strip())
    except InvalidOperation as error:
        raise InputError(f"{where}: found {text.strip()[:60]!r}, expected a time") from error
    if not found.is_finite():
        raise InputError(f"{where}: found {text.strip()!r}, expected a finite time")
    return found


def _whole_days(s: Decimal) -> int:
    """Days that have passed: `//` of decimals rounds towards zero."""
    return int((s / _DAY).to_integral_value("ROUND_FLOOR"))


@cache
def _leaps(day: int) -> int:
    return leap_seconds(day)


@dataclass(frozen=True)
class Clock:
    """Of which clock stamps are, and which of them is t = 0.

    name: "none", seconds of a clock of its own; "unix", without leap seconds, as computers count
    since 1970; "gps", since 1980-01-06; "tai", as CLOCK_TAI counts since 1970; "tt" or "gps2000",
    of TT or GPS since 2000-01-01T12:00:00 of that scale. origin: the stamp, s, of t = 0, as text
    or a whole number. Without it t = 0 is the whole second at or before the first stamp of an
    absolute clock, and zero of a clock of its own. Raises InputError on another clock, and on an
    origin that is no number.
    """

    name: str = "none"
    origin: str | int | float | None = None

    def __post_init__(self) -> None:
        if self.name not in ("none", *CLOCKS):
            known = ", ".join(("none", *CLOCKS))
            raise InputError(f"data.options.clock: found {self.name!r}, expected one of {known}")
        if isinstance(self.origin, bool) or not isinstance(self.origin, str | int | float | None):
            raise InputError(f"data.options.origin: found {self.origin!r}, expected a time in s")
        assert self.origin is None or self._given() is not None

    def _given(self) -> Decimal:
        return decimal("data.options.origin", str(self.origin))

    def begin(self, where: str, first: Decimal | int) -> Decimal:
        """The stamp of t = 0, s. first: the earliest of all, s, or whole ns as an int.

        Raises InputError on stamps of a clock of its own that are too late for a float64.
        """
        if self.origin is not None:
            return self._given()
        earliest = Decimal(int(first)) / NANO if isinstance(first, int | np.integer) else first
        if self.name == "unix" and earliest < _UTC_BEGAN:
            short = _LIKELY < earliest * 1000 < _LAST
            hint = ": are the stamps in s, not in ms?" if short else ""
            raise InputError(
                f"{where}: found the stamp {earliest} s, which in Unix time is before 1972{hint};"
                ' expected data.options.clock = "none", if it is of a clock of its own'
            )
        if self.name != "none" and earliest > _LAST:
            raise InputError(
                f"{where}: found the stamp {earliest} s, which by the clock {self.name!r} is after"
                " 2200: are the stamps in s?"
            )
        if self.name != "none":
            return earliest.to_integral_value("ROUND_FLOOR")
        if abs(earliest) > LATEST:
            raise InputError(
                f"{where}: found the stamp {earliest} s, which a float64 does not hold to a"
                " nanosecond; expected data.options.clock, the clock that it is of"
                f" ({', '.join(CLOCKS)}), or data.options.origin, the stamp of t = 0"
            )
        return Decimal(0)

    def seconds(self, stamps: Stamps, begin: Decimal) -> Array:
        """Times (N,), s, of stamps since that of t = 0, which is subtracted exactly.

        Of "unix" leap seconds in between are counted.
        """
        if isinstance(stamps, np.ndarray):
            nano = begin * NANO
            if nano != nano.to_integral_value():
                return self.seconds([Decimal(int(s)) / NANO for s in stamps], begin)
            out: Array = (stamps - int(nano)) / NANO
            days = stamps // (NANO * _DAY)
        else:
            out = np.array([float(s - begin) for s in stamps], dtype=np.float64)
            days = np.array([_whole_days(s) for s in stamps], dtype=np.int64)
        if self.name == "unix" and len(out):
            first, zero = _whole_days(begin), CLOCKS["unix"][0]
            more = {d: _leaps(zero + d) - _leaps(zero + first) for d in set(days.tolist())}
            if any(more.values()):
                out = out + np.array([more[d] for d in days.tolist()], dtype=np.float64)
        return out

    def settings(self, begin: Decimal) -> dict[str, Any]:
        """What a recording says of the absolute time of t = 0; {} of a clock of its own."""
        if self.name == "none":
            return {}
        day, second, scale = CLOCKS[self.name]
        days = _whole_days(begin + second)
        instant = Instant.of(day + days, float(begin + second - days * _DAY), scale)
        return {"time": {"epoch": str(instant)}}


def nanoseconds(t: Array, origin: str | int = 0, epoch: str = "") -> NDArray[np.int64]:
    """Stamps in whole ns (N,), the nearest ones, of times t (N,), s.

    origin: the stamp of t = 0, s, as text or a whole number; or epoch: its absolute time, as
    "2021-07-17T00:00:00 TT": stamps are Unix time then. Raises InputError on both, on an origin
    that is no time in ns, on stamps beyond int64, and on a leap second, in which Unix time has the
    same stamps twice.
    """
    begin = decimal("origin", str(origin)) * NANO
    if begin != begin.to_integral_value() or (begin and epoch):
        both = f" beside epoch {epoch!r}" if epoch else ""
        raise InputError(f"origin: found {origin!r} s{both}, expected whole nanoseconds, or epoch")
    if not np.isfinite(t).all() or np.abs(t).max(initial=0.0) + abs(float(begin)) / NANO > 9e9:
        raise InputError(f"found times up to {np.abs(t).max()} s, expected less than 9e9 s")
    # Whole seconds apart: a product of 1e9 with more than 53 bits would be rounded twice.
    whole, start = np.floor(t), int(begin)
    rest: NDArray[np.int64] = np.rint((t - whole) * NANO).astype(np.int64)
    found = whole.astype(np.int64) * NANO + rest
    if not epoch:
        return found + start
    zero, tai = CLOCKS["unix"][0], Instant.parse(epoch).tai
    days = (Instant(tai + n).in_scale("UTC") for n in found.tolist())
    unix = np.array([(day - zero) * _DAY * NANO + ns for day, ns in days], dtype=np.int64)
    back = np.flatnonzero((np.diff(unix) <= 0) & (np.diff(found) > 0))
    if len(back):
        raise InputError(
            f"found a leap second at t = {t[back[0] + 1]:.9g} s, in which Unix time falls back;"
            ' expected no epoch (epoch = ""), and an origin for stamps of another clock'
        )
    return unix
