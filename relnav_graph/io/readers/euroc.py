"""Reader of trajectories as the EuRoC MAV data set has them, with the gyro and accelerometer.

Tables of commas, below a line of names that begins with #; stamps are whole nanoseconds of Unix
time. ``state_groundtruth_estimate0/data.csv``: timestamp, position p_RS_R (m), quaternion q_RS with
its scalar first, and maybe velocity v_RS_R (m/s), bias of the gyro (rad/s) and of the accelerometer
(m/s^2) in S. ``imu0/data.csv``: timestamp, rate w_RS_S (rad/s), specific force a_RS_S (m/s^2). R is
the file's frame, S the body, whose axes are those of the IMU.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.clocks import Clock
from relnav_graph.io.declared import Collected, Roles, check_roles
from relnav_graph.io.known import Known
from relnav_graph.io.lines import Rows, file_of, numbers, rising
from relnav_graph.io.poses import Motion, from_quaternions

__all__ = ["FILES", "check", "read"]

FILES = True
check = check_roles
_POSE = ("timestamp", *(f"p_RS_R_{a}" for a in "xyz"), *(f"q_RS_{a}" for a in "wxyz"))
_IMU = ("timestamp", *(f"w_RS_S_{a}" for a in "xyz"), *(f"a_RS_S_{a}" for a in "xyz"))
#: What may follow the pose, three columns each.
_MORE = ("velocity", "rate_bias", "acceleration_bias")
_STATES, _SAMPLES = ("**/state_groundtruth_estimate*/data.csv", "*.csv"), ("**/imu*/data.csv",)


def _stamps(rows: Rows) -> NDArray[np.int64]:
    """Whole nanoseconds (N,)."""
    for k, stamp in enumerate(rows.stamps):
        if stamp != stamp.to_integral_value() or abs(stamp) >= Decimal(2) ** 63:
            raise InputError(f"{rows.where(k)}: found the stamp {stamp}, expected whole ns")
    return np.array([int(stamp) for stamp in rows.stamps], dtype=np.int64)


def _states(rows: Rows, t: NDArray[np.float64]) -> Motion:
    rising(rows.where, t)
    count = (rows.values.shape[1] - 7) // 3
    if rows.values.shape[1] != 7 + 3 * count or count > len(_MORE):
        found = f"found {rows.values.shape[1] + 1} columns"
        raise InputError(f"{rows.where(0)}: {found}, expected {len(_POSE)} to {len(_POSE) + 9}")
    values = {
        "position": rows.values[:, :3].copy(),
        "attitude": from_quaternions(rows.where, rows.values[:, 3:7], "wxyz"),
    }
    for k, name in enumerate(_MORE[:count]):
        values[name] = rows.values[:, 7 + 3 * k : 10 + 3 * k].copy()
    return Motion(t, values, rows.where)


def read(
    path: Path,
    known: Known,
    truth: Mapping[str, str] | None = None,
    measured: str | Sequence[str] | Mapping[str, str] | None = None,
    inputs: Mapping[str, str] | None = None,
    inverse: bool = False,
    samples: str = "mean",
    file: str = "",
    clock: str = "unix",
    origin: str | int | float | None = None,
) -> Recording:
    """The poses of one file, and samples of the IMU beside it.

    truth, measured, inverse: what the states are to be; inputs, samples: what the IMU's, see
    `relnav_graph.io.declared`; quantities are position, attitude, velocity, rate_bias and
    acceleration_bias; rate and acceleration. path: the folder of a sequence, a table of states or,
    where inputs alone are asked for, one of the IMU. file: a part of the name of the table of
    states, in a folder with several; clock, origin: that of the stamps, see
    `relnav_graph.io.clocks.Clock`; whole nanoseconds are subtracted as such.

    Raises InputError without a role, and, with file and line, on rows of another form, stamps that
    are no whole nanoseconds or do not rise, and quaternions whose length is not one within 1e-3.
    """
    roles = Roles.of("data.options", truth, measured, inputs, inverse, samples)
    states = samples_of = None
    if truth or measured:
        states = numbers(file_of(path, _STATES, file), _POSE, ",", more=True)
    if inputs:
        if path.is_file() and states is not None:
            raise InputError(f"{path}: found a file, expected the folder of states and inputs")
        samples_of = numbers(file_of(path, _SAMPLES), _IMU, ",")
    tables = {name: one for name, one in (("s", states), ("i", samples_of)) if one is not None}
    stamps = {name: _stamps(one) for name, one in tables.items()}
    read_by, first = Clock(clock, origin), min(int(s.min()) for s in stamps.values())
    begin = read_by.begin(str(path), first)
    found = Collected(known, path.name)
    if states is not None:
        motion = _states(states, read_by.seconds(stamps["s"], begin))
        found.add(motion, roles.only("truth", "measured"))
    if samples_of is not None:
        t, values = read_by.seconds(stamps["i"], begin), samples_of.values
        rising(samples_of.where, t)
        parts = {"rate": values[:, :3].copy(), "acceleration": values[:, 3:].copy()}
        found.add(Motion(t, parts, samples_of.where), roles.only("inputs"))
    return found.recording(read_by.settings(begin))
