"""Pose of the chaser relative to the target's body, from the two attitudes in o."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import MATRIX, STACK
from relnav_graph.core.catalogue import (
    BODY_RATE,
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    TARGET_ATTITUDE,
)
from relnav_graph.core.models import DerivedQuantity
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3


def _numbers(v: Array) -> Array:
    return np.ascontiguousarray(v, dtype=np.float64)


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


@jit
def position_in_target(R_ot: Array, r_tc_o: Array) -> tuple[Array, Array]:
    """``r_tc_t = R_ot^T r_tc_o``, the position of the chaser in target axes.

    R_ot: (3, 3); r_tc_o: (3,), m. Returns r_tc_t (3,), m, and its Jacobian (3, 6) to
    (R_ot, r_tc_o): per rad of a right perturbation ``R_ot Exp(d)``, then per m.
    """
    r_tc_t, jacobian = dense.transposed_matvec(R_ot, r_tc_o), np.empty((3, 6))
    dense.put_block(jacobian, 0, 0, so3.skew(r_tc_t), 1.0)
    for i in range(3):
        for j in range(3):
            jacobian[i, 3 + j] = R_ot[j, i]
    return r_tc_t, jacobian


@jit_loop(STACK, STACK, STACK, STACK)
def relative_attitudes(R_oc: Array, R_ot: Array, R_tc: Array, jacobian: Array) -> None:
    """`relative_attitude` at N epochs, into the last two arguments.

    R_oc, R_ot, R_tc: (N, 3, 3); jacobian: (N, 3, 6), rad/rad, to (R_oc, R_ot).
    """
    for k in range(R_oc.shape[0]):
        give_way(k)
        one, slope = relative_attitude(R_oc[k], R_ot[k])
        dense.put_block(R_tc[k], 0, 0, one, 1.0)
        dense.put_block(jacobian[k], 0, 0, slope, 1.0)


@jit_loop(STACK, MATRIX, MATRIX, STACK)
def positions_in_target(R_ot: Array, r_tc_o: Array, r_tc_t: Array, jacobian: Array) -> None:
    """`position_in_target` at N epochs, into the last two arguments.

    R_ot: (N, 3, 3); r_tc_o, r_tc_t: (N, 3), m; jacobian: (N, 3, 6) to (R_ot, r_tc_o).
    """
    for k in range(R_ot.shape[0]):
        give_way(k)
        one, slope = position_in_target(R_ot[k], r_tc_o[k])
        dense.put_vector(r_tc_t[k], 0, one)
        dense.put_block(jacobian[k], 0, 0, slope, 1.0)


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
        R_oc, R_ot = (v.reshape(len(x[0]), 3, 3) for v in map(_numbers, x))
        out, jacobian = np.empty(R_oc.shape), np.empty((len(R_oc), 3, 6))
        relative_attitudes(R_oc, R_ot, out, jacobian)
        return out, jacobian


@dataclass(frozen=True)
class PositionInTarget(DerivedQuantity):
    """r_tc_t = R_ot^T r_tc_o: where the chaser is as seen from the target's body."""

    kind: ClassVar[str] = "position_in_target"
    block: ClassVar[Block] = Block("position_in_target", "r_tc_t", "vector", 3, "m", "t", "m")
    reads: ClassVar[tuple[Block, ...]] = (TARGET_ATTITUDE, RELATIVE_POSITION)

    def values(self, *x: Array) -> tuple[Array, Array]:
        """r_tc_t (N, 3), m, and its Jacobian (N, 3, 6).

        x: R_ot (N, 3, 3); r_tc_o (N, 3), m.
        """
        R_ot = _numbers(x[0]).reshape(-1, 3, 3)
        r_tc_o = _numbers(x[1]).reshape(len(R_ot), 3)
        out, jacobian = np.empty(r_tc_o.shape), np.empty((len(R_ot), 3, 6))
        positions_in_target(R_ot, r_tc_o, out, jacobian)
        return out, jacobian


@dataclass(frozen=True)
class TargetRateInChaser(DerivedQuantity):
    """w_ti_c = R_oc^T R_ot w_ti_t: for a target whose own axes are arbitrary."""

    kind: ClassVar[str] = "target_rate_in_chaser"
    block: ClassVar[Block] = Block("target_rate", "w_ti_c", "vector", 3, "rad/s", "c", "deg/s")
    reads: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, TARGET_ATTITUDE, BODY_RATE)

    def values(self, *x: Array) -> tuple[Array, Array]:
        """w_ti_c (N, 3), rad/s, and its Jacobian (N, 3, 9).

        x: R_oc, R_ot (N, 3, 3); w_ti_t (N, 3), rad/s.
        """
        R_oc, R_ot, w_ti_t = x
        R_ct = np.swapaxes(R_oc, 1, 2) @ R_ot
        w_ti_c = np.einsum("kij,kj->ki", R_ct, w_ti_t)
        # The rows of -[w x] are those of w x e_i.
        crossed = [np.cross(w[:, None], np.eye(3)[None]) for w in (w_ti_c, w_ti_t)]
        return w_ti_c, np.concatenate([-crossed[0], R_ct @ crossed[1], R_ct], axis=2)
