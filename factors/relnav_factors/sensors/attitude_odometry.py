"""How the chaser has turned, as seen from the target, since an earlier epoch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_factors.derived.relative_pose import relative_attitude
from relnav_factors.dynamics.previous_pose import previous_blocks
from relnav_factors.shared.attitude import AttitudeSensor, attitude_residual
from relnav_factors.shared.points import Pose, pose_blocks
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.state import Block
from relnav_graph.maths import dense


@jit
def chaser_in_target(attitudes: Array) -> tuple[Array, Array]:
    """``R_tc``, and its Jacobian to the attitudes that it is made of.

    attitudes: (18,): R_oc, R_ot row by row, or (9,): R_tc itself. Returns R_tc (3, 3) and the
    Jacobian (3, 6) or (3, 3), rad/rad, of right perturbations.
    """
    first = dense.matrix_at(attitudes, 0)
    if attitudes.shape[0] == 9:
        return first, dense.identity(3)
    return relative_attitude(first, dense.matrix_at(attitudes, 9))


@jit
def turn_between(R_cs: Array, before: Array, now: Array) -> tuple[Array, Array]:
    """``R_s-s = R_cs^T R_tc-^T R_tc R_cs``: from present sensor axes s to those of before, s-.

    R_cs: (3, 3); before, now: (18,): R_oc, R_ot row by row, or (9,): R_tc. Returns R_s-s (3, 3) and
    the Jacobian (3, 12) or (3, 6), rad/rad, of its right perturbation to those of the attitudes
    before, then now.
    """
    R_before, to_before = chaser_in_target(before)
    R_now, to_now = chaser_in_target(now)
    R_cc = dense.transposed_matmul(R_before, R_now)
    n = to_now.shape[1]
    in_c = np.zeros((3, 2 * n))
    dense.put_block(in_c, 0, 0, dense.transposed_matmul(R_cc, to_before), -1.0)
    dense.put_block(in_c, 0, n, to_now, 1.0)
    turn = dense.matmul(dense.transposed_matmul(R_cs, R_cc), R_cs)
    return turn, dense.transposed_matmul(R_cs, in_c)


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = Log(R_measured^T R_s-s)``, in present sensor axes, see `turn_between`.

    p (9,): R_cs row by row. q (0,). z (4,): q_wxyz of R_s-s. x (36,): R_oc-, R_ot-, R_oc, R_ot row
    by row, or (18,): R_tc-, R_tc; the minus marks the earlier epoch. r (3,), rad. H (3, 12) or
    (3, 6), rad/rad.
    """
    half = x.shape[0] // 2
    turn, jacobian = turn_between(dense.matrix_at(p, 0), x[:half], x[half:])
    dense.put_block(H, 0, 0, dense.matmul(attitude_residual(z, turn, r), jacobian), 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class AttitudeOdometry(AttitudeSensor):
    """Turn of the sensor relative to the target between two epochs, as q_wxyz.

    z = R_s-s = R_cs^T R_tc-^T R_tc R_cs: what a front end that knows no points gives, from
    matching what it sees with what it saw (Setterfield et al. 2018). The earlier attitude
    comes from `PreviousPose`.

    pose: how the attitudes stand in the state.
    """

    kind: ClassVar[str] = "attitude_odometry"
    kernel = staticmethod(kernel)

    pose: Pose = "orbital"

    @property
    def reads(self) -> tuple[Block, ...]:
        return *previous_blocks(self.pose)[:-1], *pose_blocks(self.pose)[:-1]

    def attitude(self, *x: Array) -> Array:
        """R_s-s (3, 3), which takes present sensor axes to those of before."""
        before, now = np.concatenate([np.ravel(value) for value in x]).reshape(2, -1)
        return turn_between(np.array(self.sensor_attitude), before, now)[0]
