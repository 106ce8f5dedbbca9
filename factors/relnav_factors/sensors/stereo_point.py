"""Known points of the target in a stereo camera, as pixels or as Cartesian positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.points import PointSensor, point_in_sensor
from relnav_factors.shared.statuses import degenerate, length_status
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import GeometryError
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


@jit
def project_stereo(p: Array, point_s: Array) -> tuple[Array, Array]:
    """Pixels (ul, vl, ur, vr) of a point, and their Jacobian.

    p: (18,): ends with fu, fv, cu, cv (px), baseline b (m); point_s: (3,): X right, Y down, Z ahead
    in the left camera, m. Returns (4,), pixels, and (4, 3), pixels per m.

        ul = fu X / Z + cu,  ur = fu (X - b) / Z + cu,  vl = vr = fv Y / Z + cv
    """
    fu, fv, cu, cv, baseline = p[13], p[14], p[15], p[16], p[17]
    x, y, depth = point_s[0], point_s[1], point_s[2]
    pixels = np.empty(4)
    pixels[0] = fu * x / depth + cu
    pixels[1] = fv * y / depth + cv
    pixels[2] = fu * (x - baseline) / depth + cu
    pixels[3] = pixels[1]
    jacobian = np.zeros((4, 3))
    jacobian[0, 0] = jacobian[2, 0] = fu / depth
    jacobian[1, 1] = jacobian[3, 1] = fv / depth
    jacobian[0, 2] = -fu * x / depth**2
    jacobian[2, 2] = -fu * (x - baseline) / depth**2
    jacobian[1, 2] = jacobian[3, 2] = -fv * y / depth**2
    return pixels, jacobian


@jit
def pixel_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Predicted minus measured pixels, see `project_stereo` and `point_in_sensor`.

    p (18,): (13,) of the mounting, fu, fv, cu, cv (px), baseline (m). q (3,): the point X_t, m. z
    (4,): ul, vl, ur, vr, pixels. x (21,): R_oc, R_ot row by row, r_tc_o (m), or (12,): R_tc, r_tc_t
    (m); then (12,): R_ns, d_sn_c (m) of an estimated mounting. r (4,), pixels. H (4, 9) or (4, 6),
    and 6 columns more for the mounting. Status 1: behind the camera; or that of `length_status`
    for the distance.
    """
    point_s, jacobian = point_in_sensor(p, q, x)
    distance = dense.norm(point_s)
    status = length_status(distance, 0)
    if status != 0:
        return status
    if point_s[2] <= 1e-12 * distance:  # beside it: a pixel is infinitely far off
        return 1
    pixels, dpixels = project_stereo(p, point_s)
    dense.put_vector(r, 0, dense.add_scaled_vector(pixels, z, -1.0))
    dense.put_block(H, 0, 0, dense.matmul(dpixels, jacobian), 1.0)
    return 0


@jit
def cartesian_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Predicted minus measured position in sensor axes, see `point_in_sensor`.

    p (13,): of the mounting. q (3,): the point X_t, m. z (3,): position in s, m. x (21,): R_oc,
    R_ot row by row, r_tc_o (m), or (12,): R_tc, r_tc_t (m); then (12,): R_ns, d_sn_c (m) of an
    estimated mounting. r (3,), m. H (3, 9) or (3, 6), and 6 columns more for the mounting.
    """
    point_s, jacobian = point_in_sensor(p, q, x)
    dense.put_vector(r, 0, dense.add_scaled_vector(point_s, z, -1.0))
    dense.put_block(H, 0, 0, jacobian, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class StereoPoint(PointSensor):
    """Pixels of known points in a rectified stereo camera; z = (ul, vl, ur, vr).

    fu, fv: focal lengths, px; cu, cv: principal point, px; baseline: m, left to right
    camera; pixel_sigma: px, of each of the four. After Barfoot 2017, eq. 7.93 (left
    camera as origin).
    """

    kind: ClassVar[str] = "stereo_point"
    columns: ClassVar[tuple[str, ...]] = ("ul_px", "vl_px", "ur_px", "vr_px")
    rows: ClassVar[int] = 4
    kernel = staticmethod(pixel_kernel)
    failures = {
        1: "the point is behind the camera",
        **degenerate("the distance from the camera to the point"),
    }

    fu: Annotated[float, Quantity("px", positive=True)]
    fv: Annotated[float, Quantity("px", positive=True)]
    cu: Annotated[float, Quantity("px")]
    cv: Annotated[float, Quantity("px")]
    baseline: Annotated[float, Quantity("m", positive=True)]
    pixel_sigma: Annotated[Array, Quantity("px", (4,), positive=True)]

    def constants(self) -> Array:
        camera = [self.fu, self.fv, self.cu, self.cv, self.baseline]
        return np.concatenate([super().constants(), camera])

    def predict(self, ids: Indices, *x: Array) -> Array:
        """Pixels (k, 4). Raises GeometryError on a point behind the camera."""
        p, out = self.constants(), np.empty((len(ids), 4))
        for k, point_s in enumerate(self.points_in_sensor(ids, *x)):
            if point_s[2] <= 1e-12 * dense.norm(point_s):
                raise GeometryError(f"{self.kind}: id {ids[k]} at depth {point_s[2]:.3g} m")
            out[k] = project_stereo(p, point_s)[0]
        return out

    def centre(self, ids: Indices, z: Array) -> Array:
        """The mean of the points, each triangulated from its two pixels.

        ids: (k,); z: (k, 4), pixels. Returns (3,), m, in sensor axes.
        """
        depth = self.fu * self.baseline / np.maximum(z[:, 0] - z[:, 2], 1e-3)
        across = (z[:, 0] - self.cu) / self.fu, (z[:, 1] - self.cv) / self.fv
        return np.array([np.mean(depth * across[0]), np.mean(depth * across[1]), depth.mean()])

    def noise(self, m: Measurement) -> Array:
        return np.tile(np.diag(self.pixel_sigma**2), (len(m.z), 1, 1))


@dataclass(frozen=True, kw_only=True)
class StereoPointCartesian(PointSensor):
    """Positions of known points in sensor axes, as a stereo camera triangulates them.

    sigma: m, per axis. As in Xiong et al. 2013, the measurement Z of its section 3.
    """

    kind: ClassVar[str] = "stereo_point_cartesian"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    rows: ClassVar[int] = 3
    kernel = staticmethod(cartesian_kernel)

    sigma: Annotated[Array, Quantity("m", (3,), positive=True)]

    def predict(self, ids: Indices, *x: Array) -> Array:
        """Positions (k, 3) in sensor axes, m."""
        return self.points_in_sensor(ids, *x)

    def centre(self, ids: Indices, z: Array) -> Array:
        """The mean of the positions (k, 3), m.

        ids: (k,). Returns (3,), m, in sensor axes.
        """
        return np.asarray(z.mean(axis=0))

    def noise(self, m: Measurement) -> Array:
        return np.tile(np.diag(self.sigma**2), (len(m.z), 1, 1))
