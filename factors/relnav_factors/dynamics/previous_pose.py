"""The relative pose at an earlier epoch, kept in the state for odometry to read."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.points import Pose, pose_blocks
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


def previous_blocks(pose: Pose) -> tuple[Block, ...]:
    """The blocks that keep an earlier pose: one for each of `pose_blocks`."""
    return tuple(
        replace(b, name=f"previous_{b.name}", symbol=f"{b.symbol}-") for b in pose_blocks(pose)
    )


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """Replaces the copy by the pose where t is a multiple of the period; else keeps the copy.

    p (3,): period (s; 0: copy at every epoch), sigma of attitudes (rad), of the position (m). x
    (42,): R_oc-, R_ot-, r_tc_o- (m) of the copy, then R_oc, R_ot, r_tc_o at time t, the start of
    the interval; or (24,): R_tc-, r_tc_t-, R_tc, r_tc_t. x_next (21,) or (12,). F (9, 18) or
    (6, 12), Q (9, 9) or (6, 6), in rad and m.
    """
    n, size = Q.shape[0], x_next.shape[0]
    dense.put_block(F, 0, 0, np.zeros(F.shape), 1.0)
    dense.put_block(Q, 0, 0, np.zeros((n, n)), 1.0)
    cycles = t / p[0] if p[0] > 0.0 else 0.0
    held = abs(cycles - np.round(cycles)) > 1e-6  # between two copies
    for i in range(size):
        x_next[i] = x[i] if held else x[size + i]
    for i in range(n):
        F[i, i if held else n + i] = 1.0
        Q[i, i] = p[1] ** 2 if i < n - 3 else p[2] ** 2
    return 0


@dataclass(frozen=True, kw_only=True)
class PreviousPose(DynamicsModel):
    """x-_k+1 = x_k for the blocks x of the pose: stochastic cloning.

    After Roumeliotis and Burdick 2002. The copies stand in the very coordinates of what they
    copy: a correction turns both alike. (Kept as R_tc and r_tc_t where the state has R_oc,
    R_ot, r_tc_o, a common turn of 0.04 rad would move a clone 2 m away by 1.6 mm, a false
    displacement that an iterated update takes for one.) A sensor that compares two epochs
    reads these blocks beside the present pose, so that filter and smoothers have it with one
    variable per epoch. A copy has no noise; a little of it keeps Q regular, far below what a
    camera sees. (Between 1e-5 and 1e-10, batch estimates of the astrobee_tumble pass stay
    within 2e-4 sigma of those with 1e-6.)

    pose: how the pose stands in the state; period: s, copy at its multiples only and hold in
    between, for odometry that is slower than the epochs; None: at every epoch.
    attitude_sigma: rad, and position_sigma: m, noise of a copy per axis.
    """

    kind: ClassVar[str] = "previous_pose"
    kernel = staticmethod(kernel)

    pose: Pose = "orbital"
    period: Annotated[float, Quantity("s", positive=True)] | None = None
    attitude_sigma: Annotated[float, Quantity("rad", positive=True)] = 1e-6
    position_sigma: Annotated[float, Quantity("m", positive=True)] = 1e-6

    @property
    def noises(self) -> tuple[str, ...]:  # type: ignore[override]
        return *("attitude_sigma",) * (len(self.advances) - 1), "position_sigma"

    @property
    def advances(self) -> tuple[Block, ...]:
        return previous_blocks(self.pose)

    @property
    def reads(self) -> tuple[Block, ...]:
        return pose_blocks(self.pose)

    def constants(self) -> Array:
        return np.array([self.period or 0.0, self.attitude_sigma, self.position_sigma])
