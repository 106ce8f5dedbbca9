"""Writer of CCSDS attitude ephemeris messages, AEM 2.0 (KVN): one attitude of a track.

The quaternion is that of ``R_AB``, from B to A, as `relnav_graph.io.ccsds.aem` says; B is the body.
AEM has no covariances: they go into a table beside it, NAME_covariances.csv: t_s, s since the first
epoch, then cov_1_1, cov_2_1, ..., rad^2, of right perturbations, about the axes of B.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.io.atomic import atomic
from relnav_graph.io.ccsds.aem import SIDE
from relnav_graph.io.ccsds.axes import inertial
from relnav_graph.io.ccsds.writing import (
    begin_of,
    finite,
    lines_of,
    put,
    say_of_axes,
    stamps,
    target_states,
)
from relnav_graph.io.covariances import covariance_columns
from relnav_graph.io.tabular import to_components, write_table
from relnav_graph.maths.frames import rtn_axes
from relnav_graph.maths.instants import since_first

__all__ = ["SUFFIXES", "write"]

SUFFIXES = (".aem",)
_RELATIVE = "relative_attitude"


def write(
    track: Track,
    path: Path,
    epoch: str = "",
    block: str = "",
    object: str = "",
    object_id: str = "UNKNOWN",
    frame: str = "",
    body: str = "SC_BODY_1",
    time_system: str = "UTC",
    target: str | Recording = "",
    orbital: bool | None = None,
    covariance: bool = True,
    originator: str = "RELNAV-GRAPH",
) -> None:
    """Write one attitude of a track as quaternions, and its covariances as a table beside them.

    epoch: when t = 0 is, as "2021-07-17T00:00:00 TT"; block: which attitude, by default the only
    one that there is; object, object_id: name and designator; frame: REF_FRAME_A, ICRF (default),
    GCRF or EME2000, of relative_attitude the name of the target's axes, SC_BODY_2 by default; body:
    REF_FRAME_B; time_system: UTC, TAI, GPS, TT or TDB; orbital: whether o turns with the target's
    orbit, `target`, a file OEM or a recording with target_position, None: taken for inertial, with
    a warning (but of relative_attitude); covariance: whether to write the table; originator: of the
    header.

    Raises InputError on what the track lacks, on a frame or a time system that is not known, and
    where nothing can be written.
    """
    begin = begin_of(track, path, epoch, time_system)
    turning = {b.name: b for b in track.blocks if b.manifold == "SO3"}
    if block not in turning and (block or len(turning) != 1):
        names = ", ".join(turning) or "none"
        raise InputError(
            f"{path}: option block: found {block!r}, expected an attitude of the track: {names}"
        )
    block = block or next(iter(turning))
    values, P = track.value(block), track.covariance(block)
    finite(path, track, values, "attitude")
    if block == _RELATIVE:
        frame = frame or "SC_BODY_2"
    else:
        frame = frame.upper() or "ICRF"
        R = inertial(str(path), frame)
        if orbital:
            at = target_states(path, target, begin, track.t)
            values = np.swapaxes(rtn_axes(at)[0], 1, 2) @ values
        values = values if frame != "EME2000" else R.T @ values
    times = stamps(begin, track.t, time_system)
    meta = {
        "OBJECT_NAME": object or ("TARGET" if block == "target_attitude" else "CHASER"),
        "OBJECT_ID": object_id,
        "REF_FRAME_A": frame,
        "REF_FRAME_B": body,
        "TIME_SYSTEM": time_system,
        "START_TIME": times[0],
        "STOP_TIME": times[-1],
        "ATTITUDE_TYPE": "QUATERNION",
    }
    lines = [*lines_of("AEM", meta, originator), "DATA_START"]
    q_wxyz = to_components(turning[block], values).tolist()
    for when, (w, x, y, z) in zip(times, q_wxyz, strict=True):
        lines.append(f"{when} {x!r} {y!r} {z!r} {w!r}")
    side = path.parent / f"{path.stem}{SIDE}.csv"
    _check_side(side)
    if covariance:
        finite(path, track, P, "covariance")
    put(path, [*lines, "DATA_STOP"])
    if block != _RELATIVE:
        say_of_axes(path, track, orbital, frame)
    side.unlink(missing_ok=True)  # it would be taken for that of the new file
    if covariance:
        i, j = np.tril_indices(3)
        t = since_first([begin.after(s).tai for s in track.t.tolist()])
        columns = {"t_s": t, **dict(zip(covariance_columns(3), P[:, i, j].T, strict=True))}
        with atomic(side) as staged:
            write_table(staged, columns)


def _check_side(side: Path) -> None:
    """Raise InputError where another file stands in the place of the table of covariances."""
    head = ",".join(("t_s", *covariance_columns(3)))
    if side.exists() and read_file(side)[: len(head)] != head.encode():
        raise InputError(f"{side}: is not a table of covariances; name another file")
