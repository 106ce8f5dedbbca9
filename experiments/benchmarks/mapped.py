"""A pass in which the places of many points on the target are unknown: static blocks.

The tumbling target of zhang2015_close, whose chaser sees beacons at known places too, and ten of
`count` further points in each frame, in its own axes: z = R_oc^T (R_ot X_j - r_tc_o) + noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE, POINT, RELATIVE_POSITION, TARGET_ATTITUDE
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import SensorModel
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Block
from relnav_graph.core.track import Truth
from relnav_graph.maths import dense, so3

#: Sigmas of a sight, m, and of a point beforehand, m.
SIGHT, WIDE = 0.02, 2.0


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``R_oc^T (R_ot X - r_tc_o) - z``; x (24,): R_oc, R_ot row by row, r_tc_o, X. H (3, 12)."""
    R_oc, R_ot = dense.matrix_at(x, 0), dense.matrix_at(x, 9)
    X, line = dense.vector_at(x, 21), np.empty(3)
    place = dense.matvec(R_ot, X)
    for i in range(3):
        line[i] = place[i] - x[18 + i]
    seen, turn = dense.transposed_matvec(R_oc, line), dense.transposed_matmul(R_oc, R_ot)
    dense.put_vector(r, 0, dense.add_scaled_vector(seen, z, -1.0))
    dense.put_block(H, 0, 0, so3.skew(seen), 1.0)
    dense.put_block(H, 0, 3, dense.matmul(turn, so3.skew(X)), -1.0)
    for i in range(3):
        for j in range(3):
            H[i, 6 + j], H[i, 9 + j] = -R_oc[j, i], turn[i, j]
    return 0


@dataclass(frozen=True, kw_only=True)
class PointSight(SensorModel):
    """Points of the target, at unknown places, as their positions in chaser axes, m."""

    kind: ClassVar[str] = "point_sight"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    rows: ClassVar[int] = 3
    kernel = staticmethod(kernel)

    sees_depth: ClassVar[bool] = True

    @property
    def reads(self) -> tuple[Block, ...]:
        return CHASER_ATTITUDE, TARGET_ATTITUDE, RELATIVE_POSITION

    @property
    def numbered(self) -> Block | None:
        return POINT

    def sights(self, ids: Indices, z: Array, *x: Array) -> tuple[Array, Array]:
        """From the chaser to the points, in t, m."""
        R_oc, R_ot, r = x
        return np.tile(R_ot.T @ r, (len(ids), 1)), z @ R_oc.T @ R_ot

    def noise(self, m: Measurement) -> Array:
        return np.tile(SIGHT**2 * np.eye(3), (len(m.z), 1, 1))


def mapped(problem: Problem, truth: Truth, count: int, seen: int = 10, seed: int = 0) -> Problem:
    """A problem with `count` unknown points, `seen` of them in each epoch, in turn.

    truth: with the chaser's and the target's attitude and the position at the epochs.
    """
    rng = np.random.default_rng(seed)
    X = rng.normal(0.0, 1.0, (count, 3))
    names = CHASER_ATTITUDE.name, TARGET_ATTITUDE.name, RELATIVE_POSITION.name
    R_oc, R_ot, r = (truth.values[name] for name in names)
    epochs = list[Epoch]()
    for k, epoch in enumerate(problem.epochs):
        chosen: Indices = np.sort((k + np.arange(min(seen, count))) % count)
        z = (X[chosen] @ R_ot[k].T - r[k]) @ R_oc[k] + SIGHT * rng.normal(size=(len(chosen), 3))
        sights = Measurement("points", epoch.t, z, chosen)
        epochs.append(replace(epoch, measurements=(*epoch.measurements, sights)))
    sensors: dict[str, Any] = {**problem.sensors, "points": PointSight()}
    wide = {POINT.name: Prior(np.zeros(3), WIDE**2 * np.eye(3))}
    return Problem(problem.processes, sensors, problem.prior, tuple(epochs), numbered=wide)
