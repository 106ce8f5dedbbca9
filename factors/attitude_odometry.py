"""How the chaser has turned, as seen from the target, since an earlier epoch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.state import Block

from ._attitude import AttitudeSensor, attitude_residual
from ._points import Pose, pose_blocks
from .previous_pose import PREVIOUS_ATTITUDE
from .relative_pose import relative_attitude

Array = NDArray[np.float64]


@jit
def turn_between(R_cs: Array, R_before: Array, attitudes: Array) -> tuple[Array, Array]:
    """R_s-s (3, 3), from present sensor axes to those of before, and the Jacobian of its
    right perturbation to R_tc- and to the attitudes (R_oc, R_ot) or (R_tc)."""
    both = attitudes.shape[0] == 18
    R_tc, to_now = so3.matrix_at(attitudes, 0), so3.identity(3)
    if both:
        R_tc, to_now = relative_attitude(R_tc, so3.matrix_at(attitudes, 9))
    R_cc = so3.transpose_multiply(R_before, R_tc)
    in_c = np.zeros((3, 9 if both else 6))
    so3.put(in_c, 0, 0, so3.transpose_multiply(R_cc, so3.identity(3)), -1.0)
    so3.put(in_c, 0, 3, to_now, 1.0)
    turn = so3.multiply(so3.transpose_multiply(R_cs, R_cc), R_cs)
    return turn, so3.transpose_multiply(R_cs, in_c)


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """r (3,): Log(R_measured^T R_s-s), in present sensor axes. x = (R_tc-, R_oc, R_ot) or
    (R_tc-, R_tc)."""
    turn, jacobian = turn_between(so3.matrix_at(p, 0), so3.matrix_at(x, 0), x[9:])
    so3.put(H, 0, 0, so3.multiply(attitude_residual(z, turn, r), jacobian), 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class AttitudeOdometry(AttitudeSensor):
    """Turn of the sensor relative to the target between two epochs, as q_wxyz.

    z = R_s-s = R_cs^T R_tc-^T R_tc R_cs: what a front end that knows no points gives, from
    matching what it sees with what it saw (Setterfield et al. 2018). The earlier attitude
    comes from `PreviousPose`.

    pose: how the present attitude stands in the state.
    """

    kind: ClassVar[str] = "attitude_odometry"
    kernel = staticmethod(kernel)

    pose: Pose = "orbital"

    @property
    def reads(self) -> tuple[Block, ...]:
        return PREVIOUS_ATTITUDE, *pose_blocks(self.pose)[:-1]

    def attitude(self, *x: Array) -> Array:
        """R_s-s (3, 3)."""
        packed = np.concatenate([np.ravel(value) for value in x])
        R_cs = np.ascontiguousarray(self.sensor_attitude)
        return turn_between(R_cs, packed[:9].reshape(3, 3), packed[9:])[0]
