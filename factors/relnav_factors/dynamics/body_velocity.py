"""Relative position from a velocity that is measured in the chaser's axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.points import Pose
from relnav_factors.shared.strapdown import GYRO_COLUMNS
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
)
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``r' = R v_c``: position from a velocity in chaser axes, exact for rows of constant v and w.

    p (3,): density of the velocity's noise, per axis of c, m/sqrt(s). u (rows, 7): dt (s), v_c
    (m/s), w_ci_c of the gyro (rad/s), which hold over dt. x (12,): r_tc_o (m), R_oc row by row; or
    r_tc_t, R_tc. x_next (3,): r, m. F (3, 6) to (r, R). Q (3, 3), m^2.

        r_next = r + R s_c,  s_c = sum of C J_l(w dt) v_c dt

    C: the turn since the start of the interval; J_l: the left Jacobian of SO(3), because the path
    within a row is curved.
    """
    R, turned = dense.matrix_at(x, 3), dense.identity(3)
    path_c, noise = np.zeros(3), np.zeros((3, 3))
    velocity, turn, spread = np.empty(3), np.empty(3), np.zeros((3, 3))
    for row in range(u.shape[0]):
        dt = u[row, 0]
        for i in range(3):
            velocity[i], turn[i] = u[row, 1 + i], u[row, 4 + i] * dt
            spread[i, i] = p[i] ** 2 * dt
        # The left Jacobian of a turn is the transpose of the right one.
        mean_c = dense.transposed_matvec(so3.right_jacobian(turn), velocity)
        path_c = dense.add_scaled_vector(path_c, dense.matvec(turned, mean_c), dt)
        noise = dense.add_scaled(noise, dense.propagate_covariance(turned, spread), 1.0)
        turned = dense.matmul(turned, so3.exp(turn))
    dense.put_vector(
        x_next, 0, dense.add_scaled_vector(dense.vector_at(x, 0), dense.matvec(R, path_c), 1.0)
    )
    dense.put_block(F, 0, 0, dense.identity(3), 1.0)
    dense.put_block(F, 0, 3, dense.matmul(R, so3.skew(path_c)), -1.0)
    dense.put_block(Q, 0, 0, dense.propagate_covariance(R, noise), 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class BodyVelocity(DynamicsModel):
    """Relative position, r' = R v_c, for passes without an orbit.

    The inputs are the velocity of the chaser relative to the target's rest frame, in
    chaser axes, and the gyro, which bends the path within a sample (the gyro's bias
    would move it by b v dt^2 / 2 only, and is left out). Barfoot 2017, section 7.2.

    velocity_density: m/sqrt(s), white noise of the velocity, one for all axes of c or one
    each; pose: whether position and
    attitude are r_tc_o and R_oc or r_tc_t and R_tc.
    """

    kind: ClassVar[str] = "body_velocity"
    #: o does not turn.
    orbit: ClassVar[None] = None
    inputs: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "velocity": ("vx_m_s", "vy_m_s", "vz_m_s"),
        "gyro": GYRO_COLUMNS,
    }
    noises: ClassVar[tuple[str, ...]] = ("velocity_density",)
    kernel = staticmethod(kernel)

    velocity_density: Annotated[Array, Quantity("m/sqrt(s)", (3,), positive=True, fill=True)]
    pose: Pose = "orbital"

    @property
    def advances(self) -> tuple[Block, ...]:
        return (RELATIVE_POSITION if self.pose == "orbital" else RELATIVE_POSITION_T,)

    @property
    def reads(self) -> tuple[Block, ...]:
        return (CHASER_ATTITUDE if self.pose == "orbital" else RELATIVE_ATTITUDE,)

    def constants(self) -> Array:
        return self.velocity_density
