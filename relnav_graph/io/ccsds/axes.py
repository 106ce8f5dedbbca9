"""Reference frames and time systems that messages name, and what becomes of states in them.

i is GCRF, with which ICRF agrees in axes. EME2000 is turned against it by the frame bias of IAU
2006, 23 mas: 0.8 m at 7000 km.
"""

from __future__ import annotations

import re

import erfa
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.message import Message, Segment
from relnav_graph.maths.earth import EarthTable, gcrf_from_itrf, turns
from relnav_graph.maths.frames import rtn_axes
from relnav_graph.maths.instants import SCALES, Instant

__all__ = [
    "BODY",
    "RTN",
    "covariance_turns",
    "frame_of",
    "gcrf_from",
    "inertial",
    "state_turns",
    "time_scale",
    "to_gcrf",
]

#: Turns with the Earth; a body's own axes.
_EARTH_FIXED = re.compile(r"ITRF[-_ ]?\d*", re.ASCII)
BODY = re.compile(r"(SC_BODY|SC|BODY)\w*", re.ASCII)
_SAME = {"ICRF", "GCRF"}
#: Axes of the orbit at an epoch, held still.
RTN = {"RTN", "RSW", "QSW", "RIC", "RTN_INERTIAL", "RSW_INERTIAL"}
_WHAT_TO_DO = {
    "TEME": "it is the frame of SGP4: convert with the tool that propagated the elements",
    "TOD": "convert with precession and nutation of the epoch of each state",
    "MOD": "convert with the precession of the epoch of each state",
    "GTOD": "convert with precession, nutation and sidereal time of each state",
    "J2000": "if the mean equator and equinox are meant, it is called EME2000",
}


def gcrf_from(name: str) -> Array | None:
    """``R``, (3, 3), from the axes of an inertial frame to those of GCRF; None of another frame."""
    if name.upper() in _SAME:
        return np.eye(3)
    if name.upper() == "EME2000":
        # ERFA gives the bias from GCRS to the mean equator and equinox of J2000.
        return np.ascontiguousarray(erfa.bp06(2451545.0, 0.0)[0].T)
    return None


def inertial(where: str, name: str) -> Array:
    """As `gcrf_from`. Raises InputError, saying what to do, on another frame."""
    found = gcrf_from(name)
    if found is None:
        known = next((v for k, v in _WHAT_TO_DO.items() if name.upper().startswith(k)), "")
        raise InputError(
            f"{where}: found the frame {name!r}, expected ICRF, GCRF or EME2000"
            + (f": {known}" if known else "")
        )
    return found


def frame_of(message: Message, segment: Segment, key: str) -> str:
    """The name of a frame in the metadata."""
    return message.entry(segment, key)[1].upper()


def time_scale(message: Message, segment: Segment) -> str:
    """The time scale of a segment, one of `SCALES`. Raises InputError on others."""
    found: str = message.one_of(
        segment,
        "TIME_SYSTEM",
        {s: s for s in SCALES},
        ": others need a clock that this file does not tell",
    )
    return found


def to_gcrf(
    where: str, frame: str, epoch: Instant, t: Array, state: Array, table: EarthTable | None
) -> tuple[Array, Array]:
    """States (N, 6), m and m/s, in GCRF of what is given in a frame at t (N,), s since an epoch;
    and what turns their errors (N, 6, 6).

    table: the Earth's orientation, for ITRF. Raises InputError on a frame that is not known.
    """
    if _EARTH_FIXED.fullmatch(frame):
        r, v = gcrf_from_itrf(epoch, t, state[:, :3], state[:, 3:], table)
        R_ie, w_e = turns(epoch, t, table)
        return np.hstack([r, v]), state_turns(R_ie, w_e)
    R = inertial(where, frame)
    both = np.kron(np.eye(2), R)
    return state @ both.T, np.broadcast_to(both, (len(t), 6, 6))


def state_turns(R: Array, w: Array) -> Array:
    """What turns errors of position and velocity (N, 6, 6) from axes that turn to those at rest.

    R: (N, 3, 3), from the first to the second; w: (N, 3), rad/s, their rate in the first:
    ``r = R r', v = R (v' + w x r')``.
    """
    out = np.zeros((len(R), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = R
    skew = -np.cross(w[:, None], np.eye(3)[None])  # its columns are w x e_i
    out[:, 3:, :3] = R @ skew
    return out


def covariance_turns(where: str, frame: str, state: Array) -> Array:
    """What takes errors (N, 6, 6) in the frame of a covariance, inertial or RTN, to GCRF.

    state: (N, 6), m and m/s, in GCRF. RTN are axes held still at the epoch: errors of the velocity
    are those of the inertial one. Raises InputError on a frame that is not known.
    """
    frame = frame.upper()
    if frame in RTN:
        R_io = np.swapaxes(rtn_axes(state)[0], 1, 2)
        return state_turns(R_io, np.zeros((len(state), 3)))
    R = inertial(f"{where} (of a covariance; or RTN)", frame)
    return np.broadcast_to(np.kron(np.eye(2), R), (len(state), 6, 6))
