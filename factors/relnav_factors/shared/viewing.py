"""What a camera can see: limits of its field of view and range, and points that hide themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from relnav_factors.shared.mounting import PlacedSensor
from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity


@dataclass(frozen=True, kw_only=True)
class LimitedView(PlacedSensor):
    """Limits of what a simulated camera sees; estimators take all that was seen.

    field_of_view: full angles, rad, about the axis z of s: one, of a cone, or two, across x and y,
    of a frame. range: nearest and farthest distance, m. normals (n, 3): of each known point, the
    side from which it is seen, outward, of any length; incidence: rad, how far from its normal, at
    most, so that normal . (camera - point) >= |normal| |camera - point| cos(incidence).

    Raises InputError on limits that leave nothing to see, and on a normal of length zero.
    """

    field_of_view: Annotated[Array, Quantity("rad", (None,), positive=True, fill=True)] | None = (
        None
    )
    range: Annotated[Array, Quantity("m", (2,), nonnegative=True)] | None = None
    normals: Annotated[Array, Quantity("1", (None, 3))] | None = None
    incidence: Annotated[float, Quantity("rad", positive=True)] = np.pi / 2

    def __post_init__(self) -> None:
        super().__post_init__()
        field, limits = self.field_of_view, self.range
        if field is not None and (len(field) not in (1, 2) or field.max() > 2 * np.pi):
            found = f"found {np.degrees(field).tolist()} deg"
            expected = "one or two full angles of at most 360 deg"
            raise InputError(f"{self.kind}.field_of_view: {found}, expected {expected}")
        if limits is not None and not limits[0] < limits[1]:
            raise InputError(
                f"{self.kind}.range: found {limits.tolist()} m, expected the nearer end first"
            )
        if self.incidence > np.pi / 2:
            found = f"found {np.degrees(self.incidence):.6g} deg"
            raise InputError(f"{self.kind}.incidence: {found}, expected at most 90 deg")
        if self.normals is not None and not np.linalg.norm(self.normals, axis=1).all():
            row = int(np.argmin(np.linalg.norm(self.normals, axis=1)))
            raise InputError(f"{self.kind}.normals[{row}]: found length zero, expected a direction")

    def within(self, points_s: Array) -> NDArray[np.bool_]:
        """Which of points, (k, 3) in s, m, are in the field of view and in range: a mask (k,)."""
        x, y, z = points_s.T
        inside = np.ones(len(points_s), dtype=np.bool_)
        if self.field_of_view is not None:
            across = [np.hypot(x, y)] if len(self.field_of_view) == 1 else [np.abs(x), np.abs(y)]
            for off, angle in zip(across, self.field_of_view, strict=True):
                inside &= np.arctan2(off, z) <= angle / 2
        if self.range is not None:
            distance = np.linalg.norm(points_s, axis=1)
            inside &= (distance >= self.range[0]) & (distance <= self.range[1])
        return inside

    def facing(self, normals: Array, lines: Array) -> NDArray[np.bool_]:
        """Which points, of normals (k, 3), are seen along lines (k, 3) from them to the camera, in
        the same axes: a mask (k,)."""
        size = np.linalg.norm(normals, axis=1) * np.linalg.norm(lines, axis=1)
        along = (normals * lines).sum(axis=1)
        mask: NDArray[np.bool_] = (along > 0) & (along >= size * np.cos(self.incidence))
        return mask
