"""Orbits of two spacecraft from files: what all readers of them check, and the epochs of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.maths.earth import EarthTable, gcrf_from_itrf
from relnav_graph.maths.instants import Instant

__all__ = [
    "DAY",
    "SAME",
    "Orbit",
    "celestial",
    "check_state",
    "check_states",
    "excess",
    "in_common",
    "in_order",
    "part_of",
    "relative_truth",
    "roles",
    "split",
    "two_orbits",
]

DAY = 86400.0
#: Stamps of both files closer than that, s, are the same.
SAME = 1e-5
#: Lengths of position, m, and velocity, m/s, that an orbit about the Earth can have.
_PLACES, _SPEEDS = (6.3e6, 1e9), (10.0, 11.2e3)
#: A measured range and the distance of the orbits differ by less than that share, both in m.
_LIKE = 0.01


@dataclass(frozen=True, eq=False)
class Orbit:
    """One file: the spacecraft's name, day and seconds of each epoch (N,), position and
    velocity (N, 6), m and m/s."""

    path: Path
    name: str
    day: Array
    seconds: Array
    state: Array

    def since(self, day: float) -> Array:
        """Seconds since the beginning of a day (N,)."""
        return (self.day - day) * DAY + self.seconds


def check_state(where: str, state: list[float], hints: tuple[str, str] = ("km", "km/s")) -> None:
    """Raise InputError unless position and velocity (6,), m and m/s, can be of an orbit.

    where: file and line; hints: the units that one may have given for the right ones.
    """
    for what, unit, v, (low, high), hint in (
        ("position", "m", state[:3], _PLACES, hints[0]),
        ("velocity", "m/s", state[3:], _SPEEDS, hints[1]),
    ):
        length = float(np.linalg.norm(v))
        if not low < length < high:
            raise InputError(
                f"{where}: found a {what} of {length:.6g} {unit}, expected one of an orbit about"
                f" the Earth, {low:g} to {high:g} {unit} ({hint} given?)"
            )


def check_states(
    where: Callable[[int], str], state: Array, hints: tuple[str, str] = ("km", "km/s")
) -> None:
    """As `check_state`, of states (N, 6), m and m/s. where: file and line of row k."""
    for part, (low, high) in ((state[:, :3], _PLACES), (state[:, 3:], _SPEEDS)):
        length = np.linalg.norm(part, axis=1)
        for k in np.flatnonzero(~((low < length) & (length < high))).tolist():
            check_state(where(k), state[k].tolist(), hints)


def in_order(path: Path, numbers: list[int], t: Array) -> None:
    """Raise InputError unless times t (N,), s, of the lines `numbers` are two or more, and rise."""
    if len(t) < 2:
        raise InputError(f"{path}: found {len(t)} epochs, expected two or more")
    backwards = np.diff(t) <= 0
    if backwards.any():
        n = numbers[int(np.nonzero(backwards)[0][0]) + 1]
        raise InputError(f"{path}, line {n}: found a time that is not after the one before")


def roles(folder: Path, orbits: list[Orbit], chaser: str) -> tuple[Orbit, Orbit]:
    """The orbits of target and chaser, of two.

    chaser: name of the spacecraft that plays it; "": the second of the names.
    """
    one, other = sorted(orbits, key=lambda orbit: orbit.name)
    if one.name == other.name:
        raise InputError(f"{folder}: found two orbits of {one.name}, expected two spacecraft")
    if chaser == one.name:
        return other, one
    if chaser not in ("", other.name):
        raise InputError(
            f"data.options.chaser: found {chaser!r}, expected {one.name!r} or {other.name!r}"
        )
    return one, other


def two_orbits(
    folder: Path, pattern: str, run: str, chaser: str, read: Callable[[Path], Orbit]
) -> tuple[Orbit, Orbit]:
    """The orbits of target and chaser, of the two files of a folder that fit a pattern and have
    `run` in their names; chaser: see `roles`. Raises InputError on fewer or more."""
    paths = sorted(p for p in folder.glob(pattern) if run in p.name)
    if len(paths) != 2:
        hint = "; name the pass by a part of both, data.options.run" if len(paths) > 2 else ""
        names = ", ".join(p.name for p in paths) or "no file"
        raise InputError(f"{folder}: found {names}, expected two files {pattern}{hint}")
    return roles(folder, [read(p) for p in paths], chaser)


def in_common(
    target: Orbit, craft: Orbit, day: float, start: float, duration: float | None
) -> tuple[Array, Array, Array]:
    """Times (N,), s since a day, of the epochs that both have, of the part that [data.options]
    takes (`part_of`), and the states (N, 6) of target and craft then. Raises InputError on fewer
    than two."""
    t, own = craft.since(day), target.since(day)
    k = np.clip(np.searchsorted(own, t - SAME), 0, len(own) - 1)
    both = np.abs(own[k] - t) <= SAME
    if both.sum() < 2:
        raise InputError(
            f"{target.path} and {craft.path}: found {both.sum()} epochs in common, expected two or"
            " more: are they of the same day and time scale?"
        )
    part = part_of(t[both], start, duration)
    return t[both][part], target.state[k[both]][part], craft.state[both][part]


def split(state: Array) -> tuple[Array, Array]:
    """Positions and velocities (N, 3) of states (N, 6), m and m/s."""
    return np.ascontiguousarray(state[:, :3]), np.ascontiguousarray(state[:, 3:])


def relative_truth(target: tuple[Array, Array], craft: tuple[Array, Array]) -> dict[str, Array]:
    """What two orbits are as the truth, in i, by name: positions (N, 3), m, and velocities (N, 3),
    m/s, of target and chaser."""
    (r_t, v_t), (r_c, v_c) = target, craft
    return {
        "relative_position": r_c - r_t,
        "relative_velocity": v_c - v_t,
        "chaser_position": r_c,
        "chaser_velocity": v_c,
    }


def part_of(t: Array, start: float, duration: float | None) -> NDArray[np.bool_]:
    """Which of the times t (N,), s, are of the part that [data.options] takes, from `start`, s
    after the first, on. Raises InputError on fewer than two."""
    end = np.inf if duration is None else start + duration
    since = t - t[0]
    part: NDArray[np.bool_] = (since >= start - SAME) & (since <= end + SAME)
    if part.sum() < 2:
        raise InputError(
            f"data.options: found start = {start} s and duration = {duration} s, expected two"
            f" epochs or more of 0 to {since[-1]:g} s"
        )
    return part


def celestial(
    begin: Instant, t: Array, state: Array, table: EarthTable | None
) -> tuple[Array, Array]:
    """Positions and velocities (N, 3) in i of Earth-fixed ones (N, 6), m and m/s.

    t: (N,), s since an instant; table: the Earth's orientation, see
    `relnav_graph.maths.earth.gcrf_from_itrf`.
    """
    r, v = gcrf_from_itrf(begin, t, state[:, :3], state[:, 3:], table)
    return np.ascontiguousarray(r), np.ascontiguousarray(v)


def excess(
    path: Path, t: Array, ranges: Array, own: Array, distance: Array, like: bool = True
) -> tuple[Array, Array]:
    """What measured ranges (M,) at t (M,), s, are more than what the orbits say (N,) at own times
    (N,), s: the mean, as a bias (N, 1), and the rest, as a drift (N, 1); between measurements
    linear. Distances are in m, or rates in m/s with `like` False.

    Raises InputError when none are of one time, or, of distances, are too far from those.
    """
    k = np.clip(np.searchsorted(own, t - SAME), 0, len(own) - 1)
    both = np.abs(own[k] - t) <= SAME
    if not both.any():
        raise InputError(f"{path}: found no epoch in common with the orbits, expected some")
    more = ranges[both] - distance[k[both]]
    apart = float(np.median(distance[k[both]]))
    if like and abs(float(np.median(more))) > _LIKE * apart:
        raise InputError(
            f"{path}: found ranges of {np.median(ranges[both]):.6g} m, but the orbits are"
            f" {apart:.6g} m apart (another unit, or another pass?)"
        )
    found: Array = np.interp(own, t[both], more)
    bias = np.full((len(own), 1), found.mean())
    return bias, found[:, None] - bias
