"""Pose of the chaser relative to the target's body, from the two attitudes in o."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph.models import DerivedQuantity
from relnav_graph.state import (
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    TARGET_ATTITUDE,
    Block,
)

Array = NDArray[np.float64]


def _transposed(R: Array) -> Array:
    return np.swapaxes(R, 1, 2)


@dataclass(frozen=True)
class RelativeAttitude(DerivedQuantity):
    """R_tc = R_ot^T R_oc."""

    kind: ClassVar[str] = "relative_attitude"
    block: ClassVar[Block] = RELATIVE_ATTITUDE
    reads: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, TARGET_ATTITUDE)

    def values(self, *x: Array) -> tuple[Array, Array]:
        """R_tc (N, 3, 3) and its Jacobian (N, 3, 6)."""
        R_oc, R_ot = x
        R_tc = _transposed(R_ot) @ R_oc
        unit = np.broadcast_to(np.eye(3), R_tc.shape)
        return R_tc, np.concatenate([unit, -_transposed(R_tc)], axis=2)


@dataclass(frozen=True)
class PositionInTarget(DerivedQuantity):
    """r_tc_t = R_ot^T r_tc_o: where the chaser is as seen from the target's body."""

    kind: ClassVar[str] = "position_in_target"
    block: ClassVar[Block] = Block("position_in_target", "r_tc_t", "vector", 3, "m", "t", "m")
    reads: ClassVar[tuple[Block, ...]] = (TARGET_ATTITUDE, RELATIVE_POSITION)

    def values(self, *x: Array) -> tuple[Array, Array]:
        """r_tc_t (N, 3) and its Jacobian (N, 3, 6)."""
        R_ot, r_tc_o = x
        R_to = _transposed(R_ot)
        r_tc_t = np.einsum("kij,kj->ki", R_to, r_tc_o)
        turning = np.cross(r_tc_t[:, None], np.eye(3)[None])  # its rows: those of -[r x]
        return r_tc_t, np.concatenate([_transposed(turning), R_to], axis=2)
