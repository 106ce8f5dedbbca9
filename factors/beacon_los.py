"""Unit vectors from a sensor on the chaser to beacons at known places on the target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.errors import InputError
from relnav_graph.models import Measurement
from relnav_graph.units import Quantity

from ._points import PointSensor, point_in_sensor

Array = NDArray[np.float64]


@jit
def line_of_sight(mounting: Array, beacon_t: Array, x: Array) -> tuple[Array, Array]:
    """Unit vector (3,) to a beacon in sensor axes, and its Jacobian to the pose."""
    p, jacobian = point_in_sensor(mounting, beacon_t, x)
    distance = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    b = np.empty(3)
    for i in range(3):
        b[i] = p[i] / distance
    for j in range(jacobian.shape[1]):
        along = b[0] * jacobian[0, j] + b[1] * jacobian[1, j] + b[2] * jacobian[2, j]
        for i in range(3):
            jacobian[i, j] = (jacobian[i, j] - along * b[i]) / distance
    return b, jacobian


@jit
def tangent_basis(b: Array) -> Array:
    """Two unit vectors across the unit vector b, as the columns of a (3, 2) matrix."""
    smallest = 0
    for i in range(1, 3):
        if abs(b[i]) < abs(b[smallest]):
            smallest = i
    axis = np.zeros(3)
    axis[smallest] = 1.0
    first = so3.cross(b, axis)
    norm = np.sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    second = so3.cross(b, first)
    out = np.empty((3, 2))
    for i in range(3):
        out[i, 0], out[i, 1] = first[i] / norm, second[i] / norm
    return out


@jit
def turned(lines: Array, e: Array) -> Array:
    """Unit vectors (k, 3), each turned by the rotation e (k, 2), rad, across it."""
    out = np.empty(lines.shape)
    for k in range(lines.shape[0]):
        basis = tangent_basis(lines[k])
        angle = np.sqrt(e[k, 0] ** 2 + e[k, 1] ** 2)
        stretch = np.sin(angle) / angle if angle > 0.0 else 1.0
        for i in range(3):
            step = basis[i, 0] * e[k, 0] + basis[i, 1] * e[k, 1]
            out[k, i] = np.cos(angle) * lines[k, i] + stretch * step
    return out


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """r (2,): the rotation, in rad, from measured to predicted line of sight, resolved
    across the measured one (the logarithm of the sphere; its noise has rank 2)."""
    b, db = line_of_sight(p, q, x)
    basis = tangent_basis(z)
    across = so3.unrotate(basis, b)
    c = z[0] * b[0] + z[1] * b[1] + z[2] * b[2]
    s = np.sqrt(across[0] ** 2 + across[1] ** 2)
    angle = np.arctan2(s, c)
    if angle > 3.14:
        return 1
    if angle < 0.05:  # series of angle / sin and of its derivative by cos, to 1e-10
        a2 = angle * angle
        stretch = 1 + a2 / 6 * (1 + 7 * a2 / 60)
        slope = -1 / 3.0 - 2 * a2 / 15 - 2 * a2 * a2 / 63
    else:
        stretch = angle / s
        slope = -(s - angle * c) / s**3
    for i in range(2):
        r[i] = stretch * across[i]
        for j in range(x.shape[0] // 9 * 3 + 3):
            cos_j = z[0] * db[0, j] + z[1] * db[1, j] + z[2] * db[2, j]
            value = slope * across[i] * cos_j
            for k in range(3):
                value += stretch * basis[k, i] * db[k, j]
            H[i, j] = value
    return 0


@dataclass(frozen=True, kw_only=True)
class BeaconLineOfSight(PointSensor):
    """Lines of sight to beacons (VISNAV).

    b = R_cs^T (R_oc^T (R_ot X - r_tc_o) - r_sc_c), normalised; z is the measured b.
    After Kim et al. 2007 (Journal of Guidance 30-5), eq. 6, and Zhang et al. 2015.

    points: the beacons; sigma: rad, about each of the two axes across the line.
    """

    kind: ClassVar[str] = "beacon_los"
    columns: ClassVar[tuple[str, ...]] = ("los_x", "los_y", "los_z")
    rows: ClassVar[int] = 2
    kernel = staticmethod(kernel)
    failures = {1: "the beacon is seen opposite to where it should be"}

    sigma: Annotated[float, Quantity("rad", positive=True)]

    def accept(self, z: Array) -> Array:
        """Unit vectors (k, 3). Raises InputError when one is not, within 1e-3."""
        lengths = np.linalg.norm(super().accept(z), axis=1, keepdims=True)
        if (np.abs(lengths - 1) > 1e-3).any():
            worst = z[np.abs(lengths - 1).argmax()]
            raise InputError(f"{self.kind}: found {worst}, expected a unit vector")
        return z / lengths  # type: ignore[no-any-return]

    def predict(self, ids: NDArray[np.int64], *x: Array) -> Array:
        """Unit vectors (k, 3) in sensor axes."""
        p, packed = self.constants(), np.concatenate([np.ravel(value) for value in x])
        return np.array([line_of_sight(p, q, packed)[0] for q in self.observation_data(ids)])

    def perturb(self, z: Array, e: Array) -> Array:
        """Turn each line by the rotation e (k, 2), rad, across it."""
        return turned(np.ascontiguousarray(z), np.ascontiguousarray(e))

    def centre(self, ids: NDArray[np.int64], z: Array) -> Array:
        """As far away as makes the points' spread look as large as it does."""
        middle = z.mean(axis=0)
        spread = np.sqrt(((z - middle) ** 2).sum(axis=1).mean())
        size = np.sqrt(((self.points[ids] - self.points[ids].mean(axis=0)) ** 2).sum(axis=1).mean())
        distance = 10 * float(np.abs(self.points).max())  # of one beacon: no more than a guess
        if spread > 0:
            distance = np.sqrt(2 / 3) * size / spread  # seen from a side, on average
        return np.asarray(distance * middle / np.linalg.norm(middle))

    def noise(self, m: Measurement) -> Array:
        return np.tile(self.sigma**2 * np.eye(2), (len(m.z), 1, 1))
