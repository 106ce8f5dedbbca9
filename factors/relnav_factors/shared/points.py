"""Known points of the target seen from a sensor on the chaser: what all cameras share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from relnav_factors.shared.mounting import PlacedSensor, mounting_of, without_mounting
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
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity

#: How the pose stands in the state: in the target's orbital frame, by R_oc, R_ot and
#: r_tc_o; or directly relative to the target, by R_tc and r_tc_t.
Pose = Literal["orbital", "target"]


def pose_blocks(pose: Pose) -> tuple[Block, ...]:
    """The blocks that hold the pose, in the order of the kernels."""
    if pose == "orbital":
        return CHASER_ATTITUDE, TARGET_ATTITUDE, RELATIVE_POSITION
    return RELATIVE_ATTITUDE, RELATIVE_POSITION_T


@jit
def point_seen(mounting: Array, columns: int, point_t: Array, x: Array) -> tuple[Array, Array]:
    """Position in sensor axes of a point given in target axes, and its Jacobian.

    mounting: (12,): R_cs row by row, r_sc_c (m), the sensor's place in the chaser; columns: 6 where
    it is estimated, else 0; point_t: X_t (3,), m; x: (21,): R_oc, R_ot row by row, r_tc_o (m), or
    (12,): R_tc, r_tc_t (m). Returns p_s (3,), m, and its Jacobian (3, 9 + columns) or (3, 6 +
    columns) to the pose, then to R_cs and r_sc_c, m/rad and m/m.

        p_s = R_cs^T (R_oc^T (R_ot X_t - r_tc_o) - r_sc_c)
    """
    orbital = x.shape[0] == 21
    n = 9 if orbital else 6
    R_cs, R_oc = dense.matrix_at(mounting, 0), dense.matrix_at(x, 0)
    r_at = 18 if orbital else 9
    X_o = dense.matvec(dense.matrix_at(x, 9), point_t) if orbital else point_t
    line_c = np.zeros(3)  # from the chaser's origin to the point
    for i in range(3):
        for j in range(3):
            line_c[i] += R_oc[j, i] * (X_o[j] - x[r_at + j])
    point_s = np.zeros(3)
    jacobian = np.empty((3, n + columns))
    for i in range(3):
        axis_c, axis_o, axis_t = np.empty(3), np.zeros(3), np.zeros(3)  # of the sensor
        for j in range(3):
            axis_c[j] = R_cs[j, i]
            point_s[i] += axis_c[j] * (line_c[j] - mounting[9 + j])
            for k in range(3):
                axis_o[j] += R_oc[j, k] * R_cs[k, i]
        # A row a^T [v x] is the vector product a x v.
        so3.put_cross(jacobian, i, 0, axis_c, line_c, 1.0)
        if orbital:
            for j in range(3):
                for k in range(3):
                    axis_t[j] += x[9 + 3 * k + j] * axis_o[k]
            so3.put_cross(jacobian, i, 3, axis_t, point_t, -1.0)
        for j in range(3):
            jacobian[i, n - 3 + j] = -axis_o[j]
    if columns > 0:
        dense.put_block(jacobian, 0, n, so3.skew(point_s), 1.0)
        for i in range(3):
            for j in range(3):
                jacobian[i, n + 3 + j] = -R_cs[j, i]
    return point_s, jacobian


@jit
def point_in_sensor(p: Array, point_t: Array, x: Array) -> tuple[Array, Array]:
    """`point_seen` from the mounting that p and x hold, see `mounting_of`.

    p: starts with the (13,) of a mounting; point_t: (3,), m; x: (21,) or (12,), as there, then R_ns
    and d_sn_c (m), (12,), where the mounting is estimated. Result: m, m/rad, m/m.
    """
    return point_seen(mounting_of(p, x), int(p[12]), point_t, without_mounting(p, x))


@dataclass(frozen=True, kw_only=True)
class PointSensor(PlacedSensor):
    """What the sensors of known points share.

    points: X_t (n, 3), m, target axes; an observation's id is its row. sensor_attitude:
    R_cs; sensor_position: r_sc_c, m. pose: how the pose stands in the state.
    Raises InputError when R_cs is not a rotation within 1e-6.
    """

    points: Annotated[Array, Quantity("m", (None, 3))]
    pose: Pose = "orbital"

    @property
    def reads(self) -> tuple[Block, ...]:
        return *pose_blocks(self.pose), *self.mounting_blocks

    def observables(self) -> Indices:
        return np.arange(len(self.points))

    def observation_data(self, ids: Indices) -> Array:
        bad = (ids < 0) | (ids >= len(self.points))
        if bad.any():
            last = len(self.points) - 1
            raise InputError(f"{self.kind}: found id {ids[bad][0]}, expected 0 to {last}")
        return np.ascontiguousarray(self.points[ids])

    def directions(self, *x: Array) -> dict[str, tuple[Array, ...]]:
        """What is weak, or not seen at all, where all points are near each other: the
        range, turns of the target, and turns of everything together in frame o."""
        count = len(pose_blocks(self.pose))
        R, r = x[count - 2], x[count - 1]
        along = r[:, None] / max(float(np.linalg.norm(r)), 1e-30)
        across = np.linalg.svd(along.T)[2][1:].T
        turned = {"about the line of sight": along, "across the line of sight": across}
        none = np.zeros((3, 1))
        found: dict[str, tuple[Array, ...]] = {}
        if self.pose == "target":
            found["range, along the line of sight"] = (none, along)
            for where, axes in turned.items():
                found[f"rotation of the chaser {where}"] = (R.T @ axes, 0 * axes)
            return self._padded(found)
        found["range, along the line of sight"] = (none, none, along)
        for where, axes in turned.items():
            found[f"rotation of the target {where}"] = (0 * axes, R.T @ axes, 0 * axes)
        joint = "joint rotation of both attitudes and the position, axis in o"
        found[joint] = (x[0].T, x[1].T, -so3.skew(r))
        return self._padded(found)

    def _padded(self, found: dict[str, tuple[Array, ...]]) -> dict[str, tuple[Array, ...]]:
        """Directions of the pose, with a mounting that stays."""
        still = [0 * parts[0] for parts in found.values()]
        count = len(self.mounting_blocks)
        pairs = zip(found.items(), still, strict=True)
        return {name: (*parts, *[zero] * count) for (name, parts), zero in pairs}

    def points_in_sensor(self, ids: Indices, *x: Array) -> Array:
        """Positions (k, 3) of the points `ids` in sensor axes, m."""
        packed = np.concatenate([np.ravel(value) for value in x])
        p = self.constants()
        return np.array([point_in_sensor(p, q, packed)[0] for q in self.observation_data(ids)])

    def centre(self, ids: Indices, z: Array) -> Array:
        """About where the middle of the points `ids` is, in sensor axes (3,), m."""
        raise NotImplementedError

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """Rough poses that would put the middle of the seen points where it is seen, one for
        each of the 24 attitudes that take axes to axes.

        known: values of the other blocks; with poses in the orbital frame, that of the
        chaser's attitude, which no sensor of points can tell.
        """
        middle_t = self.points[ids].mean(axis=0)
        R_cs, r_sc_c = self.mounted(known)
        middle_c = R_cs @ self.centre(ids, z) + r_sc_c
        for R_tc in axis_rotations():
            if self.pose == "target":
                r_tc_t = middle_t - R_tc @ middle_c
                yield {RELATIVE_ATTITUDE.name: R_tc, RELATIVE_POSITION_T.name: r_tc_t}
            elif CHASER_ATTITUDE.name in known:
                R_oc = known[CHASER_ATTITUDE.name]
                R_ot = R_oc @ R_tc.T
                r_tc_o = R_ot @ middle_t - R_oc @ middle_c
                yield {TARGET_ATTITUDE.name: R_ot, RELATIVE_POSITION.name: r_tc_o}


def axis_rotations() -> list[Array]:
    """The 24 rotations (3, 3) that take axes to axes.

    Any rotation is within 63 deg of one of them.
    """
    found = []
    for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]):
        for signs in np.ndindex(2, 2, 2):
            R = np.zeros((3, 3))
            R[range(3), order] = 1.0 - 2.0 * np.array(signs)
            if np.linalg.det(R) > 0:
                found.append(R)
    return found
