"""How the chaser has moved, as seen from the target, since an earlier epoch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.sensors.attitude_odometry import turn_between
from relnav_factors.sensors.pose_copy import PoseCopy, copier_of, earlier_blocks
from relnav_factors.shared.attitude import attitude_residual, turned
from relnav_factors.shared.mounting import mounting_of, without_mounting
from relnav_factors.shared.points import point_seen, pose_blocks
from relnav_factors.shared.pose_sensor import PoseSensor
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity


@jit
def pose_between(p: Array, x: Array) -> tuple[Array, Array, Array, Array]:
    """The turn R_s-s, and where the scene's centre lies in the sensor axes of before, s-.

    p: (16,): (13,) of the mounting, the scene's centre in present sensor axes (m); x: (42,): R_oc,
    R_ot row by row, r_tc_o (m) of before, then of now, or (24,): R_tc, r_tc_t of both; then (12,):
    R_ns, d_sn_c (m) of an estimated mounting. Returns R_s-s (3, 3), the place (3,), m, and their
    Jacobians (3, 18) or (3, 12) to both poses, with 6 columns more for the mounting.

        place = p_t- + R_s-s (centre - p_t),  p_t: the target's origin in sensor axes
    """
    mounting, both, columns = mounting_of(p, x), without_mounting(p, x), int(p[12])
    nowhere, half = np.zeros(3), both.shape[0] // 2
    before, to_before = point_seen(mounting, columns, nowhere, 0, both[:half])
    now, to_now = point_seen(mounting, columns, nowhere, 0, both[half:])
    n = to_now.shape[1] - columns
    turn, slopes = turn_between(
        dense.matrix_at(mounting, 0), both[: half - 3], both[half : 2 * half - 3]
    )
    to_turn = np.zeros((3, 2 * n + columns))
    for i in range(3):
        for j in range(n - 3):
            to_turn[i, j], to_turn[i, n + j] = slopes[i, j], slopes[i, n - 3 + j]
        for j in range(min(columns, 3)):
            to_turn[i, 2 * n + j] = slopes[i, 2 * (n - 3) + j]
    # From the target to the centre.
    line = dense.add_scaled_vector(dense.vector_at(p, 13), now, -1.0)
    place = dense.add_scaled_vector(before, dense.matvec(turn, line), 1.0)
    to_place = dense.matmul(dense.matmul(turn, so3.skew(line)), to_turn)
    turned_now = dense.matmul(turn, to_now)
    for i in range(3):
        for j in range(n):
            to_place[i, j] = to_before[i, j] - to_place[i, j]
            to_place[i, n + j] = -turned_now[i, j] - to_place[i, n + j]
        for j in range(columns):
            moved = to_before[i, n + j] - turned_now[i, n + j]
            to_place[i, 2 * n + j] = moved - to_place[i, 2 * n + j]
    return turn, place, to_turn, to_place


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Where the scene's centre was, predicted minus measured; then ``Log(R_measured^T R_s-s)``.

    p (16,): (13,) of the mounting, the scene's centre in present sensor axes (m). q (0,). z (7,): r
    (m) and q_wxyz of `PoseOdometry`. x (42,): R_oc, R_ot row by row, r_tc_o (m) of before, then of
    now, or (24,): R_tc, r_tc_t (m) of both; then (12,): R_ns, d_sn_c (m) of an estimated mounting.
    r (6,): m in sensor axes of before, then rad in present ones. H (6, 18) or (6, 12), and 6
    columns more for the mounting.
    """
    turn, place, to_turn, to_place = pose_between(p, x)
    R_measured, angles = so3.from_quaternion(z[3:]), np.empty(3)
    slope = attitude_residual(z[3:], turn, angles)
    measured = dense.add_scaled_vector(dense.matvec(R_measured, dense.vector_at(p, 13)), z[:3], 1.0)
    dense.put_vector(r, 0, dense.add_scaled_vector(place, measured, -1.0))
    dense.put_vector(r, 3, angles)
    dense.put_block(H, 0, 0, to_place, 1.0)
    dense.put_block(H, 3, 0, dense.matmul(slope, to_turn), 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class PoseOdometry(PoseSensor):
    """Motion of the sensor relative to the target between two epochs: T_s-s.

    z = (r, q_wxyz): r = R_cs^T R_tc-^T (p - p-) with p = r_tc_t + R_tc r_sc_c, the present
    place of the sensor in its axes of before, and R_s-s = R_cs^T R_tc-^T R_tc R_cs. As the
    point-cloud odometry of Setterfield et al. 2018, and its loop closures. The earlier pose comes
    from `PreviousPose`, or from a `PoseCopy`.

    A cloud of points is aligned about its own centre, so errors of the turn move the sensor
    as if it swung about the scene. scene_centre: that centre in sensor axes, m; zero makes
    the errors of r and of the turn independent. position_sigma: m, of where the centre was,
    attitude_sigma: rad, of the turn, about the present sensor axes; one for all or one each.
    sensor_attitude: R_cs; sensor_position: r_sc_c, m. pose: how the poses stand in the
    state; keyframe: s, the earlier epoch of a loop closure, None: that of `PreviousPose`.
    largest_turn: rad, of a simulated front end, which recognises nothing after a larger one.
    Raises InputError when R_cs is not a rotation within 1e-6.
    """

    kind: ClassVar[str] = "pose_odometry"
    kernel = staticmethod(kernel)

    scene_centre: Annotated[Array, Quantity("m", (3,))] = field(default_factory=lambda: np.zeros(3))
    keyframe: Annotated[float, Quantity("s")] | None = None
    largest_turn: Annotated[float, Quantity("rad", positive=True)] = np.pi

    def copier(self) -> PoseCopy:
        """The sensor that copies the pose at the keyframe. Raises InputError without one."""
        return copier_of(self.kind, self.pose, self.keyframe, "pose")

    @property
    def reads(self) -> tuple[Block, ...]:
        both = *earlier_blocks(self.pose, self.keyframe), *pose_blocks(self.pose)
        return *both, *self.mounting_blocks

    def constants(self) -> Array:
        return np.concatenate([super().constants(), self.scene_centre])

    def in_view(self, ids: Indices, *x: Array) -> Indices:
        """All, unless the sensor has turned too far since the earlier epoch."""
        packed = np.concatenate([np.ravel(value) for value in x])
        turn = so3.log(pose_between(self.constants(), packed)[0])
        return ids if dense.norm(turn) <= self.largest_turn else ids[:0]

    def predict(self, ids: Indices, *x: Array) -> Array:
        """r (m) and q_wxyz, (k, 7), w >= 0."""
        packed = np.concatenate([np.ravel(value) for value in x])
        turn, place, _, _ = pose_between(self.constants(), packed)
        one = np.concatenate([place - turn @ self.scene_centre, so3.quaternion(turn)])
        return np.tile(one, (len(ids), 1))

    def perturb(self, z: Array, e: Array) -> Array:
        """Move the scene's centre by e[:, :3], m, and turn about it by e[:, 3:], rad."""
        q_wxyz = turned(z[:, 3:], e[:, 3:])
        out = np.hstack([z[:, :3] + e[:, :3], q_wxyz])
        for row, before, after in zip(out, np.ascontiguousarray(z[:, 3:]), q_wxyz, strict=True):
            swing = so3.from_quaternion(before) - so3.from_quaternion(after)
            row[:3] += swing @ self.scene_centre
        return out
