"""What all sensors share that see points of the target, at known places or at unknown ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from relnav_factors.shared.attitude import axis_rotations
from relnav_factors.shared.points import Pose, point_in_sensor, pose_blocks, pose_in_target
from relnav_factors.shared.viewing import LimitedView
from relnav_graph.arrays import Array, Indices
from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    POINT,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    TARGET_ATTITUDE,
)
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.units import Quantity


@dataclass(frozen=True, kw_only=True)
class PointSensor(LimitedView):
    """What the sensors of points share.

    points: X_t (n, 3), m, target axes; an observation's id is its row. Or "unknown": each is a
    static block of the state, ``point[id]``, whatever its id, counted from the target's centre of
    mass. sensor_attitude: R_cs; sensor_position: r_sc_c, m. pose: how the pose stands in the state.

    Raises InputError when R_cs is not a rotation within 1e-6, and on normals that are not one for
    each known point.
    """

    #: Whether one sight tells where a point is, see `relnav_graph.core.contracts.ReadsNumbered`.
    sees_depth: ClassVar[bool] = False

    points: Annotated[Array | str, Quantity("m", (None, 3), words=("unknown",))]
    pose: Pose = "orbital"

    def __post_init__(self) -> None:
        super().__post_init__()
        count = 0 if isinstance(self.points, str) else len(self.points)
        if self.normals is not None and len(self.normals) != count:
            found = f"found {len(self.normals)} for {count} known points"
            raise InputError(f"{self.kind}.normals: {found}, expected one for each")

    @property
    def numbered(self) -> Block | None:
        """The block that each observation reads by its id, where the points are unknown."""
        return POINT if isinstance(self.points, str) else None

    @property
    def known_points(self) -> Array:
        """X_t (n, 3), m, of the points that are known."""
        return np.zeros((0, 3)) if isinstance(self.points, str) else self.points

    def mapped(self, points: Array, normals: Array | None) -> Self:
        """The same with points X_t (n, 3), m, that are known, and their normals (n, 3), if any."""
        return replace(self, points=points, normals=normals)

    @property
    def reads(self) -> tuple[Block, ...]:
        return *pose_blocks(self.pose), *self.mounting_blocks

    def observables(self) -> Indices:
        """Ids (n,) of the known points; none of unknown ones."""
        return np.arange(len(self.known_points))

    def observation_data(self, ids: Indices) -> Array:
        """X_t (k, 3), m, of known points, (k, 0) of unknown ones. Raises InputError on an id
        without a point."""
        count = len(self.known_points)
        bad = (ids < 0) | ((ids >= count) & (self.numbered is None))
        if bad.any():
            expected = f"0 to {count - 1}" if self.numbered is None else "zero or more"
            raise InputError(f"{self.kind}: found id {ids[bad][0]}, expected {expected}")
        if self.numbered is not None:
            return np.zeros((len(ids), 0))
        return np.ascontiguousarray(self.known_points[ids])

    def in_view(self, ids: Indices, *x: Array) -> Indices:
        """Those of the points that are in the field of view and in range, and do not face away."""
        if self.field_of_view is None and self.range is None and self.normals is None:
            return ids
        seen = self.within(self.points_in_sensor(ids, *x))
        if self.normals is not None:
            lines = self._origin(*x) - self.known_points[ids]
            seen &= self.facing(self.normals[ids], lines)
        return ids[seen]

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

    def packed(self, ids: Indices, *x: Array) -> Iterator[tuple[Array, Array]]:
        """q and x of the kernel for each of the points `ids`; x: a value per block of `reads`, and
        values (k, 3), m, where the points are unknown."""
        shared = np.concatenate([np.ravel(value) for value in x[: len(self.reads)]])
        for k, q in enumerate(self.observation_data(ids)):
            yield q, shared if self.numbered is None else np.concatenate([shared, x[-1][k]])

    def points_in_sensor(self, ids: Indices, *x: Array) -> Array:
        """Positions (k, 3) of the points `ids` in sensor axes, m; x: as of `packed`."""
        p, pairs = self.constants(), self.packed(ids, *x)
        return np.array([point_in_sensor(p, q, one)[0] for q, one in pairs]).reshape(-1, 3)

    def lines(self, z: Array) -> Array:
        """Where observations z (k, nz) see points in sensor axes (k, 3): their places, m, where the
        sensor sees depth, else unit vectors to them. NaN where one tells nothing."""
        raise NotImplementedError

    def _mounted_at(self, *x: Array) -> tuple[Array, Array]:
        """R_cs (3, 3) and r_sc_c (3,), m, at the values x of `reads`."""
        names = [b.name for b in self.reads]
        return self.mounted(dict(zip(names, x, strict=False)))

    def _origin(self, *x: Array) -> Array:
        """The place of the sensor in t (3,), m, at the values x of `reads`."""
        R_tc, r_tc_t = pose_in_target(self.pose, x)
        return np.asarray(r_tc_t + R_tc @ self._mounted_at(*x)[1])

    def sights(self, ids: Indices, z: Array, *x: Array) -> tuple[Array, Array]:
        """Where observations ids (k,), z (k, nz) see their points, from the values x of `reads`.

        The sensor's place in t for each (k, 3), m, and `lines` in t (k, 3); see
        `relnav_graph.core.contracts.ReadsNumbered`.
        """
        R_ts = pose_in_target(self.pose, x)[0] @ self._mounted_at(*x)[0]
        return np.tile(self._origin(*x), (len(ids), 1)), self.lines(z) @ R_ts.T

    def centre(self, ids: Indices, z: Array) -> Array:
        """About where the middle of known points `ids` is, in sensor axes (3,), m, as z (k, nz)
        sees them: along the mean line, as far away as their spread tells."""
        lines, points = self.lines(z), self.known_points
        middle = lines.mean(axis=0)
        spread = np.sqrt(((lines - middle) ** 2).sum(axis=1).mean())
        size = np.sqrt(((points[ids] - points[ids].mean(axis=0)) ** 2).sum(axis=1).mean())
        distance = 10 * float(np.abs(points).max())  # of one point: no more than a guess
        if spread > 0:
            distance = np.sqrt(2 / 3) * size / spread  # seen from a side, on average
        return np.asarray(distance * middle / max(float(np.linalg.norm(middle)), 1e-12))

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """Rough poses that would put the middle of the seen points where it is seen, one for
        each of the 24 attitudes that take axes to axes; none from points that are unknown.

        known: values of the other blocks; with poses in the orbital frame, that of the
        chaser's attitude, which no sensor of points can tell.
        """
        if self.numbered is not None:
            return
        middle_t = self.known_points[ids].mean(axis=0)
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
