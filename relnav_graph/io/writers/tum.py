"""Writer of trajectories as TUM RGB-D has them: ``timestamp tx ty tz qx qy qz qw``.

Numbers are the shortest that read back as the same bits; a covariance has no place in the format.
"""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.io.atomic import atomic
from relnav_graph.io.clocks import NANO, decimal, nanoseconds
from relnav_graph.io.poses import quaternions
from relnav_graph.io.track_poses import pose_of

__all__ = ["SUFFIXES", "write"]

SUFFIXES = (".tum",)
_MARK = re.compile(rb"# .*: pose of .* in .*\n")


def _stamps(t: Array, origin: str | int, epoch: str) -> list[Decimal]:
    if epoch:
        return [Decimal(n) / NANO for n in nanoseconds(t, origin, epoch).tolist()]
    begin = decimal("origin", str(origin))
    return [begin + Decimal(repr(s)) if begin else Decimal(repr(s)) for s in t.tolist()]


def write(
    track: Track,
    path: Path,
    attitude: str = "",
    position: str = "",
    inverse: bool = False,
    origin: str | int = 0,
    epoch: str = "",
) -> None:
    """One row for each epoch.

    attitude, position, inverse: which pose, see `relnav_graph.io.track_poses.pose_of`; origin: the
    stamp, s, of t = 0, as text or a whole number: times are added to it as decimals; or epoch: its
    absolute time, and stamps are Unix time, to the nanosecond.

    Raises InputError on a track without such a pose, or with one that is not finite, over a file
    that is not of this package, and where nothing can be written.
    """
    if path.exists() and not _MARK.match(read_file(path)[:1000]):
        raise InputError(f"{path}: is not of this package; name another file")
    pose = pose_of(track, attitude, position, inverse)
    values = pose.motion.values
    if "attitude" not in values:
        raise InputError(f"track {track.name!r}: found no attitude, which a TUM file needs")
    pose.check()
    table = np.hstack([values["position"], quaternions(values["attitude"], "xyzw")])
    stamps = _stamps(track.t, origin, epoch)
    with atomic(path) as staged, staged.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(
            f"# {track.name}: pose of {pose.body} in {pose.frame}\n"
            "# timestamp tx ty tz qx qy qz qw\n"
        )
        for stamp, row in zip(stamps, table.tolist(), strict=True):
            stream.write(" ".join([format(stamp, "f"), *map(repr, row)]) + "\n")
