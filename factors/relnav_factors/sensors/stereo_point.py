"""Points of the target in a stereo camera, as pixels or as Cartesian positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.pinhole import PinholeSensor, ahead_status, put_pixels
from relnav_factors.shared.point_sensor import PointSensor
from relnav_factors.shared.points import point_in_sensor
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.measurement import Measurement
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


@jit
def project_stereo(p: Array, point_s: Array) -> tuple[Array, Array]:
    """Pixels (ul, vl, ur, vr) of a point, and their Jacobian.

    p: (18,): ends with fu, fv, cu, cv (px), baseline b (m); point_s: (3,): X right, Y down, Z ahead
    in the left camera, m. Returns (4,), pixels, and (4, 3), pixels per m; see `put_pixels`.
    """
    x, y, depth = point_s[0], point_s[1], point_s[2]
    pixels, jacobian = np.empty(4), np.empty((4, 3))
    put_pixels(p, x, y, depth, 0, pixels, jacobian)
    put_pixels(p, x - p[17], y, depth, 2, pixels, jacobian)
    return pixels, jacobian


@jit
def pixel_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Predicted minus measured pixels, see `project_stereo` and `point_in_sensor`.

    p (18,): (13,) of the mounting, fu, fv, cu, cv (px), baseline (m). q (3,): the point X_t, m;
    (0,) of an unknown one. z (4,): ul, vl, ur, vr, pixels. x (21,): R_oc, R_ot row by row, r_tc_o
    (m), or (12,): R_tc, r_tc_t (m); then (12,): R_ns, d_sn_c (m) of an estimated mounting; then X_t
    of an unknown point. r (4,), pixels. H (4, 9) or (4, 6), and 6 columns more for the mounting, 3
    for the point. Status 1: behind the camera; or that of `length_status` for the distance.
    """
    point_s, jacobian = point_in_sensor(p, q, x)
    status = ahead_status(point_s)
    if status != 0:
        return status
    pixels, dpixels = project_stereo(p, point_s)
    dense.put_vector(r, 0, dense.add_scaled_vector(pixels, z, -1.0))
    dense.put_block(H, 0, 0, dense.matmul(dpixels, jacobian), 1.0)
    return 0


@jit
def cartesian_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Predicted minus measured position in sensor axes, see `point_in_sensor`.

    p (13,): of the mounting. q (3,): the point X_t, m; (0,) of an unknown one. z (3,): position in
    s, m. x (21,): R_oc, R_ot row by row, r_tc_o (m), or (12,): R_tc, r_tc_t (m); then (12,): R_ns,
    d_sn_c (m) of an estimated mounting; then X_t of an unknown point. r (3,), m. H (3, 9) or (3,
    6), and 6 columns more for the mounting, 3 for the point.
    """
    point_s, jacobian = point_in_sensor(p, q, x)
    dense.put_vector(r, 0, dense.add_scaled_vector(point_s, z, -1.0))
    dense.put_block(H, 0, 0, jacobian, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class StereoPoint(PinholeSensor):
    """Pixels of points in a rectified stereo camera; z = (ul, vl, ur, vr).

        ul = fu X / Z + cu,  ur = fu (X - b) / Z + cu,  vl = vr = fv Y / Z + cv

    baseline: b, m, left to right camera; pixel_sigma: px, of each of the four; the others as of
    `PinholeSensor`. After Barfoot 2017, eq. 7.93 (left camera as origin).
    """

    kind: ClassVar[str] = "stereo_point"
    columns: ClassVar[tuple[str, ...]] = ("ul_px", "vl_px", "ur_px", "vr_px")
    rows: ClassVar[int] = 4
    sees_depth: ClassVar[bool] = True
    kernel = staticmethod(pixel_kernel)

    baseline: Annotated[float, Quantity("m", positive=True)]
    pixel_sigma: Annotated[Array, Quantity("px", (4,), positive=True)]

    def constants(self) -> Array:
        return np.append(super().constants(), self.baseline)

    def pixels(self, point_s: Array) -> Array:
        """(4,), pixels, of a point (3,) in s, m."""
        return np.asarray(project_stereo(self.constants(), point_s)[0])

    def triangulated(self, z: Array, disparity: Array) -> Array:
        """Places (k, 3) in s, m, of points whose pixels z (k, 4) are so far apart (k,), px."""
        depth = (self.fu * self.baseline / disparity)[:, None]
        return self.ahead(z) * depth

    def lines(self, z: Array) -> Array:
        """Places (k, 3) in s, m; NaN where the two pixels are no further apart than by noise."""
        disparity = z[:, 0] - z[:, 2]
        told = disparity > np.hypot(self.pixel_sigma[0], self.pixel_sigma[2])
        return self.triangulated(z, np.where(told, disparity, np.nan))

    def centre(self, ids: Indices, z: Array) -> Array:
        """The mean of the points, each triangulated from its two pixels.

        ids: (k,); z: (k, 4), pixels. Returns (3,), m, in sensor axes.
        """
        places = self.triangulated(z, np.maximum(z[:, 0] - z[:, 2], 1e-3))
        return np.array([np.mean(component) for component in places.T])


@dataclass(frozen=True, kw_only=True)
class StereoPointCartesian(PointSensor):
    """Positions of points in sensor axes, as a stereo camera or a lidar gives them.

    sigma: m, per axis. As in Xiong et al. 2013, the measurement Z of its section 3.
    """

    kind: ClassVar[str] = "stereo_point_cartesian"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    rows: ClassVar[int] = 3
    sees_depth: ClassVar[bool] = True
    kernel = staticmethod(cartesian_kernel)

    sigma: Annotated[Array, Quantity("m", (3,), positive=True)]

    def predict(self, ids: Indices, *x: Array) -> Array:
        """Positions (k, 3) in sensor axes, m."""
        return self.points_in_sensor(ids, *x)

    def lines(self, z: Array) -> Array:
        """The measured positions (k, 3) in sensor axes, m."""
        return z

    def centre(self, ids: Indices, z: Array) -> Array:
        """The mean of the positions (k, 3), m.

        ids: (k,). Returns (3,), m, in sensor axes.
        """
        return np.asarray(z.mean(axis=0))

    def noise(self, m: Measurement) -> Array:
        return np.tile(np.diag(self.sigma**2), (len(m.z), 1, 1))
