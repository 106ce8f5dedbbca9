"""Points of the target in a single camera, as pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.pinhole import PinholeSensor, ahead_status, put_pixels
from relnav_factors.shared.points import point_in_sensor
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


@jit
def project(p: Array, point_s: Array) -> tuple[Array, Array]:
    """Pixels (u, v) of a point, and their Jacobian.

    p: (17,): ends with fu, fv, cu, cv (px); point_s: (3,): X right, Y down, Z ahead, m. Returns
    (2,), pixels, and (2, 3), pixels per m; see `put_pixels`.
    """
    pixels, jacobian = np.empty(2), np.empty((2, 3))
    put_pixels(p, point_s[0], point_s[1], point_s[2], 0, pixels, jacobian)
    return pixels, jacobian


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Predicted minus measured pixels, see `project` and `point_in_sensor`.

    p (17,): (13,) of the mounting, fu, fv, cu, cv (px). q (3,): the point X_t, m; (0,) of an
    unknown one. z (2,): u, v, pixels. x (21,): R_oc, R_ot row by row, r_tc_o (m), or (12,): R_tc,
    r_tc_t (m); then (12,): R_ns, d_sn_c (m) of an estimated mounting; then X_t of an unknown point.
    r (2,), pixels. H (2, 9) or (2, 6), and 6 columns more for the mounting, 3 for the point. Status
    as of `ahead_status`.
    """
    point_s, jacobian = point_in_sensor(p, q, x)
    status = ahead_status(point_s)
    if status != 0:
        return status
    pixels, dpixels = project(p, point_s)
    dense.put_vector(r, 0, dense.add_scaled_vector(pixels, z, -1.0))
    dense.put_block(H, 0, 0, dense.matmul(dpixels, jacobian), 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class MonoPoint(PinholeSensor):
    """Pixels of points in one pinhole camera; z = (u, v).

        u = fu X / Z + cu,  v = fv Y / Z + cv

    pixel_sigma: px, of each of the two; the others as of `PinholeSensor`. One camera does not see
    how large anything is: the scale of a map of unknown points, and of the distance, comes from a
    lever arm on a chaser that turns, or from a known manoeuvre. After Hartley and Zisserman 2004,
    section 6.1.
    """

    kind: ClassVar[str] = "mono_point"
    columns: ClassVar[tuple[str, ...]] = ("u_px", "v_px")
    rows: ClassVar[int] = 2
    kernel = staticmethod(kernel)

    pixel_sigma: Annotated[Array, Quantity("px", (2,), positive=True)]

    def pixels(self, point_s: Array) -> Array:
        """(2,), pixels, of a point (3,) in s, m."""
        return np.asarray(project(self.constants(), point_s)[0])

    def lines(self, z: Array) -> Array:
        """Unit vectors (k, 3) in sensor axes along pixels z (k, 2)."""
        ahead = self.ahead(z)
        return np.asarray(ahead / np.linalg.norm(ahead, axis=1, keepdims=True))
