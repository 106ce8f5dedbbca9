"""Known points of the target seen from a sensor on the chaser: what all cameras share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.errors import InputError
from relnav_graph.models import SensorModel
from relnav_graph.state import (
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    TARGET_ATTITUDE,
    Block,
)
from relnav_graph.units import Quantity

Array = NDArray[np.float64]
#: How the pose stands in the state: in the target's orbital frame, by R_oc, R_ot and
#: r_tc_o; or directly relative to the target, by R_tc and r_tc_t.
Pose = Literal["orbital", "target"]


def pose_blocks(pose: Pose) -> tuple[Block, ...]:
    """The blocks that hold the pose, in the order of the kernels."""
    if pose == "orbital":
        return CHASER_ATTITUDE, TARGET_ATTITUDE, RELATIVE_POSITION
    return RELATIVE_ATTITUDE, RELATIVE_POSITION_T


@jit
def point_in_sensor(mounting: Array, point_t: Array, x: Array) -> tuple[Array, Array]:
    """Position (3,) in sensor axes of a point given in target axes, and its Jacobian.

    mounting (12,): R_cs row by row, then r_sc_c, the sensor's place in the chaser.
    x: R_oc, R_ot, r_tc_o (21,) or R_tc, r_tc_t (12,); the Jacobian is (3, 9) or (3, 6).

        p_s = R_cs^T (R_oc^T (R_ot X_t - r_tc_o) - r_sc_c)
    """
    orbital = x.shape[0] == 21
    R_cs, R_oc = so3.matrix_at(mounting, 0), so3.matrix_at(x, 0)
    R_os = so3.multiply(R_oc, R_cs)
    r = so3.vector_at(x, 18 if orbital else 9)
    jacobian = np.empty((3, 9 if orbital else 6))
    if orbital:
        R_ot = so3.matrix_at(x, 9)
        line = so3.add_vector(so3.rotate(R_ot, point_t), r, -1.0)
        arm = so3.transpose_multiply(R_os, so3.multiply(R_ot, so3.skew(point_t)))
        so3.put(jacobian, 0, 3, arm, -1.0)
    else:
        line = so3.add_vector(point_t, r, -1.0)
    line_c = so3.unrotate(R_oc, line)
    so3.put(jacobian, 0, 0, so3.transpose_multiply(R_cs, so3.skew(line_c)), 1.0)
    for i in range(3):
        for j in range(3):
            jacobian[i, jacobian.shape[1] - 3 + j] = -R_os[j, i]
    line_c = so3.add_vector(line_c, so3.vector_at(mounting, 9), -1.0)
    return so3.unrotate(R_cs, line_c), jacobian


@dataclass(frozen=True, kw_only=True)
class PointSensor(SensorModel):
    """What the sensors of known points share.

    points: X_t (n, 3), m, target axes; an observation's id is its row. sensor_attitude:
    R_cs; sensor_position: r_sc_c, m. pose: how the pose stands in the state.
    Raises InputError when R_cs is not a rotation within 1e-6.
    """

    points: Annotated[Array, Quantity("m", (None, 3))]
    sensor_attitude: Annotated[Array, Quantity("1", (3, 3))] = field(
        default_factory=lambda: np.eye(3)
    )
    sensor_position: Annotated[Array, Quantity("m", (3,))] = field(
        default_factory=lambda: np.zeros(3)
    )
    pose: Pose = "orbital"

    def __post_init__(self) -> None:
        super().__post_init__()
        error = np.abs(self.sensor_attitude.T @ self.sensor_attitude - np.eye(3)).max()
        if error > 1e-6 or np.linalg.det(self.sensor_attitude) < 0:
            raise InputError(f"{self.kind}.sensor_attitude: not a rotation (off by {error:.1e})")

    @property
    def reads(self) -> tuple[Block, ...]:
        return pose_blocks(self.pose)

    def constants(self) -> Array:
        return np.concatenate([self.sensor_attitude.ravel(), self.sensor_position])

    def observables(self) -> NDArray[np.int64]:
        return np.arange(len(self.points))

    def observation_data(self, ids: NDArray[np.int64]) -> Array:
        bad = (ids < 0) | (ids >= len(self.points))
        if bad.any():
            last = len(self.points) - 1
            raise InputError(f"{self.kind}: found id {ids[bad][0]}, expected 0 to {last}")
        return np.ascontiguousarray(self.points[ids])

    def points_in_sensor(self, ids: NDArray[np.int64], *x: Array) -> Array:
        """Positions (k, 3) of the points `ids` in sensor axes, m."""
        packed = np.concatenate([np.ravel(value) for value in x])
        p = self.constants()
        return np.array([point_in_sensor(p, q, packed)[0] for q in self.observation_data(ids)])
