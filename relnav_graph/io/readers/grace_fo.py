"""Reader of precise orbits of two spacecraft, as the GRACE-FO files of the GEORB software.

Orbits by T. D. Papanikolaou, "Precise orbit determination and accelerometry calibration
modelling of the GRACE Follow-On mission", Earth and Planetary Physics 2023: one text file for
each spacecraft, with a header, then a line for each epoch: modified Julian day, seconds of the
day (Terrestrial Time), position in m and velocity in m/s in the celestial frame (ICRF).

That frame is i, and o is i. The files hold no measurement: these orbits are the truth, on
which a scenario simulates its sensors (``data.simulate``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.io.orbits import (
    DAY,
    Orbit,
    check_state,
    in_common,
    in_order,
    relative_truth,
    split,
    two_orbits,
)
from relnav_graph.maths.instants import Instant

__all__ = ["read"]


_END = "end_of_header"
#: Values accepted in the header, by key.
_EXPECTED = {"Reference Frame": ("ICRF", "GCRF"), "Time scale": ("Terrestrial Time", "TT")}


def _header(path: Path, lines: list[str]) -> tuple[str, int]:
    """The spacecraft's name, and how many lines the header has."""
    entries: dict[str, tuple[int, str]] = {}
    for number, line in enumerate(lines, 1):
        if line.strip() == _END:
            break
        key, colon, value = line.partition(":")
        if colon:
            entries[key.strip()] = number, value.strip()
    else:
        raise InputError(f"{path}: found {len(lines)} lines and no line {_END!r}")
    for key, accepted in _EXPECTED.items():
        if key not in entries:
            raise InputError(f"{path}: found no line {key!r} in the header")
        at, value = entries[key]
        if value not in accepted:
            raise InputError(
                f"{path}, line {at}: found {key} {value!r}, expected {' or '.join(accepted)}"
            )
    for key, (_, value) in entries.items():
        if key.startswith("Orbiting Object"):
            return value, number
    raise InputError(f"{path}: found no line 'Orbiting Object/Satellite' in the header")


def _row(path: Path, number: int, line: str) -> list[float]:
    try:
        row = [float(word) for word in line.split()]
    except ValueError as error:
        raise InputError(f"{path}, line {number}: found {line.strip()!r}: {error}") from error
    if len(row) != 8:
        raise InputError(
            f"{path}, line {number}: found {len(row)} numbers, expected 8: day, seconds, X Y Z"
            " (m), Vx Vy Vz (m/s)"
        )
    if not np.isfinite(row).all():
        raise InputError(f"{path}, line {number}: found a number that is not finite")
    check_state(f"{path}, line {number}", row[2:])
    return row


def _orbit(path: Path) -> Orbit:
    try:
        lines = read_file(path).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a readable text: {error}") from error
    name, skip = _header(path, lines)
    numbers = [n for n, line in enumerate(lines, 1) if n > skip and line.strip()]
    rows = [_row(path, n, lines[n - 1]) for n in numbers]
    table = np.array(rows).reshape(-1, 8)
    orbit = Orbit(path, name, table[:, 0], table[:, 1], np.ascontiguousarray(table[:, 2:]))
    in_order(path, numbers, orbit.since(rows[0][0] if rows else 0.0))
    return orbit


def read(
    folder: Path, run: str = "", chaser: str = "", start: float = 0.0, duration: float | None = None
) -> Recording:
    """The orbits of two spacecraft at the epochs that both files have.

    run: a part of the file names, where a folder holds several pairs; chaser: the spacecraft
    that plays it, by its name in the header, else the second of the two names in order; start,
    duration: the part of the pass to take, s from its first epoch. Times start at zero with
    the first epoch taken.

    Truth: relative_position r_tc, m, and relative_velocity v_tc, m/s, of the chaser from the
    target, chaser_position r_c, m, and chaser_velocity v_c, m/s, in i.

    Settings: the absolute time of t = 0.

    Raises InputError, with file and line, on files that are missing, damaged, of another
    frame or time scale, in other units, and when they have no two epochs in common.
    """
    target, craft = two_orbits(folder, "*.orb", run, chaser, _orbit)
    day = min(target.day[0], craft.day[0])
    t, state_t, state_c = in_common(target, craft, day, start, duration)
    times = t - t[0]
    source = f"precise orbits, {craft.name} (chaser) and {target.name} (target)"
    truth = Truth(times, relative_truth(split(state_t), split(state_c)), source)
    began = Instant.of(int(day), (day - int(day)) * DAY + float(t[0]), "TT")
    return Recording(times, (), {}, truth, {"time": {"epoch": str(began)}})
