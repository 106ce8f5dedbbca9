"""Writer of CCSDS orbit ephemeris messages, OEM 2.0 (KVN): positions and velocities of a track.

Numbers are written so that `relnav_graph.io.readers.oem` reads the same bits. Covariances are those
of position and velocity, in the frame asked for; RTN are the axes of the object's own orbit at each
epoch, held still, so that errors of the velocity are those of the inertial one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.axes import covariance_turns, gcrf_from, inertial, state_turns
from relnav_graph.io.ccsds.message import unscaled
from relnav_graph.io.ccsds.writing import (
    begin_of,
    finite,
    lines_of,
    put,
    say_of_axes,
    stamps,
    target_states,
)
from relnav_graph.maths.frames import from_rtn, rtn_axes
from relnav_graph.maths.instants import Instant

__all__ = ["SUFFIXES", "write"]

SUFFIXES = (".oem",)
_OWN, _RELATIVE = ("chaser_position", "chaser_velocity"), ("relative_position", "relative_velocity")


def write(
    track: Track,
    path: Path,
    epoch: str = "",
    of: str = "chaser",
    object: str = "",
    object_id: str = "UNKNOWN",
    centre: str = "",
    frame: str = "ICRF",
    time_system: str = "UTC",
    covariance: str = "",
    target: str | Recording = "",
    orbital: bool | None = None,
    originator: str = "RELNAV-GRAPH",
) -> None:
    """Write the states of a track's chaser, or target, as an ephemeris.

    epoch: when t = 0 is, as "2021-07-17T00:00:00 TT"; of: "chaser", from chaser_position and
    chaser_velocity or else from relative_position, relative_velocity and the target's orbit;
    "target", from both; or "relative", in axes of i with the target, `centre`, as the centre.
    object, object_id: its name and designator; frame: ICRF, GCRF or EME2000; time_system: UTC, TAI,
    GPS, TT or TDB; covariance: its frame, one of these or RTN, by default `frame`, "none": without;
    target: the target's orbit, a file OEM or a recording with target_position; orbital: whether o
    turns with it (the scenario has an [orbit]), None: taken for inertial, with a warning wherever o
    matters; originator: of the header.

    Raises InputError on what the track lacks, on a frame or a time system that is not known, and
    where nothing can be written.
    """
    begin = begin_of(track, path, epoch, time_system)
    states, P = _states(track, path, of, target, bool(orbital), begin)
    finite(path, track, states, "state")
    R = inertial(str(path), frame)
    here = np.kron(np.eye(2), R.T)
    written = states if frame.upper() != "EME2000" else states @ here.T
    meta = {
        "OBJECT_NAME": object or ("TARGET" if of == "target" else "CHASER"),
        "OBJECT_ID": object_id,
        "CENTER_NAME": centre or ("TARGET" if of == "relative" else "EARTH"),
        "REF_FRAME": frame.upper(),
        "TIME_SYSTEM": time_system,
    }
    times = stamps(begin, track.t, time_system)
    meta |= {"START_TIME": times[0], "STOP_TIME": times[-1]}
    lines = lines_of("OEM", meta, originator)
    for when, row in zip(times, written.tolist(), strict=True):
        lines.append(" ".join([when, *(unscaled(x, 3) for x in row)]))
    if covariance != "none":
        name = (covariance or frame).upper()
        if of == "relative" and gcrf_from(name) is None:
            raise InputError(
                f"{path}: found covariance {name!r} of relative states, expected {frame}"
            )
        finite(path, track, P, "covariance")
        T = np.swapaxes(covariance_turns(str(path), name, states), 1, 2)
        lines += ["", "COVARIANCE_START"]
        for when, one in zip(times, T @ P @ np.swapaxes(T, 1, 2), strict=True):
            lines += [f"EPOCH = {when}", f"COV_REF_FRAME = {name}"]
            lines += [" ".join(unscaled(x, 6) for x in one[i, : i + 1].tolist()) for i in range(6)]
        lines.append("COVARIANCE_STOP")
    put(path, lines)
    if of != "chaser" or not set(_OWN) <= {b.name for b in track.blocks}:  # those are in i
        say_of_axes(path, track, orbital, meta["REF_FRAME"])


def _states(
    track: Track, path: Path, of: str, target: str | Recording, orbital: bool, begin: Instant
) -> tuple[Array, Array]:
    """States (N, 6), m and m/s, in i, and their covariances (N, 6, 6)."""
    there = {b.name for b in track.blocks}
    own, relative = (set(names) <= there for names in (_OWN, _RELATIVE))
    if of == "chaser" and own:
        return _values(track, _OWN), track.covariance(*_OWN)
    if of == "chaser" and relative:
        instead = ", or of=relative for the relative states themselves"
        at = target_states(path, target, begin, track.t, instead)
        states = _values(track, _RELATIVE)
        if not orbital:
            return at + states, track.covariance(*_RELATIVE)
        R_oi, w = rtn_axes(at)
        T = state_turns(np.swapaxes(R_oi, 1, 2), w)
        return from_rtn(states, at), T @ track.covariance(*_RELATIVE) @ np.swapaxes(T, 1, 2)
    if of in ("target", "relative") and orbital:
        raise InputError(f"{path}: found of = {of!r} where o turns, expected the chaser")
    if of == "target" and own and relative:
        J = np.hstack([np.eye(6), -np.eye(6)])
        return (
            _values(track, _OWN) - _values(track, _RELATIVE),
            J @ track.covariance(*_OWN, *_RELATIVE) @ J.T,
        )
    if of == "relative" and relative:
        return _values(track, _RELATIVE), track.covariance(*_RELATIVE)
    if of not in ("chaser", "target", "relative"):
        raise InputError(f"{path}: found of = {of!r}, expected chaser, target or relative")
    needs = {"chaser": "or".join((f" {_OWN} ", f" {_RELATIVE}")), "relative": f" {_RELATIVE}"}
    expected = needs.get(of, f" {_OWN} and {_RELATIVE}")
    raise InputError(f"{path}: {track.name!r} has {', '.join(sorted(there))}; expected{expected}")


def _values(track: Track, names: tuple[str, ...]) -> Array:
    return np.hstack([track.value(name) for name in names])
