"""A copy of the relative pose at one epoch, which has one value for the whole pass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from relnav_factors.dynamics.previous_pose import previous_blocks
from relnav_factors.shared.points import Pose, pose_blocks
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import SensorModel
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity


def copy_blocks(pose: Pose, keyframe: float) -> tuple[Block, ...]:
    """The static blocks that copy the pose at a time, s: one for each of `pose_blocks`."""
    at = f"{keyframe:.15g}"
    return tuple(
        replace(b, name=f"{b.name}.{at}", symbol=f"{b.symbol}({at})") for b in pose_blocks(pose)
    )


def earlier_blocks(pose: Pose, keyframe: float | None) -> tuple[Block, ...]:
    """The blocks of the earlier pose that odometry reads: the copy of a keyframe, s, or, without
    one, those of `PreviousPose`."""
    return previous_blocks(pose) if keyframe is None else copy_blocks(pose, keyframe)


@jit
def _nearest(angle: Array, to: Array) -> Array:
    """Of the two rotation vectors of a rotation below one turn, rad, the one that is nearer to
    another; angle, to: (3,)."""
    size, other = dense.norm(angle), np.zeros(3)
    if size == 0.0:
        return angle
    for i in range(3):
        other[i] = angle[i] * (1 - 2 * np.pi / size)
    here = dense.norm(dense.add_scaled_vector(angle, to, -1.0))
    there = dense.norm(dense.add_scaled_vector(other, to, -1.0))
    return angle if here <= there else other


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``Log(R) - Log(R_copy) - z`` of attitudes, ``v - v_copy - z`` of a position.

    p (0,). q (0,). z (n,): zero. x (42,): R_oc, R_ot row by row, r_tc_o (m) of the copy, then of
    now, or (24,): R_tc, r_tc_t (m) of both, or the attitudes of either alone. r (n,), rad, then m.
    H (n, 2 n).

    Differences of logarithms, not logarithms of differences: they are linear in a copy that is the
    identity, where its prior is, so that a filter that does not iterate copies exactly, too.
    """
    half, n = x.shape[0] // 2, H.shape[0]
    turns = half // 9
    dense.put_block(H, 0, 0, np.zeros(H.shape), 1.0)
    for b in range(turns):
        of_copy = so3.log(dense.matrix_at(x, 9 * b))
        now = _nearest(so3.log(dense.matrix_at(x, half + 9 * b)), of_copy)
        for i in range(3):
            r[3 * b + i] = now[i] - of_copy[i] - z[3 * b + i]
        dense.put_block(H, 3 * b, 3 * b, so3.right_jacobian_inverse(of_copy), -1.0)
        dense.put_block(H, 3 * b, n + 3 * b, so3.right_jacobian_inverse(now), 1.0)
    for i in range(half - 9 * turns):
        r[3 * turns + i] = x[half + 9 * turns + i] - x[9 * turns + i] - z[3 * turns + i]
        H[3 * turns + i, 3 * turns + i] = -1.0
        H[3 * turns + i, n + 3 * turns + i] = 1.0
    return 0


@dataclass(frozen=True, kw_only=True)
class PoseCopy(SensorModel):
    """A copy of the pose at one epoch, 0 = Log(R) - Log(R_copy), 0 = r - r_copy: no measurement.

    With it, what compares that epoch with a later one, a loop closure, reads the static copy for
    the earlier pose, and the graph stays a chain with a border: stochastic cloning (Roumeliotis and
    Burdick 2002), once for the pass.

    keyframe: s, time of the epoch; pose: how the pose stands in the state; parts: all of it, or
    its attitudes alone. attitude_sigma: rad, and position_sigma: m, noise of a copy per axis, so
    little that estimates do not feel it.
    """

    kind: ClassVar[str] = "pose_copy"
    kernel = staticmethod(kernel)

    keyframe: Annotated[float, Quantity("s")]
    pose: Pose = "orbital"
    parts: Literal["pose", "attitudes"] = "pose"
    attitude_sigma: Annotated[float, Quantity("rad", positive=True)] = 1e-8
    position_sigma: Annotated[float, Quantity("m", positive=True)] = 1e-8

    @property
    def copies(self) -> Mapping[str, Block]:
        """By the name of the copy, what it copies."""
        count = len(pose_blocks(self.pose)) - (self.parts == "attitudes")
        of = zip(copy_blocks(self.pose, self.keyframe), pose_blocks(self.pose), strict=True)
        return {copy.name: block for copy, block in list(of)[:count]}

    @property
    def reads(self) -> tuple[Block, ...]:
        count = len(self.copies)
        return *copy_blocks(self.pose, self.keyframe)[:count], *self.copies.values()

    @property
    def rows(self) -> int:  # type: ignore[override]
        return sum(b.dim for b in self.copies.values())

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        of = self.copies.values()
        return tuple(f"{b.name}_{axis}_{b.unit}" for b in of for axis in "xyz")

    def noise(self, m: Measurement) -> Array:
        sigmas: dict[str, Any] = {"rad": self.attitude_sigma, "m": self.position_sigma}
        sigma = np.concatenate([np.full(b.dim, sigmas[b.unit]) for b in self.copies.values()])
        return np.tile(np.diag(sigma**2), (len(m.z), 1, 1))


def copier_of(
    kind: str, pose: Pose, keyframe: float | None, parts: Literal["pose", "attitudes"]
) -> PoseCopy:
    """The copy that odometry of some kind reads at a keyframe, s. Raises InputError at none."""
    if keyframe is None:
        raise InputError(f"{kind}: no keyframe, so that it reads no copy")
    return PoseCopy(keyframe=keyframe, pose=pose, parts=parts)
