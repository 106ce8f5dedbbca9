"""Attitude ephemeris messages (AEM, CCSDS 504.0-B): attitudes of one body.

The quaternion (Q1, Q2, Q3, QC) turns the axes of REF_FRAME_A into those of REF_FRAME_B: with the
axis e and the angle phi of that turn, Q = e sin(phi / 2), QC = cos(phi / 2). It is the Hamilton
quaternion q_wxyz = (QC, Q1, Q2, Q3) of ``R_AB``, which takes components in B to components in A.
In AEM 1.0 ATTITUDE_DIR = B2A says the reverse, and QUATERNION_TYPE where QC stands.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.axes import BODY, frame_of, inertial
from relnav_graph.io.ccsds.message import Message, Row, Segment, number, read_message
from relnav_graph.io.ccsds.oem import epochs_of, segments_of, useable
from relnav_graph.io.covariances import covariances_in
from relnav_graph.io.poses import ORDERS, check_quaternions
from relnav_graph.io.tabular import read_table
from relnav_graph.maths import so3
from relnav_graph.maths.instants import NS, Instant

__all__ = ["SIDE", "Attitudes", "read_attitudes"]

_LOG = logging.getLogger(__name__)

#: The table of covariances beside a file, in place of its suffix: AEM has none.
SIDE = "_covariances"
#: Of an entry that AEM 1.0 alone has.
_SINCE = ", as always since AEM 2.0; is it one of CCSDS_AEM_VERS = 1.0?"
#: Types of attitude that are read: words that follow the quaternion.
_TYPES = {
    "QUATERNION": 0,
    "QUATERNION/DERIVATIVE": 4,
    "QUATERNION/RATE": 3,
    "QUATERNION/ANGVEL": 3,
}


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Attitudes of one body. name: of the object; inertial: whether frame A is i, else it is that
    of another body; epoch: of the first; t (N,): s since then; q_wxyz (N, 4): of R_AB, as filed;
    useable: the rows that may be used as they are, (N,); covariance (N, 3, 3), rad^2, of right
    perturbations, or None."""

    path: Path
    name: str
    inertial: bool
    epoch: Instant
    t: Array
    q_wxyz: Array
    useable: Any
    covariance: Array | None

    def need_covariance(self) -> Array:
        """The covariances (N, 3, 3). Raises InputError where there are none."""
        if self.covariance is None:
            raise InputError(f"{self.path}: found no table {self.path.stem}{SIDE}.csv beside it")
        return self.covariance


def _quaternions(message: Message, rows: Sequence[Row], first: bool, more: int) -> Array:
    """q_wxyz (N, 4). first: whether QC is; more: words of rates that may follow. Raises InputError,
    with the line."""
    for line, words in rows:
        if len(words) not in (5, 5 + more):
            raise InputError(
                f"{message.at(line)}: found {len(words)} words, expected {5 + more}: epoch,"
                " quaternion" + (", rates" if more else "")
            )
    if more:
        _LOG.info(f"{message.path}: rates are left alone")
    try:
        found = np.array([words[1:5] for _, words in rows], np.float64)
    except ValueError:
        found = np.full((len(rows), 4), np.nan)
    if not np.isfinite(found).all():  # which of them, word by word
        for k, (line, words) in enumerate(rows):
            try:
                found[k] = [number(word) for word in words[1:5]]
            except ValueError as error:
                raise InputError(f"{message.at(line)}: {error}") from error
    check_quaternions(lambda k: message.at(rows[k][0]), found)
    return found[:, ORDERS["wxyz" if first else "xyzw"]]


def _product(a: Array, b: Array) -> Array:
    """Hamilton products of quaternions (..., 4), scalar first."""
    a, b = np.broadcast_arrays(a, b)
    w = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(axis=-1, keepdims=True)
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w, v], axis=-1)


