"""Reader of CCSDS orbit ephemeris messages (OEM): states, which need a role here.

Times and frames are those that the file names: UTC, TAI, GPS, TT or TDB; ICRF, GCRF, EME2000 or
ITRF, all turned into GCRF, which is i. o is RTN of the target where the scenario has an [orbit],
else it is i. A file whose centre is a spacecraft has states relative to it: in axes of i, or, as
measurements, in those of its body (SC_BODY...), which are then t.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.core.measurement import QUATERNION
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.aem import read_attitudes
from relnav_graph.io.ccsds.oem import EARTH, Ephemeris, read_ephemeris, taken_part
from relnav_graph.io.ccsds.target import orbit_recording, states_at
from relnav_graph.io.covariances import sigmas_of
from relnav_graph.io.declared import Collected, check_role, given_columns
from relnav_graph.io.known import Known
from relnav_graph.maths.frames import rtn_axes, to_rtn

__all__ = ["FILES", "SUFFIXES", "read"]

FILES = True
SUFFIXES = (".oem",)
_ROLES = {
    "truth": "true states of the chaser",
    "target": "the orbit of the target, for what is relative to it",
    "measured": "positions that the sensor `sensor` measured",
}
_PLACE = ("x_m", "y_m", "z_m")
_SPEED = ("vx_m_s", "vy_m_s", "vz_m_s")


def read(
    path: Path,
    known: Known,
    role: str = "",
    sensor: str = "",
    target: str = "",
    object: str = "",
    target_object: str = "",
    attitude: str = "",
    covariance: bool = False,
    orientation: str = "",
    start: float = 0.0,
    duration: float | None = None,
) -> Recording:
    """The states of one file.

    role: what they are here: "truth" of the chaser, the orbit of the "target", or "measured" by
    `sensor`, whose columns say of which: positions, velocities (vx_m_s, ...) or, with `attitude`,
    an AEM file with attitudes at the same times, poses. target: a file OEM with the target's orbit
    (in the scenario rather a part with that role): what is true or measured is then relative to it,
    unless the sensor reads the chaser's own position. object, target_object: names, where a file
    has several; covariance: measurements have the covariances of the file, and a truth that was
    measured its sigmas; orientation: a file finals2000A of the IERS, for ITRF; start, duration: the
    part of the file to take, s.

    Truth: chaser_position, m, and chaser_velocity, m/s, in i; with a target relative_position and
    relative_velocity in o, too; of the target target_position and target_velocity. Measurements:
    one for each epoch, z (1, columns), SI. Settings: the absolute time of the first epoch.

    Raises InputError, with file and line, on what the file lacks or is wrong in it, and without a
    role.
    """
    check_role(path, "orbits", role, _ROLES)
    table = AbsoluteTime("2000-01-01T00:00:00 TT", orientation).table if orientation else None
    own = read_ephemeris(path, object, table)
    part = own.epoch, own.t, own.useable, start, duration
    t, taken, settings = taken_part(path, "state", *part)
    other = known.target
    if target:
        orbit = read_ephemeris(path.parent / target, target_object, table, "target_object")
        other = orbit_recording(orbit)
    if role == "target":
        return orbit_recording(own)
    states = _relative(own, taken, other, known.orbital)
    found = Collected(known, f"orbit of {own.name}, {path.name}")
    if role == "truth":
        _add_truth(found, own, taken, t, states, covariance)
        return found.recording(settings)
    name = "own" if _absolute(path, known, sensor, own, other) else "relative"
    z, R = _observed(own, taken, *states[name], covariance)
    if attitude:
        _add_attitudes(path.parent / attitude, own, taken, z, R)
    chosen = given_columns(path, known, sensor, z)
    values = np.column_stack([z[c] for c in chosen])
    found.add_rows(sensor, t, values, covariance=_of_rows(R, chosen))
    return found.recording(settings)


def _observed(
    own: Ephemeris, taken: Any, state: Array, T: Array, covariance: bool
) -> tuple[dict[str, Array], dict[tuple[str, ...], Array]]:
    """Columns (M,) of positions and velocities, and, if asked for, covariances of these, by their
    rows: (M, 6, 6), SI. T (M, 6, 6): what turns errors of the file into those of `state`."""
    rows: tuple[str, ...] = (*_PLACE, *_SPEED)
    P = {rows: T @ own.need_covariance(taken) @ np.swapaxes(T, 1, 2)} if covariance else {}
    return dict(zip(rows, state.T, strict=True)), P


def _add_attitudes(
    path: Path, own: Ephemeris, taken: Any, z: dict[str, Array], P: dict[tuple[str, ...], Array]
) -> None:
    """Add columns of q_wxyz at the times of the positions, from an AEM file, and, where positions
    have covariances, its own (M, 3, 3), rad^2. Raises InputError on a time that it lacks."""
    found = read_attitudes(path)
    ns = np.rint(own.t[taken] * 1e9).astype(np.int64) + own.epoch.ns_since(found.epoch)
    its = np.rint(found.t * 1e9).astype(np.int64)
    k = np.clip(np.searchsorted(its, ns), 0, len(its) - 1)
    if (its[k] != ns).any():
        lacks = own.epoch.after(float(own.t[taken][np.argmax(its[k] != ns)]))
        raise InputError(f"{path}: found no attitude at {lacks}, where {own.path} has a position")
    z |= dict(zip(QUATERNION, found.q_wxyz[k].T, strict=True))
    if P:
        P[QUATERNION[1:]] = found.need_covariance()[k]


def _of_rows(P: dict[tuple[str, ...], Array], columns: tuple[str, ...]) -> Array | None:
    """The covariance (M, rows, rows) of some columns, of what covariances say by their rows: of a
    quaternion the residual has the rows x, y, z. None where there are none."""
    rows = [c for c in columns if c != "q_w"]
    R = None
    for names, own in P.items():
        R = np.zeros((len(own), len(rows), len(rows))) if R is None else R
        there = [(i, names.index(row)) for i, row in enumerate(rows) if row in names]
        for i, a in there:
            for j, b in there:
                R[:, i, j] = own[:, a, b]
    return R


def _relative(
    own: Ephemeris, taken: Any, other: Recording | None, orbital: bool
) -> dict[str, tuple[Array, Array]]:
    """States (M, 6) in the axes that they have here, and what turns errors in i into these
    (M, 6, 6): "own", of an orbit, in i, and "relative" to the target, in o or, of a body, in t."""
    state, here = own.state[taken], np.broadcast_to(np.eye(6), (int(taken.sum()), 6, 6))
    if own.body:
        return {"relative": (state, here)}
    found = {"own": (state, here)} if own.centre == EARTH else {"relative": (state, here)}
    if other is None:
        if orbital and own.centre != EARTH:
            raise InputError(
                f"{own.path}: found states relative to {own.centre} in axes of i, but o turns with"
                ' [orbit]; expected the target\'s orbit beside them: a part with role = "target"'
            )
        return found
    at = states_at(other, own.epoch, own.t[taken], own.path)
    if own.centre != EARTH:
        state = state + at
    R_oi, w = rtn_axes(at)
    if orbital:
        T = np.zeros((len(state), 6, 6))
        T[:, :3, :3] = T[:, 3:, 3:] = R_oi
        T[:, 3:, :3] = np.cross(w[:, None], np.eye(3)[None]) @ R_oi  # columns -(w x e_i)
        found["relative"] = to_rtn(state, at), T
    else:
        found["relative"] = state - at, here
    if own.centre == EARTH:
        found["own"] = state, here
    return found


def _add_truth(
    found: Collected,
    own: Ephemeris,
    taken: Any,
    t: Array,
    states: dict[str, tuple[Array, Array]],
    covariance: bool,
) -> None:
    """Add the truth that states are. Raises InputError on those in axes of a body."""
    if own.body:
        raise InputError(f"{own.path}: found axes of {own.body}, expected inertial ones of a truth")
    for key, of in (("own", "chaser"), ("relative", "relative")):
        if key not in states:
            continue
        state, T = states[key]
        P = T @ own.need_covariance(taken) @ np.swapaxes(T, 1, 2) if covariance else None
        for part, cut in (("position", slice(0, 3)), ("velocity", slice(3, 6))):
            sigma = None if P is None else sigmas_of(P)[:, cut]
            value = np.ascontiguousarray(state[:, cut])
            found.add_truth(str(own.path), f"{of}_{part}", t, value, sigma)


def _absolute(
    path: Path, known: Known, sensor: str, own: Ephemeris, other: Recording | None
) -> bool:
    """Whether a sensor measures the chaser's own orbit, not its place from the target. Raises
    InputError where the file cannot say what it measures."""
    reads = {b.name for b in known.sensors[sensor].reads} if sensor in known.sensors else set()
    far = own.centre == EARTH and not own.body
    absolute = "chaser_position" in reads or (not reads and far and other is None)
    if absolute and not far:
        raise InputError(f"{path}: found the centre {own.centre}, expected {EARTH} for {sensor!r}")
    if not absolute and far and other is None:
        raise InputError(
            f"{path}: sensor {sensor!r} measures relative to the target, whose orbit is not given:"
            ' expected a part with role = "target"'
        )
    return absolute
