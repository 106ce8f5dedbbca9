"""The relative pose at an earlier epoch, kept in the state for odometry to read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.models import DynamicsModel
from relnav_graph.state import Block
from relnav_graph.units import Quantity

from ._points import Pose, pose_blocks
from .relative_pose import position_in_target, relative_attitude

Array = NDArray[np.float64]
PREVIOUS_ATTITUDE = Block("previous_attitude", "R_tc-", "SO3", 3, "rad", "tc", "deg")
PREVIOUS_POSITION = Block("previous_position", "r_tc_t-", "vector", 3, "m", "t", "m")


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """x = (R_tc, r_tc_t) of before, and the pose at the start of the interval, as (R_oc,
    R_ot, r_tc_o) or (R_tc, r_tc_t). p: period or 0, two sigmas."""
    so3.put(F, 0, 0, np.zeros(F.shape), 1.0)
    so3.put(Q, 0, 0, np.zeros((6, 6)), 1.0)
    for i in range(6):
        Q[i, i] = p[1] ** 2 if i < 3 else p[2] ** 2
    cycles = t / p[0] if p[0] > 0.0 else 0.0
    if abs(cycles - np.round(cycles)) > 1e-6:  # between two copies: keep
        for i in range(12):
            x_next[i] = x[i]
        so3.put(F, 0, 0, so3.identity(6), 1.0)
    elif x.shape[0] == 24:
        for i in range(12):
            x_next[i] = x[12 + i]
        so3.put(F, 0, 6, so3.identity(6), 1.0)
    else:
        R_ot = so3.matrix_at(x, 21)
        R_tc, to_attitudes = relative_attitude(so3.matrix_at(x, 12), R_ot)
        r_tc_t, to_place = position_in_target(R_ot, so3.vector_at(x, 30))
        so3.put_matrix(x_next, 0, so3.project(R_tc))
        so3.put_vector(x_next, 9, r_tc_t)
        so3.put(F, 0, 6, to_attitudes, 1.0)
        so3.put(F, 3, 9, to_place, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class PreviousPose(DynamicsModel):
    """R_tc- = R_tc and r_tc_t- = r_tc_t of the epoch before: stochastic cloning.

    After Roumeliotis and Burdick 2002. A sensor that compares two epochs reads these blocks
    beside the present pose; so filter and smoothers have it with one variable per epoch. A
    copy has no noise; a little of it keeps Q regular. Both are far below what any camera
    sees; nothing is lost to rounding either, down to 1e-10. (On the astrobee_tumble pass, batch
    estimates with 1e-5 and with 1e-10 are within 4e-5 sigma of those with 1e-6.)

    pose: how the pose stands in the state; period: s, copy at its multiples only and hold in
    between, for odometry that is slower than the epochs; None: at every epoch.
    attitude_sigma: rad, and position_sigma: m, noise of a copy per axis.
    """

    kind: ClassVar[str] = "previous_pose"
    noises: ClassVar[tuple[str, ...]] = ("attitude_sigma", "position_sigma")
    kernel = staticmethod(kernel)

    pose: Pose = "orbital"
    period: Annotated[float, Quantity("s", positive=True)] | None = None
    attitude_sigma: Annotated[float, Quantity("rad", positive=True)] = 1e-6
    position_sigma: Annotated[float, Quantity("m", positive=True)] = 1e-6

    @property
    def advances(self) -> tuple[Block, ...]:
        return PREVIOUS_ATTITUDE, PREVIOUS_POSITION

    @property
    def reads(self) -> tuple[Block, ...]:
        return pose_blocks(self.pose)

    def constants(self) -> Array:
        return np.array([self.period or 0.0, self.attitude_sigma, self.position_sigma])
