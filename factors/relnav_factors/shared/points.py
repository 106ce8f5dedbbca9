"""Points of the target seen from a sensor on the chaser: the formula that all cameras share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from relnav_factors.shared.mounting import mounting_of, without_mounting
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    TARGET_ATTITUDE,
)
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3

#: How the pose stands in the state: in the target's orbital frame, by R_oc, R_ot and
#: r_tc_o; or directly relative to the target, by R_tc and r_tc_t.
Pose = Literal["orbital", "target"]


def pose_blocks(pose: Pose) -> tuple[Block, ...]:
    """The blocks that hold the pose, in the order of the kernels."""
    if pose == "orbital":
        return CHASER_ATTITUDE, TARGET_ATTITUDE, RELATIVE_POSITION
    return RELATIVE_ATTITUDE, RELATIVE_POSITION_T


def pose_in_target(pose: Pose, x: Sequence[Array]) -> tuple[Array, Array]:
    """R_tc (3, 3) and r_tc_t (3,), m, of the values x of `pose_blocks`, maybe with others after
    them."""
    if pose == "target":
        return x[0], x[1]
    return x[1].T @ x[0], x[1].T @ x[2]


@jit
def point_seen(
    mounting: Array, columns: int, point_t: Array, free: int, x: Array
) -> tuple[Array, Array]:
    """Position in sensor axes of a point given in target axes, and its Jacobian.

    mounting: (12,): R_cs row by row, r_sc_c (m), the sensor's place in the chaser; columns: 6 where
    it is estimated, else 0; point_t: X_t (3,), m; free: 3 where it is estimated, else 0; x: (21,):
    R_oc, R_ot row by row, r_tc_o (m), or (12,): R_tc, r_tc_t (m). Returns p_s (3,), m, and its
    Jacobian (3, 9 + columns + free) or (3, 6 + columns + free) to the pose, then to R_cs and
    r_sc_c, then to X_t, m/rad and m/m.

        p_s = R_cs^T (R_oc^T (R_ot X_t - r_tc_o) - r_sc_c)
    """
    orbital = x.shape[0] == 21
    n = 9 if orbital else 6
    R_cs, R_oc = dense.matrix_at(mounting, 0), dense.matrix_at(x, 0)
    r_at = 18 if orbital else 9
    X_o = dense.matvec(dense.matrix_at(x, 9), point_t) if orbital else point_t
    line_c = np.zeros(3)  # from the chaser's origin to the point
    for i in range(3):
        for j in range(3):
            line_c[i] += R_oc[j, i] * (X_o[j] - x[r_at + j])
    point_s = np.zeros(3)
    jacobian = np.empty((3, n + columns + free))
    for i in range(3):
        axis_c, axis_o, axis_t = np.empty(3), np.zeros(3), np.zeros(3)  # of the sensor
        for j in range(3):
            axis_c[j] = R_cs[j, i]
            point_s[i] += axis_c[j] * (line_c[j] - mounting[9 + j])
            for k in range(3):
                axis_o[j] += R_oc[j, k] * R_cs[k, i]
        # A row a^T [v x] is the vector product a x v.
        so3.put_cross(jacobian, i, 0, axis_c, line_c, 1.0)
        if orbital:
            for j in range(3):
                for k in range(3):
                    axis_t[j] += x[9 + 3 * k + j] * axis_o[k]
            so3.put_cross(jacobian, i, 3, axis_t, point_t, -1.0)
        for j in range(3):
            jacobian[i, n - 3 + j] = -axis_o[j]
        for j in range(free):
            jacobian[i, n + columns + j] = axis_t[j] if orbital else axis_o[j]
    if columns > 0:
        dense.put_block(jacobian, 0, n, so3.skew(point_s), 1.0)
        for i in range(3):
            for j in range(3):
                jacobian[i, n + 3 + j] = -R_cs[j, i]
    return point_s, jacobian


@jit
def point_in_sensor(p: Array, q: Array, x: Array) -> tuple[Array, Array]:
    """`point_seen` of a point that is known or not, from the mounting that p and x hold.

    p: starts with the (13,) of a mounting, see `mounting_of`; q: X_t (3,), m, of a known point,
    (0,) of an unknown one; x: (21,) or (12,), as there, then R_ns and d_sn_c (m), (12,), where the
    mounting is estimated, then X_t (3,), m, of an unknown point. Result: m, m/rad, m/m.
    """
    free = 3 if q.shape[0] == 0 else 0
    known = x[: x.shape[0] - free]
    point_t = x[x.shape[0] - free :] if free > 0 else q
    mounting, pose = mounting_of(p, known), without_mounting(p, known)
    return point_seen(mounting, int(p[12]), point_t, free, pose)
