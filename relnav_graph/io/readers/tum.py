"""Reader of trajectories as TUM RGB-D has them, and with it evo and many SLAM programs.

A row for each pose, separated by blanks: ``timestamp tx ty tz qx qy qz qw``, s and m, the
quaternion with its scalar last; lines that begin with # are comments. tx ty tz is where the body is
in the file's frame, the quaternion takes the body's axes to those.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from relnav_graph.arrays import Array
from relnav_graph.core.track import Recording
from relnav_graph.io.clocks import Clock
from relnav_graph.io.declared import Roles, check_roles, poses
from relnav_graph.io.known import Known
from relnav_graph.io.lines import file_of, numbers
from relnav_graph.io.poses import Where, from_quaternions

__all__ = ["FILES", "check", "read"]

FILES = True
check = check_roles
_COLUMNS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")


def _pose(where: Where, values: Array) -> tuple[Array, Array]:
    return values[:, :3].copy(), from_quaternions(where, values[:, 3:], "xyzw")


def read(
    path: Path,
    known: Known,
    truth: Mapping[str, str] | None = None,
    measured: str | Sequence[str] | Mapping[str, str] | None = None,
    inverse: bool = False,
    file: str = "",
    clock: str = "none",
    origin: str | int | float | None = None,
) -> Recording:
    """The poses of one file.

    truth, measured, inverse: what they are to be, see `relnav_graph.io.declared`; with
    R_tc, r_tc_t in mind the file's frame is t and its body c; inverse: the other way round. file: a
    part of the name, in a folder with several; clock, origin: that of the stamps, see
    `relnav_graph.io.clocks.Clock`; decimals are subtracted as written.

    Raises InputError without a role, and, with file and line, on rows of another form, times that
    do not rise, and quaternions whose length is not one within 1e-3.
    """
    roles = Roles.of("data.options", truth, measured, None, inverse)
    rows = numbers(file_of(path, ("*.tum", "*.txt"), file), _COLUMNS)
    return poses(known, roles, rows, Clock(clock, origin), rows.stamps, _pose)
