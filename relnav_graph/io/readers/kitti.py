"""Reader of trajectories as KITTI's odometry has them.

A row for each pose, separated by blanks: the upper 3 by 4 of the matrix that takes the body's
coordinates to those of the file's frame, ``[R | r]`` row by row, m. Times are not in it: a second
file has one for each row, s, or the rows are equally far apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.files import file_in
from relnav_graph.io.clocks import Clock
from relnav_graph.io.declared import Roles, check_roles, poses
from relnav_graph.io.known import Known
from relnav_graph.io.lines import Rows, file_of, numbers
from relnav_graph.io.poses import Where, from_matrices
from relnav_graph.units import parse_quantity

__all__ = ["FILES", "check", "read"]

FILES = True
check = check_roles
_COLUMNS = tuple(f"T{i}{j}" for i in range(3) for j in range(4))


def _stamps(rows: Rows, times: str, rate: Any) -> list[Decimal]:
    if bool(times) == (rate is not None):
        both = "both" if times else "neither"
        raise InputError(
            f"data.options: found {both} of times, a file, and rate; expected one: KITTI's poses"
            " have no time"
        )
    if not times:
        hertz = Decimal(repr(parse_quantity(rate, "Hz")))
        if hertz <= 0:
            raise InputError(f"data.options.rate: found {rate!r}, expected more than zero")
        return [Decimal(k) / hertz for k in range(len(rows.lines))]
    own = numbers(file_in(rows.path.parent, times), ("time",))
    if len(own.lines) != len(rows.lines):
        raise InputError(
            f"{own.path}: found {len(own.lines)} times, expected {len(rows.lines)}, one for each"
            f" row of {rows.path.name}"
        )
    return own.stamps


def _pose(where: Where, values: Array) -> tuple[Array, Array]:
    matrices = values.reshape(-1, 3, 4)
    R = from_matrices(where, np.ascontiguousarray(matrices[:, :, :3]))
    return np.ascontiguousarray(matrices[:, :, 3]), R


def read(
    path: Path,
    known: Known,
    truth: Mapping[str, str] | None = None,
    measured: str | Sequence[str] | Mapping[str, str] | None = None,
    inverse: bool = False,
    file: str = "",
    times: str = "",
    rate: str | float | None = None,
    clock: str = "none",
    origin: str | int | float | None = None,
) -> Recording:
    """The poses of one file.

    truth, measured, inverse: what they are to be, see `relnav_graph.io.declared`; file: a part of
    the name, in a folder with several; times: name of the file of times beside it, or rate: Hz, of
    the rows; clock, origin: that of the times, see `relnav_graph.io.clocks.Clock`.

    Raises InputError without a role or times, and, with file and line, on rows of another form,
    times that do not rise, and matrices that are no rotations within 1e-3.
    """
    roles = Roles.of("data.options", truth, measured, None, inverse)
    patterns = ("*.kitti", "poses.txt", "[0-9]*.txt", "*.txt")
    rows = numbers(file_of(path, patterns, file), _COLUMNS, stamped=False)
    stamps = _stamps(rows, times, rate)
    return poses(known, roles, rows, Clock(clock, origin), stamps, _pose)
