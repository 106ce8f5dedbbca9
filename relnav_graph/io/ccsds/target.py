"""The orbit of the target, which other states are relative to: as a recording, and at any time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.oem import EARTH, Ephemeris
from relnav_graph.maths.hermite import between_states
from relnav_graph.maths.instants import Instant, moved

__all__ = ["orbit_recording", "states_at"]


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
