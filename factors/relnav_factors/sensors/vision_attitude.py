"""The target's attitude as vision measures it: from three points, a silhouette, a net."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from relnav_factors.shared.attitude import AttitudeSensor, attitude_residual
from relnav_factors.shared.mounting import MOUNTING, mounting_of, without_mounting
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE, RELATIVE_ATTITUDE, TARGET_ATTITUDE
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3

#: Where p says that x is R_ot alone.
_FIXED = MOUNTING


@jit
def target_in_sensor(p: Array, x: Array) -> tuple[Array, Array]:
    """``R_st = R_cs^T R_tc^T`` (3, 3), and R_tc (3, 3).

    p: (14,): (13,) of the mounting, 1 where x is R_ot alone (R_os is then in place of R_cs, and o
    plays the part of c), else 0; x: (18,): R_oc, R_ot row by row, or (9,): R_tc or R_ot; then (9,):
    R_ns of an estimated mounting. Matrices of rotations, without unit.
    """
    first = dense.matrix_at(x, 0)
    if without_mounting(p, x).shape[0] == 18:
        R_tc = dense.transposed_matmul(dense.matrix_at(x, 9), first)
    elif p[_FIXED] != 0.0:
        R_tc = dense.transposed_matmul(first, dense.identity(3))
    else:
        R_tc = first
    R_ts = dense.matmul(R_tc, dense.matrix_at(mounting_of(p, x), 0))
    return dense.transposed_matmul(R_ts, dense.identity(3)), R_tc


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = Log(R_measured^T R_st)``, in target axes, see `target_in_sensor`.

    p (14,): (13,) of the mounting, 1 where x is R_ot alone, else 0. q (0,). z (4,): q_wxyz of R_st.
    x (18,): R_oc, R_ot row by row, or (9,): R_tc or R_ot; then (9,): R_ns of an estimated mounting.
    r (3,), rad. H (3, 6) or (3, 3), and 3 columns more for the mounting, rad/rad.
    """
    predicted, R_tc = target_in_sensor(p, x)
    jacobian, size = attitude_residual(z, predicted, r), without_mounting(p, x).shape[0]
    if size == 9 and p[_FIXED] != 0.0:
        dense.put_block(H, 0, 0, jacobian, 1.0)
    else:  # a turn d of c is -R_tc d of t
        dense.put_block(H, 0, 0, dense.matmul(jacobian, R_tc), -1.0)
    if size == 18:
        dense.put_block(H, 0, 3, jacobian, 1.0)
    if p[12] > 0.0:  # and one of s is -R_st^T d
        R_ts = dense.transposed_matmul(predicted, dense.identity(3))
        dense.put_block(H, 0, size // 3, dense.matmul(jacobian, R_ts), -1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class VisionAttitude(AttitudeSensor):
    """Attitude of the target in sensor axes, z = R_st = R_cs^T R_tc^T as q_wxyz.

    As Hu et al. 2019, eqs. 1-3, build it from three seen points (x along P1P2, z along
    P1P2 x P1P3): t are the axes so built, which need not be principal ones.

    seen_from: how the attitude stands in the state. "orbital": by R_oc and R_ot; "target":
    by R_tc; "fixed": by R_ot alone, from a sensor whose axes do not turn in o
    (sensor_attitude is then R_os), as if a star tracker had taken the chaser's turn out.
    """

    kind: ClassVar[str] = "vision_attitude"
    kernel = staticmethod(kernel)

    seen_from: Literal["orbital", "target", "fixed"] = "orbital"

    @property
    def reads(self) -> tuple[Block, ...]:
        if self.seen_from == "orbital":
            return CHASER_ATTITUDE, TARGET_ATTITUDE, *self.mounting_blocks
        one = RELATIVE_ATTITUDE if self.seen_from == "target" else TARGET_ATTITUDE
        return one, *self.mounting_blocks

    def constants(self) -> Array:
        return np.array([*super().constants(), self.seen_from == "fixed"], dtype=np.float64)

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """The one attitude that the first measurement gives.

        z: (k, 4), q_wxyz; known: values of the other blocks: with poses in the orbital frame, R_oc
        (3, 3) is needed.
        """
        R_ct = self.mounted(known)[0] @ so3.from_quaternion(z[0])
        if self.seen_from == "target":
            yield {RELATIVE_ATTITUDE.name: R_ct.T}
        elif self.seen_from == "fixed":
            yield {TARGET_ATTITUDE.name: R_ct}
        elif CHASER_ATTITUDE.name in known:
            yield {TARGET_ATTITUDE.name: known[CHASER_ATTITUDE.name] @ R_ct}

    def attitude(self, *x: Array) -> Array:
        """R_st (3, 3), which takes target axes to sensor axes."""
        packed = np.concatenate([np.ravel(value) for value in x])
        return target_in_sensor(self.constants(), packed)[0]
