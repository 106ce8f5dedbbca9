"""Pose of the chaser relative to the target's body, from the two attitudes in o."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.state import (
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    TARGET_ATTITUDE,
    Block,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RelativeAttitude:
    """R_tc = R_ot^T R_oc."""

    kind: ClassVar[str] = "relative_attitude"
    block: ClassVar[Block] = RELATIVE_ATTITUDE
    reads: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, TARGET_ATTITUDE)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """R_tc (3, 3) and its Jacobian (3, 6)."""
        R_oc, R_ot = x
        R_tc = R_ot.T @ R_oc
        return R_tc, np.hstack([np.eye(3), -R_tc.T])


@dataclass(frozen=True)
class PositionInTarget:
    """r_tc_t = R_ot^T r_tc_o: where the chaser is as seen from the target's body."""

    kind: ClassVar[str] = "position_in_target"
    block: ClassVar[Block] = Block("position_in_target", "r_tc_t", "vector", 3, "m", "t", "m")
    reads: ClassVar[tuple[Block, ...]] = (TARGET_ATTITUDE, RELATIVE_POSITION)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """r_tc_t (3,) and its Jacobian (3, 6)."""
        R_ot, r_tc_o = x
        r_tc_t = R_ot.T @ r_tc_o
        return r_tc_t, np.hstack([so3.skew(r_tc_t), R_ot.T])
