"""Reader of precise orbits of two spacecraft, as the GRACE-FO files of the GEORB software.

Orbits by T. D. Papanikolaou, "Precise orbit determination and accelerometry calibration
modelling of the GRACE Follow-On mission", Earth and Planetary Physics 2023: one text file for
each spacecraft, with a header, then a line for each epoch: modified Julian day, seconds of the
day (Terrestrial Time), position in m and velocity in m/s in the celestial frame (ICRF).

That frame is i, and o is i. The files hold no measurement: these orbits are the truth, on
which a scenario simulates its sensors (``data.simulate``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.maths.instants import Instant

__all__ = ["read"]


_END = "end_of_header"
#: Values accepted in the header, by key.
_EXPECTED = {"Reference Frame": ("ICRF", "GCRF"), "Time scale": ("Terrestrial Time", "TT")}
_DAY = 86400.0
#: Stamps of both files closer than that, s, are the same.
_SAME = 1e-5
#: Lengths of position, m, and velocity, m/s, that an orbit about the Earth can have.
_PLACES, _SPEEDS = (6.3e6, 1e9), (10.0, 11.2e3)


@dataclass(frozen=True, eq=False)
class _Orbit:
    """One file: the spacecraft's name, day and seconds of each epoch (N,), position and
    velocity (N, 6)."""

    path: Path
    name: str
    day: Array
    seconds: Array
    state: Array

    def since(self, day: float) -> Array:
        """Seconds since the beginning of a day (N,)."""
        return (self.day - day) * _DAY + self.seconds


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
    for what, unit, v, (low, high) in (
        ("position", "m", row[2:5], _PLACES),
        ("velocity", "m/s", row[5:8], _SPEEDS),
    ):
        length = float(np.linalg.norm(v))
        if not low < length < high:
            raise InputError(
                f"{path}, line {number}: found a {what} of {length:.6g} {unit}, expected one of"
                f" an orbit about the Earth, {low:g} to {high:g} {unit} (k{unit} given?)"
            )
    return row


def _orbit(path: Path) -> _Orbit:
    try:
        lines = read_file(path).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a readable text: {error}") from error
    name, skip = _header(path, lines)
    numbers = [n for n, line in enumerate(lines, 1) if n > skip and line.strip()]
    rows = [_row(path, n, lines[n - 1]) for n in numbers]
    if len(rows) < 2:
        raise InputError(f"{path}: found {len(rows)} epochs, expected two or more")
    table = np.array(rows)
    orbit = _Orbit(path, name, table[:, 0], table[:, 1], np.ascontiguousarray(table[:, 2:]))
    backwards = np.diff(orbit.since(table[0, 0])) <= 0
    if backwards.any():
        n = numbers[int(np.nonzero(backwards)[0][0]) + 1]
        raise InputError(f"{path}, line {n}: found a time that is not after the one before")
    return orbit


def _pair(folder: Path, run: str, chaser: str) -> tuple[_Orbit, _Orbit]:
    """The orbits of target and chaser."""
    paths = sorted(p for p in folder.glob("*.orb") if run in p.name)
    if len(paths) != 2:
        hint = "; name the pass by a part of both, data.options.run" if len(paths) > 2 else ""
        names = ", ".join(p.name for p in paths) or "no file"
        raise InputError(f"{folder}: found {names}, expected two files *.orb{hint}")
    one, other = sorted((_orbit(p) for p in paths), key=lambda orbit: orbit.name)
    if one.name == other.name:
        raise InputError(f"{folder}: found two orbits of {one.name}, expected two spacecraft")
    if chaser == one.name:
        return other, one
    if chaser not in ("", other.name):
        raise InputError(
            f"data.options.chaser: found {chaser!r}, expected {one.name!r} or {other.name!r}"
        )
    return one, other


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
    target, craft = _pair(folder, run, chaser)
    day = min(target.day[0], craft.day[0])
    t, own = craft.since(day), target.since(day)
    k = np.clip(np.searchsorted(own, t - _SAME), 0, len(own) - 1)
    both = np.abs(own[k] - t) <= _SAME
    k, t, r_c = k[both], t[both], craft.state[both]
    if len(t) < 2:
        raise InputError(
            f"{target.path} and {craft.path}: found {len(t)} epochs in common, expected two or"
            " more: are they of the same day and time scale?"
        )
    first = t[0]
    t = t - first
    end = np.inf if duration is None else start + duration
    part = (t >= start - _SAME) & (t <= end + _SAME)
    if part.sum() < 2:
        raise InputError(
            f"data.options: found start = {start} s and duration = {duration} s, expected two"
            f" epochs or more of 0 to {t[-1]:g} s"
        )
    r_c, r_tc = r_c[part], (r_c - target.state[k])[part]
    values = {
        "relative_position": np.ascontiguousarray(r_tc[:, :3]),
        "relative_velocity": np.ascontiguousarray(r_tc[:, 3:]),
        "chaser_position": np.ascontiguousarray(r_c[:, :3]),
        "chaser_velocity": np.ascontiguousarray(r_c[:, 3:]),
    }
    times = t[part] - t[part][0]
    source = f"precise orbits, {craft.name} (chaser) and {target.name} (target)"
    began = Instant.of(int(day), (day - int(day)) * _DAY + float(first + t[part][0]), "TT")
    return Recording(times, (), {}, Truth(times, values, source), {"time": {"epoch": str(began)}})
