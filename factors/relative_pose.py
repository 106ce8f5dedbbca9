"""Pose of the chaser relative to the target's body, from the two attitudes in o."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.state import (
    BODY_RATE,
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    TARGET_ATTITUDE,
    Block,
)

Array = NDArray[np.float64]


@jit
def relative_attitude(R_oc: Array, R_ot: Array) -> tuple[Array, Array]:
    """R_tc = R_ot^T R_oc and its Jacobian (3, 6) to (R_oc, R_ot)."""
    R_tc, jacobian = so3.transpose_multiply(R_ot, R_oc), np.zeros((3, 6))
    for i in range(3):
        jacobian[i, i] = 1.0
        for j in range(3):
            jacobian[i, 3 + j] = -R_tc[j, i]
    return R_tc, jacobian


@jit
def position_in_target(R_ot: Array, r_tc_o: Array) -> tuple[Array, Array]:
    """r_tc_t = R_ot^T r_tc_o and its Jacobian (3, 6) to (R_ot, r_tc_o)."""
    r_tc_t, jacobian = so3.unrotate(R_ot, r_tc_o), np.empty((3, 6))
    so3.put(jacobian, 0, 0, so3.skew(r_tc_t), 1.0)
    for i in range(3):
        for j in range(3):
            jacobian[i, 3 + j] = R_ot[j, i]
    return r_tc_t, jacobian


@dataclass(frozen=True)
class RelativeAttitude:
    """R_tc = R_ot^T R_oc."""

    kind: ClassVar[str] = "relative_attitude"
    block: ClassVar[Block] = RELATIVE_ATTITUDE
    reads: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, TARGET_ATTITUDE)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """R_tc (3, 3) and its Jacobian (3, 6)."""
        return relative_attitude(*(np.ascontiguousarray(v) for v in x))


@dataclass(frozen=True)
class PositionInTarget:
    """r_tc_t = R_ot^T r_tc_o: where the chaser is as seen from the target's body."""

    kind: ClassVar[str] = "position_in_target"
    block: ClassVar[Block] = Block("position_in_target", "r_tc_t", "vector", 3, "m", "t", "m")
    reads: ClassVar[tuple[Block, ...]] = (TARGET_ATTITUDE, RELATIVE_POSITION)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """r_tc_t (3,) and its Jacobian (3, 6)."""
        return position_in_target(*(np.ascontiguousarray(v) for v in x))


@dataclass(frozen=True)
class TargetRateInChaser:
    """w_ti_c = R_oc^T R_ot w_ti_t: for a target whose own axes are arbitrary."""

    kind: ClassVar[str] = "target_rate_in_chaser"
    block: ClassVar[Block] = Block("target_rate", "w_ti_c", "vector", 3, "rad/s", "c", "deg/s")
    reads: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, TARGET_ATTITUDE, BODY_RATE)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """w_ti_c (3,) and its Jacobian (3, 9)."""
        R_oc, R_ot, w_ti_t = x
        R_ct = R_oc.T @ R_ot
        w_ti_c = R_ct @ w_ti_t
        return w_ti_c, np.hstack([so3.skew(w_ti_c), -R_ct @ so3.skew(w_ti_t.copy()), R_ct])
