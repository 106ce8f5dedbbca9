"""The whole pose of the target as a camera sees it: in the camera's own axes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_factors.sensors.pose_measurement import PoseMeasurement, sensor_in_target
from relnav_factors.shared.attitude import attitude_residual
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.maths import dense, so3


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r_st_s = -R_ts^T r_ts_t``, predicted minus measured; then ``Log(R_measured^T R_st)``.

    p (13,): of the mounting. q (0,). z (7,): r_st_s (m), q_wxyz of R_st. x (21,): R_oc, R_ot row by
    row, r_tc_o (m), or (12,): R_tc, r_tc_t (m); then (12,): R_ns, d_sn_c (m) of an estimated
    mounting. r (6,): m in s, then rad in t. H (6, 9) or (6, 6), and 6 columns more for the
    mounting.
    """
    R_ts, r_ts_t, to_turn, to_place = sensor_in_target(p, x)
    R_st, angles = dense.transposed_matmul(R_ts, dense.identity(3)), np.empty(3)
    r_st_s = -dense.matvec(R_st, r_ts_t)
    slope = attitude_residual(z[3:], R_st, angles)
    dense.put_vector(r, 0, dense.add_scaled_vector(r_st_s, z[:3], -1.0))
    dense.put_vector(r, 3, angles)
    # When s turns by d, what it sees turns back, and when it moves, away; R_st turns by -R_ts d.
    turns = dense.matmul(so3.skew(r_st_s), to_turn)
    dense.put_block(H, 0, 0, dense.add_scaled(turns, dense.matmul(R_st, to_place), -1.0), 1.0)
    dense.put_block(H, 3, 0, dense.matmul(slope, dense.matmul(R_ts, to_turn)), -1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class TargetPose(PoseMeasurement):
    """Pose of the target relative to a body s on the chaser: z = (r_st_s, q_wxyz of R_st).

        R_st = (R_tc R_cs)^T,  r_st_s = -R_st (r_tc_t + R_tc r_sc_c)

    As a camera gives it that solves for the pose of a known target, with the noise that it has in
    its own axes. Whoever inverts such poses first moves the error of their attitude into the
    place: 1 deg at 10 m is 17 cm.

    position_sigma: m, per axis of s; attitude_sigma: rad, about each axis of t; one for all or one
    each. sensor_attitude: R_cs; sensor_position: r_sc_c, m. pose: how the pose stands in the state.
    Raises InputError when R_cs is not a rotation within 1e-6.
    """

    kind: ClassVar[str] = "target_pose"
    kernel = staticmethod(kernel)

    def predict(self, ids: Indices, *x: Array) -> Array:
        """r_st_s (m) and q_wxyz of R_st, (k, 7), w >= 0."""
        return _inverses(super().predict(ids, *x))

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """The one pose that the first measurement gives.

        z: (k, 7), m and q_wxyz; known: values of the other blocks: with poses in the orbital frame,
        R_oc (3, 3) is needed.
        """
        return super().starts(ids, _inverses(z), known)


def _inverses(z: Array) -> Array:
    """Poses (k, 7) of the other one in this one."""

    def inverse(one: Array) -> Array:
        R = so3.from_quaternion(one[3:])
        return np.concatenate([-R.T @ one[:3], so3.quaternion(np.ascontiguousarray(R.T))])

    return dense.stacked((inverse(one) for one in np.ascontiguousarray(z)), 7)
