"""Orbit ephemeris messages (OEM, CCSDS 502.0-B): states of one object, in GCRF."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.axes import BODY, RTN, covariance_turns, frame_of, time_scale, to_gcrf
from relnav_graph.io.ccsds.message import Entry, Message, Row, Segment, number, read_message, scaled
from relnav_graph.io.covariances import from_triangle
from relnav_graph.io.orbits import check_states, part_of
from relnav_graph.maths.earth import EarthTable
from relnav_graph.maths.instants import NS, Instant, calendar, moved

__all__ = ["Ephemeris", "epochs_of", "read_ephemeris", "segments_of", "taken_part"]

_LOG = logging.getLogger(__name__)
#: The centre of an orbit that is about no spacecraft.
EARTH = "EARTH"
#: Other centres that are no spacecraft: those of the registry of SANA (orbit centers).
_OTHERS = {
    *("SUN", "MOON", "MERCURY", "VENUS", "MARS", "JUPITER", "SATURN", "URANUS", "NEPTUNE", "PLUTO"),
    *("EARTH BARYCENTER", "EARTH-MOON BARYCENTER", "EARTH-MOON", "SOLAR SYSTEM BARYCENTER"),
    *("SSB", "EMB", "MARS BARYCENTER", "JUPITER BARYCENTER", "SATURN BARYCENTER"),
    *("URANUS BARYCENTER", "NEPTUNE BARYCENTER", "PLUTO BARYCENTER", "CERES", "PHOBOS", "DEIMOS"),
    *("IO", "EUROPA", "GANYMEDE", "CALLISTO", "TITAN", "ENCELADUS", "TRITON", "CHARON"),
}


@dataclass(frozen=True, eq=False)
class Ephemeris:
    """States of one object. name: of it; centre: "EARTH", or the object that they are relative to;
    body: the frame of their axes where these are a body's, "": they are GCRF; epoch: of the first;
    t (N,): s since then; state (N, 6): m and m/s; useable (N,): whether it may be used as it is,
    not only beside others; covariance (N, 6, 6), SI, in the same axes, NaN where none is given."""

    path: Path
    name: str
    centre: str
    body: str
    epoch: Instant
    t: Array
    state: Array
    useable: NDArray[np.bool_]
    covariance: Array

    def need_covariance(self, rows: NDArray[np.bool_]) -> Array:
        """The covariances of those states. Raises InputError where one has none."""
        bare = rows & np.isnan(self.covariance[:, 0, 0])
        if bare.any():
            t = self.t[np.argmax(bare)]
            raise InputError(
                f"{self.path}: found no covariance at {self.epoch.after(float(t))}"
                f" ({int(bare.sum())} of {int(rows.sum())} states), expected one for each"
            )
        return self.covariance[rows]


def segments_of(message: Message, name: str, option: str) -> list[Segment]:
    """The segments of one object: of that name, or of the only one that is there.

    option: the path of `name`, for messages. Raises InputError on another, or several.
    """
    names = {message.entry(s, "OBJECT_NAME")[1]: 0 for s in message.segments}
    if name and name not in names:
        raise InputError(f"{message.path}: {option}: found {name!r}, expected {', '.join(names)}")
    if not name and len(names) > 1:
        raise InputError(f"{message.path}: found {', '.join(names)}: name one of them, as {option}")
    return [s for s in message.segments if message.entry(s, "OBJECT_NAME")[1] in (name or names)]


def epochs_of(message: Message, segment: Segment, rows: Sequence[Row]) -> list[int]:
    """Nanoseconds of TAI of the rows. Raises InputError, with the line, on a time that is none, is
    not after that of the row before, or is outside START_TIME to STOP_TIME."""
    scale = time_scale(message, segment)
    found = []
    for line, words in rows:
        try:
            found.append(calendar(words[0], scale))
        except InputError as error:
            raise InputError(f"{message.at(line)}: {error}") from error
    for k, (before, after) in enumerate(pairwise(found)):
        if after <= before:
            at = message.at(rows[k + 1][0])
            raise InputError(
                f"{at}: found {rows[k + 1][1][0]}, expected a time after the row above"
            )
    for key, outside in (("START_TIME", min), ("STOP_TIME", max)):
        limit = _limit(message, segment, key, scale)
        if found and limit is not None and outside(limit, found[0], found[-1]) != limit:
            line, text = segment.meta[key]
            raise InputError(
                f"{message.at(line)}: found {key} {text}, but rows from {rows[0][1][0]} to"
                f" {rows[-1][1][0]}"
            )
    return found


def _limit(message: Message, segment: Segment, key: str, scale: str) -> int | None:
    """A time in the metadata, ns of TAI; None: there is none."""
    if key not in segment.meta:
        if key in ("START_TIME", "STOP_TIME"):
            message.entry(segment, key)  # which says that it is missing
        return None
    line, text = segment.meta[key]
    try:
        return calendar(text, scale)
    except InputError as error:
        raise InputError(f"{message.at(line)}: {key}: {error}") from error


def useable(message: Message, segment: Segment, ns: Sequence[int]) -> NDArray[np.bool_]:
    """Which epochs (N,) are within the useable part of a segment."""
    scale = time_scale(message, segment)
    first = _limit(message, segment, "USEABLE_START_TIME", scale)
    last = _limit(message, segment, "USEABLE_STOP_TIME", scale)
    return np.array([(first is None or first <= n) and (last is None or n <= last) for n in ns])


def taken_part(
    path: Path,
    what: str,
    epoch: Instant,
    t: Array,
    useable: NDArray[np.bool_],
    start: float,
    duration: float | None,
) -> tuple[Array, NDArray[np.bool_], dict[str, Any]]:
    """Times (M,), s since the first that is taken, which rows (N,) these are, and as settings when
    the first is: of times t (N,), s since an epoch, the useable ones, and of them what
    [data.options] takes (`relnav_graph.io.orbits.part_of`). Raises InputError on none."""
    taken = useable.copy()
    if not taken.any():
        raise InputError(f"{path}: found no {what} in the useable time")
    if start or duration is not None:
        taken[taken] = part_of(t[taken], start, duration)
    first = float(t[taken][0])
    times = moved(t[taken], -round(first * 1e9))
    return times, taken, {"time": {"epoch": str(epoch.after(first))}}


def _numbers(message: Message, rows: Sequence[Row]) -> Array:
    """Positions and velocities (N, 6), m and m/s. Raises InputError, with the line."""
    for line, words in rows:
        if len(words) not in (7, 10):
            raise InputError(
                f"{message.at(line)}: found {len(words)} words, expected 7: epoch, X Y Z (km),"
                " X_DOT Y_DOT Z_DOT (km/s); or 10, with accelerations"
            )
    if any(len(words) == 10 for _, words in rows):
        _LOG.info(f"{message.path}: accelerations are left alone")
    try:
        found = np.array([[scaled(w, 3) for w in words[1:7]] for _, words in rows], np.float64)
    except ValueError:
        found = np.full((len(rows), 6), np.nan)
    if not np.isfinite(found).all():  # which of them, word by word
        for k, (line, words) in enumerate(rows):
            try:
                found[k] = [number(w, 3) for w in words[1:7]]
            except ValueError as error:
                raise InputError(f"{message.at(line)}: {error}") from error
    return found


def _covariances(
    message: Message,
    segment: Segment,
    ns: Sequence[int],
    own: Array,
    state: Array,
    frame: str,
    about_earth: bool,
) -> Array:
    """Covariances (N, 6, 6), SI, in GCRF (in the body's frame where the states are), NaN where none
    is. own: what takes errors in the frame of the states there (N, 6, 6)."""
    out, at = np.full((len(ns), 6, 6), np.nan), {n: k for k, n in enumerate(ns)}
    scale, found = time_scale(message, segment), segment.covariances
    numbers, rows = np.empty((len(found), 21)), np.zeros(len(found), np.int64)
    frames: dict[Entry, list[int]] = {}
    taken = set[int]()
    for m, one in enumerate(found):
        where = message.at(one.line)
        try:
            numbers[m] = [number(w, 6) for w in one.words]
            when = calendar(one.epoch, scale)
        except (InputError, ValueError) as error:
            raise InputError(f"{where}: of a covariance: {error}") from error
        if when not in at or when in taken:
            what = "a second covariance" if when in taken else "no state, but a covariance,"
            raise InputError(f"{where}: found {what} at {one.epoch}")
        taken.add(when)
        rows[m] = at[when]
        frames.setdefault(one.frame or (one.line, frame), []).append(m)
    P = from_triangle(numbers, 6)
    bad = ~(np.isfinite(numbers).all(axis=1) & (np.einsum("nii->ni", P) > 0).all(axis=1))
    if bad.any():
        line = found[int(np.argmax(bad))].line
        raise InputError(f"{message.at(line)}: found a variance that is not above zero")
    for (line, name), own_rows in _by_name(frames).items():
        where, k = message.at(line), rows[own_rows]
        if name == frame and (own[k] == np.eye(6)).all():
            out[k] = P[own_rows]  # to the bit
            continue
        if not about_earth and name in RTN:
            raise InputError(f"{where}: found {name}, which needs states about the Earth")
        if BODY.fullmatch(frame):
            raise InputError(f"{where}: found {name}, expected {frame}, as of the states")
        T = own[k] if name == frame else covariance_turns(where, name, state[k])
        out[k] = T @ P[own_rows] @ np.swapaxes(T, 1, 2)
    return out


def _by_name(frames: Mapping[Entry, list[int]]) -> dict[Entry, list[int]]:
    """Which covariances are in a frame, by its name and the first line that names it."""
    first: dict[str, Entry] = {}
    found: dict[Entry, list[int]] = {}
    for (line, name), rows in frames.items():
        key = first.setdefault(name.upper(), (line, name.upper()))
        found.setdefault(key, []).extend(rows)
    return found


def read_ephemeris(
    path: Path, name: str = "", table: EarthTable | None = None, option: str = "data.options.object"
) -> Ephemeris:
    """The states of one object in a file, OEM 1.0 to 3.0, KVN or XML.

    name: of the object, where the file has several; table: the Earth's orientation, for ITRF;
    option: what `name` is called, for messages.

    Positions in ICRF, GCRF, EME2000 and ITRF are turned into GCRF; in the axes of a body
    (SC_BODY...) they are left as they are, and need a spacecraft as their centre. Where one segment
    ends when the next begins, the state is there once. Raises InputError, with file and line, on
    other frames, centres and time systems, on times out of order, and on what is no orbit.
    """
    message = read_message(path, "OEM")
    parts = []
    for segment in segments_of(message, name, option):
        rows = segment.rows
        if not rows:
            line = message.entry(segment, "OBJECT_NAME")[0]
            raise InputError(f"{message.at(line)}: found no state in this segment")
        ns, numbers = epochs_of(message, segment, rows), _numbers(message, rows)
        frame = frame_of(message, segment, "REF_FRAME")
        line, centre = message.entry(segment, "CENTER_NAME")
        of_body, centre = bool(BODY.fullmatch(frame)), centre.upper()
        if centre.replace("_", " ") in _OTHERS:
            raise InputError(
                f"{message.at(line)}: found the centre {centre}, expected {EARTH} or a spacecraft"
            )
        if of_body and centre == EARTH:
            raise InputError(
                f"{message.at(line)}: found {centre} in {frame}, expected a spacecraft"
            )
        if centre == EARTH:
            lines = [line for line, _ in rows]
            check_states(lambda k, at=lines: message.at(at[k]), numbers, ("m", "m/s"))  # type: ignore[misc]
        epoch, t = Instant(ns[0]), np.array([n - ns[0] for n in ns], np.int64) / NS
        place, own = message.at(message.entry(segment, "REF_FRAME")[0]), np.eye(6)
        turned, of_errors = numbers, np.broadcast_to(own, (len(t), 6, 6))
        if not of_body:
            turned, of_errors = to_gcrf(place, frame, epoch, t, numbers, table)
        P = _covariances(message, segment, ns, of_errors, turned, frame, centre == EARTH)
        allowed = useable(message, segment, ns)
        if not allowed.all():
            _LOG.info(
                f"{path}: {int((~allowed).sum())} of {len(ns)} states are outside the useable time,"
                " and serve for interpolation alone"
            )
        parts.append((ns, turned, allowed, P, centre, frame if of_body else "", line))
    return _joined(message, parts, segments_of(message, name, option)[0])


def _joined(message: Message, parts: list[tuple[Any, ...]], first: Segment) -> Ephemeris:
    """One ephemeris of segments in order of time."""
    ns: list[int] = []
    kept = []
    for own, _, _, _, centre, body, line in parts:
        if (centre, body) != parts[0][4:6]:
            raise InputError(
                f"{message.at(line)}: found {centre} {body}, expected the centre of the first"
                f" segment, {parts[0][4]} {parts[0][5]}"
            )
        again = bool(ns) and own[0] == ns[-1]
        if ns and own[0] < ns[-1]:
            raise InputError(f"{message.at(line)}: found a segment that begins in the last one")
        ns += own[again:]
        kept.append(slice(int(again), None))
    state, allowed, P = (
        np.concatenate([part[i][cut] for part, cut in zip(parts, kept, strict=True)])
        for i in (1, 2, 3)
    )
    t = np.array([n - ns[0] for n in ns], np.int64) / NS
    name = message.entry(first, "OBJECT_NAME")[1]
    centre, body = parts[0][4:6]
    head = message.path, name, centre, body, Instant(ns[0])
    return Ephemeris(*head, t, np.ascontiguousarray(state), allowed, P)
