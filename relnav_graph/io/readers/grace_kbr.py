"""Reader of the K-band range between the two GRACE satellites, with their precise orbits.

The reference files of LEOGPS (S. Low, github.com/sammmlow/LEOGPS): CSV without header, packed or
not, a row for each epoch. Of each spacecraft ``*_truth.csv``, orbits by the CODE analysis centre:
day (27/7/2010), time of day (GPS), X Y Z in km, Vx Vy Vz in dm/s, in Earth-fixed axes, and relative
to these; and ``*_rng.csv``: day, time, range in m, which is integrated from the range rate: it has
an unknown constant, and wanders by a centimetre in half an hour.

Orbits are turned into the celestial frame: i, and o is i. They are the truth, on which a scenario
simulates other sensors (``data.simulate``). What the range has beyond the distance of the orbits is
the truth of its bias.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.orbits import (
    DAY,
    SAME,
    Orbit,
    celestial,
    check_state,
    excess,
    in_common,
    in_order,
    relative_truth,
    two_orbits,
)
from relnav_graph.io.packed import one_file, read_rows
from relnav_graph.maths.instants import Instant

__all__ = ["read"]

_ORBIT, _RANGE = "*_truth.csv*", "*_rng.csv*"
_KM, _DM_S = 1e3, 0.1
#: `date.toordinal` of the modified Julian day 0.
_ORDINAL = 678576
_DATE = re.compile(r"(\d{1,2})/(\d{1,2})/(\d{4})", re.ASCII)
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:\.\d*)?)", re.ASCII)


def _time(where: str, day: str, clock: str) -> tuple[float, float]:
    """The modified Julian day, and seconds of it."""
    found_day, found_time = _DATE.fullmatch(day.strip()), _CLOCK.fullmatch(clock.strip())
    if found_day is None or found_time is None:
        raise InputError(
            f"{where}: found {day!r}, {clock!r}, expected day/month/year, hours:minutes:seconds"
        )
    of_month, month, year = (int(n) for n in found_day.groups())
    hours, minutes, seconds = (float(n) for n in found_time.groups())
    try:
        mjd = date(year, month, of_month).toordinal() - _ORDINAL
    except ValueError as error:
        raise InputError(f"{where}: found the day {day!r}: {error}") from error
    if not (hours < 24 and minutes < 60 and seconds < 60):
        raise InputError(f"{where}: found {clock!r}: there is no such time of a day")
    return float(mjd), 3600 * hours + 60 * minutes + seconds


def _table(path: Path, columns: Sequence[str]) -> tuple[list[int], Array]:
    """The numbers of the lines, and rows (N, 2 + columns): day, seconds, then the numbers."""
    numbers, rows = [], []
    for number, row in read_rows(path):
        where = f"{path}, line {number}"
        if len(row) != 2 + len(columns):
            names = ", ".join(("day", "time", *columns))
            raise InputError(
                f"{where}: found {len(row)} columns, expected {2 + len(columns)}: {names}"
            )
        try:
            values = [float(word) for word in row[2:]]
        except ValueError as error:
            raise InputError(f"{where}: found {','.join(row)!r}: {error}") from error
        if not np.isfinite(values).all():
            raise InputError(f"{where}: found a number that is not finite")
        numbers.append(number)
        rows.append([*_time(where, row[0], row[1]), *values])
    table = np.array(rows).reshape(-1, 2 + len(columns))
    in_order(path, numbers, (table[:, 0] - table[:1, 0]) * DAY + table[:, 1])
    return numbers, table


def _orbit(path: Path) -> Orbit:
    """One orbit, Earth-fixed, m and m/s."""
    axes = (*(f"{x} (km)" for x in "XYZ"), *(f"V{x} (dm/s)" for x in "xyz"))
    numbers, table = _table(path, axes)
    state = table[:, 2:] * np.repeat([_KM, _DM_S], 3)
    for number, row in zip(numbers, state, strict=True):
        check_state(f"{path}, line {number}", row.tolist(), ("m for km", "another unit for dm/s"))
    name = path.name.partition("_truth")[0]
    return Orbit(path, name, table[:, 0], table[:, 1], np.ascontiguousarray(state))


def _ranges(path: Path, day: float) -> tuple[Array, Array]:
    """Times (N,), s since a day, and ranges (N,), m."""
    numbers, table = _table(path, ("range (m)",))
    bad = np.nonzero(~(table[:, 2] > 0))[0]
    if len(bad):
        found = f"found a range of {table[bad[0], 2]} m"
        raise InputError(f"{path}, line {numbers[bad[0]]}: {found}, expected one above 0")
    return (table[:, 0] - day) * DAY + table[:, 1], table[:, 2]


def read(
    folder: Path,
    sensor: str = "range",
    run: str = "",
    chaser: str = "",
    start: float = 0.0,
    duration: float | None = None,
    orientation: str = "",
) -> Recording:
    """The range, and the orbits at the epochs that both have.

    sensor: name that the range gets, "": it is left out; run: a part of the file names, where a
    folder holds several passes; chaser: the spacecraft that plays it, by what stands before
    "_truth" in the file's name, else the second of the two in order; start, duration: the part of
    the pass to take, s from its first epoch; orientation: a file finals2000A of the IERS, as of
    [time], with which the orbits are turned, too. Times start at zero with the first epoch taken.

    Measurements: the range, m, (1, 1). Truth: relative_position r_tc, m, and relative_velocity
    v_tc, m/s, of the chaser from the target, chaser_position r_c, m, and chaser_velocity v_c, m/s,
    in i; with the range range_bias, m, the mean over the pass of what it is more than the distance
    of the orbits, and range_drift, m, the rest, with the range's own noise in it. Settings: the
    absolute time of t = 0.

    Raises InputError, with file and line, on files that are missing, damaged, in other units, and
    when they have no two epochs in common.
    """
    target, craft = two_orbits(folder, _ORBIT, run, chaser, _orbit)
    day = min(target.day[0], craft.day[0])
    t, state_t, state_c = in_common(target, craft, day, start, duration)
    first, end = t[0], t[-1]
    times, begin = t - first, Instant.of(int(day), float(first), "GPS")
    table = AbsoluteTime(str(begin), orientation).table
    of_target, of_chaser = (celestial(begin, times, x, table) for x in (state_t, state_c))
    values = relative_truth(of_target, of_chaser)
    measurements: tuple[Measurement, ...] = ()
    source = f"precise orbits, {craft.name} (chaser) and {target.name} (target)"
    if sensor:
        path = one_file(folder, _RANGE, run)
        assert path is not None  # it is needed
        at, ranges = _ranges(path, day)
        taken = (at >= first - SAME) & (at <= end + SAME)
        at, ranges = at[taken] - first, ranges[taken]
        ids = np.zeros(1, dtype=np.int64)
        pairs = zip(at, ranges, strict=True)
        measurements = tuple(Measurement(sensor, float(s), np.array([[z]]), ids) for s, z in pairs)
        distance = np.linalg.norm(values["relative_position"], axis=1)
        bias, drift = excess(path, at, ranges, times, distance)
        values |= {"range_bias": bias, "range_drift": drift}
    truth = Truth(times, values, source)
    return Recording(times, measurements, {}, truth, {"time": {"epoch": str(begin)}})
