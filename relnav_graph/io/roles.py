"""What files of states have in common that need a role: which it is, for which sensor, where the
target was."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.oem import EARTH, Ephemeris
from relnav_graph.io.known import Known
from relnav_graph.maths.hermite import between_states
from relnav_graph.maths.instants import Instant, moved

__all__ = ["check_role", "orbit_recording", "sensor_columns", "states_at"]


def check_role(path: Path, what: str, role: str, roles: Mapping[str, str]) -> None:
    """Raise InputError unless a role is one of those that `what` can have, by name: what it is."""
    if role not in roles:
        found = f"found the role {role!r}" if role else "found no role"
        known = "; ".join(f"{name!r}, {text}" for name, text in roles.items())
        raise InputError(
            f"{path}: holds {what}, no measurements: {found}, expected one of: {known}"
        )


def sensor_columns(
    path: Path, known: Known, sensor: str, there: Collection[str]
) -> tuple[str, ...]:
    """The columns of a sensor, all of which must be there; of one that is not known, those of a
    position or an attitude. Raises InputError otherwise, or without the name of a sensor."""
    if not sensor:
        raise InputError(f"{path}: measured by which sensor? found no option sensor")
    if sensor in known.sensors:
        columns = known.sensors[sensor].columns
    elif known.sensors:
        names = ", ".join(known.sensors)
        raise InputError(f"{path}: unknown sensor {sensor!r}; known are {names}")
    else:
        speeds = ("vx_m_s", "vy_m_s", "vz_m_s")
        columns = tuple(c for c in there if c not in speeds)
    lacks = [c for c in columns if c not in there]
    if lacks:
        raise InputError(
            f"{path}: sensor {sensor!r} has the columns {', '.join(columns)}; the file can give"
            f" {', '.join(there)}"
        )
    return tuple(columns)


def orbit_recording(own: Ephemeris) -> Recording:
    """An orbit as that of the target: its truth has target_position and target_velocity, in i.

    Raises InputError where its states are relative to a spacecraft.
    """
    if own.centre != EARTH:
        raise InputError(
            f"{own.path}: found the centre {own.centre}, expected {EARTH}: of an orbit"
        )
    values = {"target_position": own.state[:, :3], "target_velocity": own.state[:, 3:]}
    truth = Truth(own.t, values, f"orbit of {own.name}, {own.path.name}")
    return Recording(own.t, (), {}, truth, {"time": {"epoch": str(own.epoch)}})


def states_at(target: Recording, epoch: Instant, t: Array, path: Path) -> Array:
    """States of the target (N, 6), m and m/s, in i, at t (N,), s since an epoch, interpolated.

    path: of what they are needed for. Raises InputError on times at which the orbit is not known.
    """
    assert target.truth is not None  # it is checked where the target is read
    begin = target.epoch
    if begin is None:
        raise InputError(f"{path}: the target's orbit has no absolute time, expected one")
    values = target.truth.values
    state = np.hstack([values["target_position"], values["target_velocity"]])
    found = between_states(target.truth.t, state, moved(t, epoch.ns_since(begin)))
    lacks = np.isnan(found[:, 0])
    if lacks.any():
        when = epoch.after(float(t[int(np.argmax(lacks))]))
        last = begin.after(float(target.truth.t[-1]))
        raise InputError(
            f"{path}: at {when} ({int(lacks.sum())} of {len(t)} times) the target's orbit is not"
            f" known: it goes from {begin} to {last}, without gaps of 0.2 rad and more"
        )
    return found
