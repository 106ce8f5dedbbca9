"""A scanning laser on the chaser: range and direction of the target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from relnav_factors.shared.mounting import MountedSensor, mounting_of, without_mounting
from relnav_factors.shared.sphere import OPPOSITE, direction, sphere_residual, turned
from relnav_factors.shared.statuses import degenerate, length_status
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE, RELATIVE_POSITION
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Block
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity

#: Which axes carry the sensor: the chaser's, by its attitude in the state; or o itself, for
#: angles that have been turned there already.
Axes = Literal["chaser", "orbital"]


@jit
def target_in_sensor(p: Array, x: Array) -> tuple[Array, Array]:
    """``s = R_cs^T R_oc^T (-r_tc_o)``: the target in sensor axes, and its Jacobian.

    p: (13,), of the mounting, of R_os where x has no attitude; x: (12,): r_tc_o (m), R_oc row by
    row, or (3,): r_tc_o; then (9,): R_ns of an estimated mounting. Returns s (3,), m, and its
    Jacobian (3, 6) or (3, 3) to r_tc_o, then R_oc (per rad), with 3 columns more for the mounting.
    """
    R_cs, columns = dense.matrix_at(mounting_of(p, x), 0), int(p[12])
    r_ct_o = dense.vector_at(x, 0)
    for i in range(3):
        r_ct_o[i] = -r_ct_o[i]
    turns = without_mounting(p, x).shape[0] > 3
    R_os = dense.matmul(dense.matrix_at(x, 3), R_cs) if turns else R_cs
    n = 6 if turns else 3
    jacobian = np.zeros((3, n + columns))
    for i in range(3):
        for j in range(3):
            jacobian[i, j] = -R_os[j, i]
    if turns:  # R_oc Exp(d): the target turns by -d in c
        r_ct_c = dense.transposed_matvec(dense.matrix_at(x, 3), r_ct_o)
        dense.put_block(jacobian, 0, 3, dense.transposed_matmul(R_cs, so3.skew(r_ct_c)), 1.0)
    s = dense.transposed_matvec(R_os, r_ct_o)
    if columns > 0:
        dense.put_block(jacobian, 0, n, so3.skew(s), 1.0)
    return s, jacobian


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Range, predicted minus measured, then the rotation across the measured line of sight.

    p (13,): of the mounting. q (0,). z (4,): range (m), unit vector in s, see
    `LaserRangeAngles.accept`. x (12,): r_tc_o (m), R_oc row by row, or (3,): r_tc_o; then (9,):
    R_ns of an estimated mounting. r (3,): m, rad, rad. H (3, 6) or (3, 3), and 3 columns more for
    the mounting. Status `OPPOSITE`: b is opposite to the line; or that of `length_status` for the
    range.

        r = (|s| - range, rotation from the measured line to b = s / |s|)

    s: see `target_in_sensor`.
    """
    s, ds = target_in_sensor(p, x)
    to_line = dense.add_scaled(ds, ds, 0.0)
    b, distance = direction(s, to_line)
    status = length_status(distance, 0)
    if status != 0:
        return status
    r[0] = distance - z[0]
    for j in range(ds.shape[1]):
        H[0, j] = b[0] * ds[0, j] + b[1] * ds[1, j] + b[2] * ds[2, j]
    return sphere_residual(dense.vector_at(z, 1), b, to_line, 1, r, H)


def _lines(z: Array) -> Array:
    """Unit vectors (k, 3) of azimuth and elevation, the last two of z (k, 3)."""
    azimuth, elevation = z[:, 1], z[:, 2]
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)


def _angles(ranges: Array, lines: Array) -> Array:
    """z (k, 3) of ranges (k,) and unit vectors (k, 3)."""
    azimuth = np.arctan2(lines[:, 1], lines[:, 0])
    elevation = np.arctan2(lines[:, 2], np.hypot(lines[:, 0], lines[:, 1]))
    return np.stack([ranges, azimuth, elevation], axis=1)


