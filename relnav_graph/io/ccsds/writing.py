"""What the writers of messages share: header, metadata, times, the place where they go."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.constants import VERSION
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.ccsds.oem import read_ephemeris
from relnav_graph.io.ccsds.target import orbit_recording, states_at
from relnav_graph.maths.instants import SCALES, Instant

__all__ = ["begin_of", "finite", "lines_of", "put", "say_of_axes", "stamps", "target_states"]

_LOG = logging.getLogger(__name__)
_MARK = "COMMENT written by relnav-graph"


def begin_of(track: Track, path: Path, epoch: str, time_system: str) -> Instant:
    """When t = 0 of a track is. Raises InputError where it is not said, on an unknown time system
    and on a track without epochs."""
    if not epoch:
        raise InputError(
            f'{path}: when is t = 0 of {track.name!r}? expected epoch = "2021-07-17T00:00:00 TT"'
        )
    if time_system not in SCALES:
        known = ", ".join(SCALES)
        raise InputError(f"{path}: found time_system {time_system!r}, expected one of {known}")
    if not len(track.t):
        raise InputError(f"{path}: found no epoch in {track.name!r}")
    return Instant.parse(epoch)


def stamps(begin: Instant, t: Array, time_system: str) -> list[str]:
    """Times (N,), s since an instant, as texts in a time system, to the nanosecond."""
    return [begin.after(s).calendar(time_system) for s in t.tolist()]


def finite(path: Path, track: Track, values: Array, what: str) -> None:
    """Raise InputError where values (N, ...) of a track are not finite."""
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    if bad.any():
        t = track.t[int(np.argmax(bad))]
        raise InputError(f"{path}: {track.name!r} has no finite {what} at t = {t} s")


def target_states(
    path: Path, target: str | Recording, begin: Instant, t: Array, instead: str = ""
) -> Array:
    """States of the target (N, 6), m and m/s, in i, from a file OEM or a recording of its orbit.
    instead: what else one may ask for, for the error.

    Raises InputError where it is not given, or not known at these times.
    """
    if not target:
        raise InputError(
            f"{path}: found no orbit of the target (option target), expected one{instead}"
        )
    orbit = (
        target if isinstance(target, Recording) else orbit_recording(read_ephemeris(Path(target)))
    )
    return states_at(orbit, begin, t, path)


def say_of_axes(path: Path, track: Track, orbital: bool | None, frame: str) -> None:
    """Warn where nobody said (None) whether o turns with the orbit: a track does not know it, and
    its o was written as `frame`."""
    if orbital is None:
        _LOG.warning(
            f"{path}: the axes o of {track.name!r} are not known to be inertial, and are written as"
            f" {frame}: orbital = false says that they are, orbital = true that they turn with the"
            " target's orbit"
        )


def lines_of(kind: str, meta: Mapping[str, str], originator: str) -> list[str]:
    """The lines of a message, version 2.0, up to the end of its metadata. Raises InputError on a
    text that is none of one line."""
    for key, value in {**meta, "ORIGINATOR": originator}.items():
        if not value or not value.isprintable():
            raise InputError(f"found {key} {value!r}, expected a text of one line")
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return [
        f"CCSDS_{kind}_VERS = 2.0",
        f"{_MARK} {VERSION}",
        f"CREATION_DATE = {now}",
        f"ORIGINATOR = {originator}",
        "",
        "META_START",
        *(f"{key} = {value}" for key, value in meta.items()),
        "META_STOP",
        "",
    ]


def put(path: Path, lines: Sequence[str]) -> None:
    """Write a file, in the place of one that a writer of messages wrote. Raises InputError where
    something else is, and where nothing can be written."""
    if path.exists():
        try:
            with path.open("rb") as stream:
                ours = _MARK.encode() in stream.read(1000)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
        if not ours:
            raise InputError(f"{path}: is not of this package; name another file")
    with atomic(path) as staged:
        staged.write_text("\n".join(lines) + "\n", "utf-8")
