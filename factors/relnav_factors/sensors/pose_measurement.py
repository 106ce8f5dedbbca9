"""The whole pose of the chaser relative to the target, measured: motion capture, a marker board."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_factors.shared.attitude import attitude_residual, turned
from relnav_factors.shared.mounting import mounting_of, without_mounting
from relnav_factors.shared.points import pose_blocks
from relnav_factors.shared.pose_sensor import PoseSensor
from relnav_graph.arrays import Array, Indices
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


@jit
def sensor_in_target(p: Array, x: Array) -> tuple[Array, Array, Array, Array]:
    """``R_ts = R_tc R_cs``, ``r_ts_t = r_tc_t + R_tc r_sc_c``, and their Jacobians.

    p: (13,), of the mounting; x: (21,): R_oc, R_ot row by row, r_tc_o (m), or (12,): R_tc, r_tc_t
    (m); then (12,): R_ns, d_sn_c (m) of an estimated mounting. Returns R_ts (3, 3), r_ts_t (3,), m,
    and their Jacobians (3, 9) or (3, 6), with 6 columns more for the mounting: of a right
    perturbation of R_ts, rad, and of r_ts_t, m.
    """
    mounting, orbital = mounting_of(p, x), without_mounting(p, x).shape[0] == 21
    R_cs, arm, R_tc = dense.matrix_at(mounting, 0), mounting[9:], dense.matrix_at(x, 0)
    r_tc_t, n, columns = dense.vector_at(x, 9), 6, int(p[12])
    if orbital:
        R_ot, n = dense.matrix_at(x, 9), 9
        R_tc = dense.transposed_matmul(R_ot, R_tc)
        r_tc_t = dense.transposed_matvec(R_ot, dense.vector_at(x, 18))
    R_ts = dense.matmul(R_tc, R_cs)
    r_ts_t = dense.add_scaled_vector(r_tc_t, dense.matvec(R_tc, arm), 1.0)
    one, to_turn, to_place = (
        dense.identity(3),
        np.zeros((3, n + columns)),
        np.zeros((3, n + columns)),
    )
    # A turn d of c is R_cs^T d of s.
    dense.put_block(to_turn, 0, 0, dense.transposed_matmul(R_cs, one), 1.0)
    dense.put_block(to_place, 0, 0, dense.matmul(R_tc, so3.skew(arm)), -1.0)
    dense.put_block(to_place, 0, n - 3, one, 1.0)
    if orbital:  # one of t is -R_ts^T d of s
        dense.put_block(to_turn, 0, 3, dense.transposed_matmul(R_ts, one), -1.0)
        dense.put_block(to_place, 0, 3, so3.skew(r_ts_t), 1.0)
        dense.put_block(to_place, 0, 6, dense.transposed_matmul(dense.matrix_at(x, 9), one), 1.0)
    if columns > 0:
        dense.put_block(to_turn, 0, n, one, 1.0)
        dense.put_block(to_place, 0, n + 3, R_tc, 1.0)
    return R_ts, r_ts_t, to_turn, to_place


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r_ts_t``, predicted minus measured; then ``Log(R_measured^T R_ts)``.

    p (13,): of the mounting. q (0,). z (7,): r_ts_t (m), q_wxyz of R_ts. x (21,): R_oc, R_ot row by
    row, r_tc_o (m), or (12,): R_tc, r_tc_t (m); then (12,): R_ns, d_sn_c (m) of an estimated
    mounting. r (6,): m in t, then rad in s. H (6, 9) or (6, 6), and 6 columns more for the
    mounting.
    """
    R_ts, r_ts_t, to_turn, to_place = sensor_in_target(p, x)
    angles = np.empty(3)
    slope = attitude_residual(z[3:], R_ts, angles)
    dense.put_vector(r, 0, dense.add_scaled_vector(r_ts_t, z[:3], -1.0))
    dense.put_vector(r, 3, angles)
    dense.put_block(H, 0, 0, to_place, 1.0)
    dense.put_block(H, 3, 0, dense.matmul(slope, to_turn), 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class PoseMeasurement(PoseSensor):
    """Pose of a body s on the chaser relative to the target: z = (r_ts_t, q_wxyz of R_ts).

        R_ts = R_tc R_cs,  r_ts_t = r_tc_t + R_tc r_sc_c

    As motion capture gives it, or a front end that solves for a whole pose; s is c itself unless a
    mounting says otherwise. With the recorded truth as such measurements, the mountings of the
    other sensors can be calibrated.

    position_sigma: m, per axis of t; attitude_sigma: rad, about each axis of s; one for all or one
    each. sensor_attitude: R_cs; sensor_position: r_sc_c, m. pose: how the pose stands in the state.
    Raises InputError when R_cs is not a rotation within 1e-6.
    """

    kind: ClassVar[str] = "pose_measurement"
    kernel = staticmethod(kernel)

    @property
    def reads(self) -> tuple[Block, ...]:
        return *pose_blocks(self.pose), *self.mounting_blocks

    def predict(self, ids: Indices, *x: Array) -> Array:
        """r_ts_t (m) and q_wxyz of R_ts, (k, 7), w >= 0."""
        packed = np.concatenate([np.ravel(value) for value in x])
        R_ts, r_ts_t, _, _ = sensor_in_target(self.constants(), packed)
        return np.tile(np.concatenate([r_ts_t, so3.quaternion(R_ts)]), (len(ids), 1))

    def perturb(self, z: Array, e: Array) -> Array:
        """Move the place by e[:, :3], m, and turn about it by e[:, 3:], rad, on the right."""
        return np.hstack([z[:, :3] + e[:, :3], turned(z[:, 3:], e[:, 3:])])

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """The one pose that the first measurement gives.

        z: (k, 7), m and q_wxyz; known: values of the other blocks: with poses in the orbital frame,
        R_oc (3, 3) is needed.
        """
        R_cs, r_sc_c = self.mounted(known)
        R_tc = so3.from_quaternion(np.ascontiguousarray(z[0, 3:])) @ R_cs.T
        r_tc_t = z[0, :3] - R_tc @ r_sc_c
        if self.pose == "target":
            yield {RELATIVE_ATTITUDE.name: R_tc, RELATIVE_POSITION_T.name: r_tc_t}
        elif CHASER_ATTITUDE.name in known:
            R_ot = known[CHASER_ATTITUDE.name] @ R_tc.T
            yield {TARGET_ATTITUDE.name: R_ot, RELATIVE_POSITION.name: R_ot @ r_tc_t}
