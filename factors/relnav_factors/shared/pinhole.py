"""Pinhole cameras: where the light of a point falls, with one camera or with two."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from relnav_factors.shared.point_sensor import PointSensor
from relnav_factors.shared.statuses import degenerate, length_status
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import GeometryError
from relnav_graph.maths import dense
from relnav_graph.units import Quantity

#: Status of a point that is behind the camera, or beside it: a pixel is infinitely far off then.
BEHIND = 1
#: Depth, as a share of the distance, from which on a point is ahead.
_AHEAD = 1e-12


@jit
def ahead_status(point_s: Array) -> int:
    """0 of a point (3,) in s, m, that is ahead; `BEHIND`, or as `length_status` of the distance."""
    distance = dense.norm(point_s)
    status = length_status(distance, 0)
    if status == 0 and point_s[2] <= _AHEAD * distance:
        return BEHIND
    return status


@jit
def put_pixels(
    p: Array, x: float, y: float, depth: float, row: int, pixels: Array, jacobian: Array
) -> None:
    """Put the pixels (u, v) of a point, and their Jacobian to its place, into two rows.

    p: starts with (13,) of the mounting, then fu, fv, cu, cv (px); x right, y down, depth ahead in
    the camera, m. Fills ``pixels[row : row + 2]`` and these rows of the Jacobian (m, 3), px/m.

        u = fu X / Z + cu,  v = fv Y / Z + cv
    """
    fu, fv, cu, cv = p[13], p[14], p[15], p[16]
    pixels[row] = fu * x / depth + cu
    pixels[row + 1] = fv * y / depth + cv
    jacobian[row, 0], jacobian[row, 1] = fu / depth, 0.0
    jacobian[row, 2] = -fu * x / depth**2
    jacobian[row + 1, 0], jacobian[row + 1, 1] = 0.0, fv / depth
    jacobian[row + 1, 2] = -fv * y / depth**2


@dataclass(frozen=True, kw_only=True)
class PinholeSensor(PointSensor):
    """What pinhole cameras share; z begins with the pixels (u, v) of the camera at the origin of s.

    fu, fv: focal lengths, px; cu, cv: principal point, px; x of s is right, y down, z ahead.
    """

    failures = {
        BEHIND: "the point is behind the camera",
        **degenerate("the distance from the camera to the point"),
    }
    #: px, one for each column of z.
    pixel_sigma: Array

    fu: Annotated[float, Quantity("px", positive=True)]
    fv: Annotated[float, Quantity("px", positive=True)]
    cu: Annotated[float, Quantity("px")]
    cv: Annotated[float, Quantity("px")]

    def constants(self) -> Array:
        """(17,): of the mounting, then fu, fv, cu, cv, px."""
        return np.concatenate([super().constants(), [self.fu, self.fv, self.cu, self.cv]])

    def ahead(self, z: Array) -> Array:
        """(k, 3) in s: where pixels z (k, nz) see at depth one."""
        across = (z[:, 0] - self.cu) / self.fu, (z[:, 1] - self.cv) / self.fv
        return np.column_stack([*across, np.ones(len(z))])

    def pixels(self, point_s: Array) -> Array:
        """(nz,), pixels, of a point (3,) in s, m, that is ahead."""
        raise NotImplementedError

    def predict(self, ids: Indices, *x: Array) -> Array:
        """Pixels (k, nz). Raises GeometryError on a point behind the camera."""
        out = np.empty((len(ids), len(self.columns)))
        for k, point_s in enumerate(self.points_in_sensor(ids, *x)):
            if point_s[2] <= _AHEAD * dense.norm(point_s):
                raise GeometryError(f"{self.kind}: id {ids[k]} at depth {point_s[2]:.3g} m")
            out[k] = self.pixels(point_s)
        return out

    def noise(self, m: Measurement) -> Array:
        return np.tile(np.diag(self.pixel_sigma**2), (len(m.z), 1, 1))
