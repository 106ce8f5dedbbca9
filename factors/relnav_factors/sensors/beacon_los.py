"""Unit vectors from a sensor on the chaser to beacons on the target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.point_sensor import PointSensor
from relnav_factors.shared.points import point_in_sensor
from relnav_factors.shared.sphere import OPPOSITE, direction, sphere_residual, turned
from relnav_factors.shared.statuses import degenerate, length_status
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.units import Quantity


@jit(from_python=True)
def line_of_sight(p: Array, q: Array, x: Array) -> tuple[Array, Array, float]:
    """Unit vector b (3,) to a beacon in sensor axes, its Jacobian to x, and the distance.

    p: (13,), of the mounting; q: (3,), m, the beacon in t, or (0,) of an unknown one; x: (21,):
    R_oc, R_ot, r_tc_o (m), or (12,): R_tc, r_tc_t (m); then (12,) of an estimated mounting and (3,)
    of an unknown beacon, see `point_in_sensor`. The Jacobian is (3, 9) or (3, 6), with 6 columns
    more for the mounting and 3 for the beacon, per rad and per m; the distance is in m.
    """
    point_s, jacobian = point_in_sensor(p, q, x)
    b, distance = direction(point_s, jacobian)
    return b, jacobian, distance


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Rotation from the measured to the predicted line of sight, across the measured one.

    p (13,): of the mounting. q (3,): the beacon X_t, m; (0,) of an unknown one. z (3,): unit vector
    in s. x (21,): R_oc, R_ot row by row, r_tc_o (m), or (12,): R_tc, r_tc_t (m); then (12,): R_ns,
    d_sn_c (m) of an estimated mounting; then X_t of an unknown beacon. r (2,), rad, see
    `sphere_residual`. H (2, 9) or (2, 6), and 6 columns more for the mounting, 3 for the beacon.
    Status `OPPOSITE`: b is opposite to z; or that of `length_status` for the distance to the
    beacon.

        b = R_cs^T (R_oc^T (R_ot X_t - r_tc_o) - r_sc_c), normalised
    """
    b, db, distance = line_of_sight(p, q, x)
    status = length_status(distance, 0)
    if status != 0:
        return status
    return sphere_residual(z, b, db, 0, r, H)


@dataclass(frozen=True, kw_only=True)
class BeaconLineOfSight(PointSensor):
    """Lines of sight to beacons (VISNAV).

    b = R_cs^T (R_oc^T (R_ot X - r_tc_o) - r_sc_c), normalised; z is the measured b.
    After Kim et al. 2007 (Journal of Guidance 30-5), eq. 6, and Zhang et al. 2015.

    points: the beacons, or "unknown"; sigma: rad, about each of the two axes across the line.
    """

    kind: ClassVar[str] = "beacon_los"
    columns: ClassVar[tuple[str, ...]] = ("los_x", "los_y", "los_z")
    rows: ClassVar[int] = 2
    residual_columns: ClassVar[tuple[str, ...]] = ("first_rad", "second_rad")
    kernel = staticmethod(kernel)
    failures = {
        OPPOSITE: "the beacon is seen opposite to where it should be",
        **degenerate("the distance from the sensor to the beacon"),
    }

    sigma: Annotated[float, Quantity("rad", positive=True)]

    def accept(self, z: Array) -> Array:
        """Unit vectors (k, 3) in sensor axes, made exact.

        Raises InputError when the length of one is not 1 within 1e-3.
        """
        lengths = np.linalg.norm(super().accept(z), axis=1, keepdims=True)
        if (np.abs(lengths - 1) > 1e-3).any():
            worst = z[np.abs(lengths - 1).argmax()]
            raise InputError(f"{self.kind}: found {worst}, expected a unit vector")
        return z / lengths  # type: ignore[no-any-return]

    def predict(self, ids: Indices, *x: Array) -> Array:
        """Unit vectors (k, 3) in sensor axes. Raises GeometryError on a beacon at the sensor."""
        p, out = self.constants(), np.empty((len(ids), 3))
        for k, (q, packed) in enumerate(self.packed(ids, *x)):
            out[k], _, distance = line_of_sight(p, q, packed)
            if status := length_status(distance, 0):
                raise GeometryError(f"{self.kind}: id {ids[k]}: {self.failure(status)}")
        return out

    def perturb(self, z: Array, e: Array) -> Array:
        """Turn each line by the rotation e (k, 2), rad, across it."""
        return turned(np.ascontiguousarray(z), np.ascontiguousarray(e))

    def lines(self, z: Array) -> Array:
        """The measured unit vectors (k, 3) in sensor axes."""
        return z

    def noise(self, m: Measurement) -> Array:
        return np.tile(self.sigma**2 * np.eye(2), (len(m.z), 1, 1))