@dataclass(frozen=True, kw_only=True)
class LaserRangeAngles(MountedSensor):
    """Range, azimuth and elevation of the target, s = R_cs^T R_oc^T (-r_tc_o).

    Range |s|, azimuth atan2(s_y, s_x), elevation asin(s_z / |s|), as in Yang et al. 2016.
    The residual of the angles is the rotation across the measured line of sight, so that
    no direction is singular, the poles of the elevation neither.

    range_sigma: m; range_scale: what the sigma grows by per metre of range; angle_sigma:
    rad, about each of the two axes across the line; axes: which carry the sensor, those of
    the chaser or of o; sensor_attitude: R_cs, or R_os. Raises InputError when it is not a
    rotation within 1e-6.
    """

    kind: ClassVar[str] = "laser_range_angles"
    columns: ClassVar[tuple[str, ...]] = ("range_m", "azimuth_rad", "elevation_rad")
    rows: ClassVar[int] = 3
    kernel = staticmethod(kernel)
    failures = {
        OPPOSITE: "the target is seen opposite to where it should be",
        **degenerate("the distance from the sensor to the target"),
    }

    range_sigma: Annotated[float, Quantity("m", positive=True)]
    angle_sigma: Annotated[float, Quantity("rad", positive=True)]
    range_scale: Annotated[float, Quantity("1", nonnegative=True)] = 0.0
    axes: Axes = "chaser"

    @property
    def reads(self) -> tuple[Block, ...]:
        if self.axes == "chaser":
            return RELATIVE_POSITION, CHASER_ATTITUDE, *self.mounting_blocks
        return RELATIVE_POSITION, *self.mounting_blocks

    def accept(self, z: Array) -> Array:
        """Range (m) and unit vector in s, (k, 4).

        z: range (m), azimuth, elevation (rad), (k, 3). Raises InputError on a range that is not
        positive and on angles too large to be in rad.
        """
        z = super().accept(z)
        bad = ~(z[:, 0] > 0)
        if bad.any():
            raise InputError(f"{self.kind}: found range {z[bad][0, 0]} m, expected one above 0")
        for column, name, limit in ((1, "azimuth", 2 * np.pi), (2, "elevation", np.pi / 2)):
            bad = np.abs(z[:, column]) > limit + 1e-9
            if bad.any():
                raise InputError(
                    f"{self.kind}: found {name} {z[bad][0, column]}, expected at most"
                    f" {limit:.4f} rad (deg given for rad?)"
                )
        return np.hstack([z[:, :1], _lines(z)])

    def predict(self, ids: Indices, *x: Array) -> Array:
        """Range, m, azimuth and elevation, rad, (k, 3). Raises GeometryError at range zero."""
        packed = np.concatenate([np.ravel(value) for value in x])
        s, _ = target_in_sensor(self.constants(), packed)
        distance = np.sqrt((s**2).sum())
        if status := length_status(distance, 0):
            raise GeometryError(f"{self.kind}: {self.failure(status)}")
        return np.tile(_angles(np.array([distance]), s[None] / distance), (len(ids), 1))

    def perturb(self, z: Array, e: Array) -> Array:
        """Add e (k, 3): to the range, m, and as a rotation across the line, rad."""
        lines = turned(_lines(z), np.ascontiguousarray(e[:, 1:]))
        return _angles(z[:, 0] + e[:, 0], lines)

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """The one position that a range and two angles give.

        z: (k, 4), see `accept`; known: values of the other blocks: with axes of the chaser, R_oc
        (3, 3) is needed.
        """
        r_tc_s, (R_cs, _) = -z[0, 0] * z[0, 1:], self.mounted(known)
        if self.axes == "orbital":
            yield {RELATIVE_POSITION.name: R_cs @ r_tc_s}
        elif CHASER_ATTITUDE.name in known:
            yield {RELATIVE_POSITION.name: known[CHASER_ATTITUDE.name] @ R_cs @ r_tc_s}

    def noise(self, m: Measurement) -> Array:
        """R (k, 3, 3): the range's sigma follows the measured range."""
        out = np.zeros((len(m.z), 3, 3))
        out[:, 0, 0] = (self.range_sigma + self.range_scale * np.abs(m.z[:, 0])) ** 2
        out[:, 1, 1] = out[:, 2, 2] = self.angle_sigma**2
        return out
