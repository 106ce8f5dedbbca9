"""How the chaser has turned, as seen from the target, since an earlier epoch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.derived.relative_pose import relative_attitude
from relnav_factors.sensors.pose_copy import PoseCopy, copier_of, earlier_blocks
from relnav_factors.shared.attitude import AttitudeSensor, attitude_residual
from relnav_factors.shared.mounting import mounting_of, without_mounting
from relnav_factors.shared.points import Pose, pose_blocks
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


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
    the Jacobian (3, 15) or (3, 9), rad/rad, of its right perturbation to those of the attitudes
    before, then now, then of R_cs.
    """
    R_before, to_before = chaser_in_target(before)
    R_now, to_now = chaser_in_target(now)
    R_cc = dense.transposed_matmul(R_before, R_now)
    n = to_now.shape[1]
    in_c = np.zeros((3, 2 * n))
    dense.put_block(in_c, 0, 0, dense.transposed_matmul(R_cc, to_before), -1.0)
    dense.put_block(in_c, 0, n, to_now, 1.0)
    turn = dense.matmul(dense.transposed_matmul(R_cs, R_cc), R_cs)
    slopes = np.empty((3, 2 * n + 3))
    dense.put_block(slopes, 0, 0, dense.transposed_matmul(R_cs, in_c), 1.0)
    for i in range(3):  # Exp(-d) R_s-s Exp(d)
        for j in range(3):
            slopes[i, 2 * n + j] = (1.0 if i == j else 0.0) - turn[j, i]
    return turn, slopes


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = Log(R_measured^T R_s-s)``, in present sensor axes, see `turn_between`.

    p (13,): of the mounting. q (0,). z (4,): q_wxyz of R_s-s. x (36,): R_oc-, R_ot-, R_oc, R_ot row
    by row, or (18,): R_tc-, R_tc; the minus marks the earlier epoch; then (9,): R_ns of an
    estimated mounting. r (3,), rad. H (3, 12) or (3, 6), and 3 columns more for the mounting,
    rad/rad.
    """
    R_cs, both = dense.matrix_at(mounting_of(p, x), 0), without_mounting(p, x)
    half = both.shape[0] // 2
    turn, slopes = turn_between(R_cs, both[:half], both[half:])
    jacobian = dense.matmul(attitude_residual(z, turn, r), slopes)
    for i in range(3):
        for j in range(H.shape[1]):
            H[i, j] = jacobian[i, j]
    return 0


@dataclass(frozen=True, kw_only=True)
class AttitudeOdometry(AttitudeSensor):
    """Turn of the sensor relative to the target between two epochs, as q_wxyz.

    z = R_s-s = R_cs^T R_tc-^T R_tc R_cs: what a front end that knows no points gives, from
    matching what it sees with what it saw (Setterfield et al. 2018). The earlier attitude
    comes from `PreviousPose`, or from a `PoseCopy`.

    pose: how the attitudes stand in the state; keyframe: s, the earlier epoch of a loop closure,
    None: that of `PreviousPose`.
    """

    kind: ClassVar[str] = "attitude_odometry"
    kernel = staticmethod(kernel)

    pose: Pose = "orbital"
    keyframe: Annotated[float, Quantity("s")] | None = None

    def copier(self) -> PoseCopy:
        """The sensor that copies the attitudes at the keyframe. Raises InputError without one."""
        return copier_of(self.kind, self.pose, self.keyframe, "attitudes")

    @property
    def reads(self) -> tuple[Block, ...]:
        both = *earlier_blocks(self.pose, self.keyframe)[:-1], *pose_blocks(self.pose)[:-1]
        return *both, *self.mounting_blocks

    def attitude(self, *x: Array) -> Array:
        """R_s-s (3, 3), which takes present sensor axes to those of before."""
        p, packed = self.constants(), np.concatenate([np.ravel(value) for value in x])
        before, now = without_mounting(p, packed).reshape(2, -1)
        return turn_between(dense.matrix_at(mounting_of(p, packed), 0), before, now)[0]
