"""Reader of CCSDS attitude ephemeris messages (AEM): attitudes, which need a role here.

Times and frames are those that the file names: UTC, TAI, GPS, TT or TDB; frame A is ICRF, GCRF or
EME2000, all turned into GCRF, which is i, or the axes of another body; frame B is a body's. What
the quaternion means stands in `relnav_graph.io.ccsds.aem`. A table of covariances beside the file,
NAME_covariances.csv, is read with it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relnav_graph.core.measurement import QUATERNION
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.aem import read_attitudes
from relnav_graph.io.ccsds.oem import read_ephemeris, taken_part
from relnav_graph.io.ccsds.target import orbit_recording, states_at
from relnav_graph.io.covariances import sigmas_of
from relnav_graph.io.declared import Collected, check_role, given_columns, wrong_sensor
from relnav_graph.io.known import Known
from relnav_graph.maths import dense, so3
from relnav_graph.maths.frames import rtn_axes

__all__ = ["FILES", "SUFFIXES", "read"]

FILES = True
SUFFIXES = (".aem",)
_ROLES = {
    "truth": "true attitudes, of the block `block`",
    "measured": "attitudes that the sensor `sensor` measured",
}
#: Attitudes in o, and that of c relative to t.
_IN_O, _RELATIVE = ("chaser_attitude", "target_attitude"), "relative_attitude"


def read(
    path: Path,
    known: Known,
    role: str = "",
    sensor: str = "",
    block: str = "chaser_attitude",
    object: str = "",
    target: str = "",
    covariance: bool = False,
    start: float = 0.0,
    duration: float | None = None,
) -> Recording:
    """The attitudes of one file.

    role: what they are here: "truth" of `block`, chaser_attitude or target_attitude, R_oc and R_ot,
    with an inertial frame A, or relative_attitude, R_tc, with the target's axes as A; or "measured"
    by `sensor`: as they are filed, from A to B. target: a file OEM of the target's orbit, with
    which o turns where the scenario has an [orbit] (rather a part with the role "target"). object:
    its name, where the file has several; covariance: measurements have the covariances of the table
    beside the file, and a truth that was measured its sigmas; start, duration: the part to take, s.

    Truth: the block, (N, 3, 3). Measurements: q_wxyz (1, 4), one for each epoch. Settings: the
    absolute time of the first epoch.

    Raises InputError, with file and line, on what the file lacks or is wrong in it, and without a
    role.
    """
    check_role(path, "attitudes", role, _ROLES)
    own = read_attitudes(path, object)
    part = own.epoch, own.t, own.useable, start, duration
    t, taken, settings = taken_part(path, "attitude", *part)
    q, P = own.q_wxyz[taken], own.need_covariance()[taken] if covariance else None
    found = Collected(known, f"attitude of {own.name}, {path.name}")
    if role == "measured":
        if (columns := given_columns(path, known, sensor, QUATERNION)) != QUATERNION:
            expected = f"a sensor of {', '.join(QUATERNION)}"
            raise wrong_sensor(f"{path}: option sensor", sensor, columns, expected)
        found.add_rows(sensor, t, q, covariance=P)
        return found.recording(settings)
    if block not in (*_IN_O, _RELATIVE) or own.inertial == (block == _RELATIVE):
        axes = "inertial axes" if own.inertial else "axes of a body"
        expected = " or ".join(_IN_O) if own.inertial else _RELATIVE
        raise InputError(
            f"{path}: found the block {block!r} with {axes} as REF_FRAME_A, expected {expected}"
        )
    R = dense.stacked((so3.from_quaternion(one) for one in np.ascontiguousarray(q)), 3, 3)
    if known.orbital and own.inertial:
        orbit = known.target
        if target:
            orbit = orbit_recording(read_ephemeris(path.parent / target))
        if orbit is None:
            raise InputError(
                f"{path}: found attitudes in i, but o turns with [orbit]; expected the target's"
                ' orbit beside them: a part with role = "target"'
            )
        R = rtn_axes(states_at(orbit, own.epoch, own.t[taken], path))[0] @ R
    found.add_truth(str(path), block, t, R, None if P is None else sigmas_of(P))
    return found.recording(settings)
