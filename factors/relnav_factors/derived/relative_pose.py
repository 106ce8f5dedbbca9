"""Pose of the chaser relative to the target's body, from the two attitudes in o."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import (
    BODY_RATE,
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    TARGET_ATTITUDE,
)
from relnav_graph.core.models import DerivedQuantity
from relnav_graph.core.state import Block
from relnav_graph.maths import dense


def _numbers(v: Array) -> Array:
    return np.ascontiguousarray(v, dtype=np.float64)


def _skews(v: Array) -> Array:
    """``[v x]`` of N vectors: v (N, 3), result (N, 3, 3), whose columns are v x e_i."""
    skews: Array = -np.cross(v[:, None], np.eye(3)[None])
    return skews


@jit
def relative_attitude(R_oc: Array, R_ot: Array) -> tuple[Array, Array]:
    """``R_tc = R_ot^T R_oc``, the attitude of the chaser relative to the target.

    R_oc, R_ot: (3, 3). Returns R_tc (3, 3) and its Jacobian (3, 6), rad/rad, to right perturbations
    ``R Exp(d)`` of (R_oc, R_ot).
    """
    R_tc, jacobian = dense.transposed_matmul(R_ot, R_oc), np.zeros((3, 6))
    for i in range(3):
        jacobian[i, i] = 1.0
        for j in range(3):
            jacobian[i, 3 + j] = -R_tc[j, i]
    return R_tc, jacobian


@dataclass(frozen=True)
class RelativeAttitude(DerivedQuantity):
    """R_tc = R_ot^T R_oc."""

    kind: ClassVar[str] = "relative_attitude"
    block: ClassVar[Block] = RELATIVE_ATTITUDE
    reads: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, TARGET_ATTITUDE)

    def values(self, *x: Array) -> tuple[Array, Array]:
        """R_tc (N, 3, 3) and its Jacobian (N, 3, 6), rad/rad.

        x: R_oc, R_ot (N, 3, 3).
        """
        out, jacobian = np.empty((len(x[0]), 3, 3)), np.empty((len(x[0]), 3, 6))
        for k, (R_oc, R_ot) in enumerate(zip(*map(_numbers, x), strict=True)):
            out[k], jacobian[k] = relative_attitude(R_oc, R_ot)
        return out, jacobian


@dataclass(frozen=True)
class PositionInTarget(DerivedQuantity):
    """r_tc_t = R_ot^T r_tc_o: where the chaser is as seen from the target's body."""

    kind: ClassVar[str] = "position_in_target"
    block: ClassVar[Block] = Block("position_in_target", "r_tc_t", "vector", 3, "m", "t", "m")
    reads: ClassVar[tuple[Block, ...]] = (TARGET_ATTITUDE, RELATIVE_POSITION)

    def values(self, *x: Array) -> tuple[Array, Array]:
        """r_tc_t (N, 3), m, and its Jacobian (N, 3, 6): per rad of R_ot Exp(d), then per m.

        x: R_ot (N, 3, 3); r_tc_o (N, 3), m.
        """
        R_ot, r_tc_o = x
        R_to = np.swapaxes(R_ot, 1, 2)
        r_tc_t = np.einsum("kij,kj->ki", R_to, r_tc_o)
        return r_tc_t, np.concatenate([_skews(r_tc_t), R_to], axis=2)


@dataclass(frozen=True)
class TargetRateInChaser(DerivedQuantity):
    """w_ti_c = R_oc^T R_ot w_ti_t: for a target whose own axes are arbitrary."""

    kind: ClassVar[str] = "target_rate_in_chaser"
    block: ClassVar[Block] = Block("target_rate", "w_ti_c", "vector", 3, "rad/s", "c", "deg/s")
    reads: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, TARGET_ATTITUDE, BODY_RATE)

    def values(self, *x: Array) -> tuple[Array, Array]:
        """w_ti_c (N, 3), rad/s, and its Jacobian (N, 3, 9), to (R_oc, R_ot, w_ti_t).

        x: R_oc, R_ot (N, 3, 3); w_ti_t (N, 3), rad/s.
        """
        R_oc, R_ot, w_ti_t = x
        R_ct = np.swapaxes(R_oc, 1, 2) @ R_ot
        w_ti_c = np.einsum("kij,kj->ki", R_ct, w_ti_t)
        return w_ti_c, np.concatenate([_skews(w_ti_c), -R_ct @ _skews(w_ti_t), R_ct], axis=2)