def _segment(message: Message, segment: Segment) -> tuple[list[int], Array, bool]:
    """Epochs, ns of TAI, q_wxyz (N, 4) of R_AB with i for A, and whether A is i."""
    more = message.one_of(segment, "ATTITUDE_TYPE", _TYPES, ": other attitudes are not read")
    first, back, old = False, False, message.version == "1.0"
    # Later versions know neither, but for what they always mean: a file that says so is none.
    if old or "QUATERNION_TYPE" in segment.meta:
        orders = {"LAST": False} | ({"FIRST": True} if old else {})
        first = message.one_of(segment, "QUATERNION_TYPE", orders, "" if old else _SINCE)
    if old or "ATTITUDE_DIR" in segment.meta:
        ways = {"A2B": False} | ({"B2A": True} if old else {})
        back = message.one_of(segment, "ATTITUDE_DIR", ways, "" if old else _SINCE)
    if not segment.rows:
        line = message.entry(segment, "OBJECT_NAME")[0]
        raise InputError(f"{message.at(line)}: found no attitude in this segment")
    q = _quaternions(message, segment.rows, first, more)
    if back:
        q = q * np.array([1.0, -1.0, -1.0, -1.0])
    ends, stars = [], []
    for key in ("REF_FRAME_A", "REF_FRAME_B"):
        name = frame_of(message, segment, key)
        line = message.entry(segment, key)[0]
        of_body = BODY.fullmatch(name) is not None or name.startswith(("INSTRUMENT", "STARTRACKER"))
        R = None if of_body else inertial(message.at(line), name)
        stars.append(R is not None)
        turned = R is not None and not np.array_equal(R, np.eye(3))
        ends.append(so3.quaternion(np.ascontiguousarray(R)) if turned else None)
    if stars[1]:
        if stars[0]:
            line = message.entry(segment, "REF_FRAME_B")[0]
            raise InputError(f"{message.at(line)}: found two inertial frames, expected a body's")
        q, ends = q * np.array([1.0, -1.0, -1.0, -1.0]), ends[::-1]
    if ends[0] is not None:
        q = _product(ends[0], q)
    return epochs_of(message, segment, segment.rows), q, any(stars)


def read_attitudes(path: Path, name: str = "") -> Attitudes:
    """The attitudes of one object in a file, AEM 1.0 or 2.0, KVN or XML, as quaternions, and the
    covariances in the table beside it, if there is one (`SIDE`: t_s since the first, cov_1_1, ...).

    name: of the object, where the file has several. EME2000 is turned into GCRF. Raises InputError,
    with file and line, on other types, frames and time systems, on times out of order, and on
    quaternions whose length is not 1 within 1e-3.
    """
    message = read_message(path, "AEM")
    ns: list[int] = []
    parts, allowed, stars = [], [], set()
    segments = segments_of(message, name, "data.options.object")
    for segment in segments:
        own, q, of_stars = _segment(message, segment)
        again = bool(ns) and own[0] == ns[-1]
        line = message.entry(segment, "OBJECT_NAME")[0]
        if ns and own[0] < ns[-1]:
            raise InputError(f"{message.at(line)}: found a segment that begins in the last one")
        stars.add(of_stars)
        if len(stars) > 1:
            raise InputError(f"{message.at(line)}: found other frames than in the first segment")
        allowed.append(useable(message, segment, own)[again:])
        ns += own[again:]
        parts.append(q[again:])
    t = np.array([n - ns[0] for n in ns], np.int64) / NS
    called = message.entry(segments[0], "OBJECT_NAME")[1]
    head = path, called, stars.pop(), Instant(ns[0]), t, np.concatenate(parts)
    return Attitudes(*head, np.concatenate(allowed), _covariances(path, t))


def _covariances(path: Path, t: Array) -> Array | None:
    """Those of the table beside a file, None without one. Raises InputError on other times."""
    table = read_table(path.parent, f"{path.stem}{SIDE}")
    if table is None:
        return None
    table.require(("t_s",), tuple(table.columns))
    if len(table["t_s"]) != len(t):
        raise InputError(f"{table.path}: found {len(table['t_s'])} rows, expected {len(t)}")
    table.refuse(np.abs(table["t_s"] - t) > 1e-9, "t_s", "the times of the attitudes")
    P = covariances_in(table, 3)
    if P is None:
        raise InputError(f"{table.path}: found no columns cov_1_1, ..., expected them")
    return P
