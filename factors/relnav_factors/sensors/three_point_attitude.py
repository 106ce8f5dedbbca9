"""The target's attitude from the frame that three of its points make, as seen by a sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.sensors.vision_attitude import VisionAttitude
from relnav_graph.arrays import Array, Indices
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.units import Quantity

#: Three points span a frame unless their triangle is flatter than this: a length across over one
#: along, which rounding must not decide.
_FLAT = 1e-6


def frame_of(points: Array) -> tuple[Array, Array]:
    """Axes (k, 3, 3), in columns, of k frames from three points (k, 3, 3), one a row; and their
    sides (k, 3): P1P2 along x, P1P3 along x and along y, in the unit of the points.

        x = P1P2 / |P1P2|,  z = P1P2 x P1P3 / |P1P2 x P1P3|,  y = z x x       (Hu 2019, eqs. 1-3)

    NaN where the points are on a line.
    """
    a, b = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    normal = np.cross(a, b)
    along, area = np.linalg.norm(a, axis=1), np.linalg.norm(normal, axis=1)
    flat = ~(area > _FLAT * along * np.maximum(along, np.linalg.norm(b, axis=1)))
    along[flat] = np.nan
    x, z = a / along[:, None], normal / np.where(flat, np.nan, area)[:, None]
    axes = np.stack([x, np.cross(z, x), z], axis=2)
    return axes, np.stack([along, np.einsum("ki,ki->k", b, x), area / along], axis=1)


def frame_slopes(points: Array) -> Array:
    """Turns of `frame_of` (k, 3, 9), rad in its own axes, per change of (P1, P2, P3), in s.

    With sides a, b_x, b_y and d2, d3 the changes of P2 and P3 against P1, in those axes:

        e_x = d3_z / b_y - b_x d2_z / (a b_y),   e_y = -d2_z / a,   e_z = d2_y / a
    """
    axes, sides = frame_of(points)
    a, along, across = sides.T
    second, third = np.zeros((2, len(points), 3, 3))
    second[:, 0, 2], third[:, 0, 2] = -along / (a * across), 1 / across
    second[:, 1, 2], second[:, 2, 1] = -1 / a, 1 / a
    turned = np.swapaxes(axes, 1, 2)
    second, third = second @ turned, third @ turned
    return np.concatenate([-second - third, second, third], axis=2)


@dataclass(frozen=True, kw_only=True)
class ThreePointAttitude(VisionAttitude):
    """Attitude of the target by the frame of three of its points, measured in sensor axes.

    t is that frame: x along P1P2, z along P1P2 x P1P3 (Hu et al. 2019, eqs. 1-3). Its residual is
    that of `VisionAttitude`; its covariance follows from that of the points and the triangle that
    they make, by `frame_slopes` at the measured points, to first order.

    sigma: m, of each point along each axis of s, one for all or one each. What only the simulator
    needs: triangle: P1, P2, P3 in t, m, that make the frame t; origin: that of t, in s, m, which no
    attitude depends on. Raises InputError on points that make another frame than t.
    """

    kind: ClassVar[str] = "three_point_attitude"
    columns: ClassVar[tuple[str, ...]] = tuple(
        f"p{n}_{axis}_m" for n in (1, 2, 3) for axis in "xyz"
    )

    sigma: Annotated[Array, Quantity("m", (3,), positive=True, fill=True)]
    triangle: Annotated[Array, Quantity("m", (3, 3))] | None = None
    origin: Annotated[Array, Quantity("m", (3,))] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.triangle is not None:
            axes = frame_of(self.triangle[None])[0][0]
            if not np.abs(axes - np.eye(3)).max() <= 1e-6:
                raise InputError(
                    f"{self.kind}.triangle: found {self.triangle.tolist()}, expected points that"
                    " make the frame t: P1P2 along x, P3 on the side of y in the plane z of P1"
                )

    def accept(self, z: Array) -> Array:
        """The frames' R_st as q_wxyz (k, 4), of points (k, 9) in s, m. Raises InputError on three
        that are on a line."""
        if z.ndim != 2 or z.shape[1] != len(self.columns):
            raise InputError(f"{self.kind}: found z of {z.shape}, expected columns {self.columns}")
        axes = frame_of(z.reshape(-1, 3, 3))[0]
        bad = np.flatnonzero(~np.isfinite(axes).all(axis=(1, 2)))
        if len(bad):
            found = z[bad[0]].reshape(3, 3).tolist()
            raise InputError(f"{self.kind}: found points {found}, expected three not on a line")
        return np.array([so3.quaternion(np.ascontiguousarray(R)) for R in axes]).reshape(-1, 4)

    def predict(self, ids: Indices, *x: Array) -> Array:
        """The three points (k, 9) in s, m. Raises InputError without `triangle`."""
        if self.triangle is None:
            raise InputError(f"{self.kind}.triangle: found none, expected them to simulate it")
        one = self.origin + self.triangle @ self.attitude(*x).T
        return np.tile(one.ravel(), (len(ids), 1))

    def perturb(self, z: Array, e: Array) -> Array:
        """Turn the points (k, 9), m, about the first so that their frame turns by e (k, 3), rad, on
        the right."""
        out = z.reshape(-1, 3, 3).copy()
        for points, R, d in zip(out, frame_of(out)[0], e, strict=True):
            points[:] = points[0] + (points - points[0]) @ (R @ so3.exp(d) @ R.T).T
        return out.reshape(-1, 9)

    def scattered(self, z: Array, unit: Array) -> Array:
        """The points (k, 9), m, with independent noise: sigma times the unit noise (k, 9)."""
        out: Array = z + np.tile(self.sigma, 3) * unit
        return out

    def noise(self, m: Measurement) -> Array:
        slopes = frame_slopes(m.z.reshape(-1, 3, 3))
        out: Array = np.einsum("kij,j,klj->kil", slopes, np.tile(self.sigma**2, 3), slopes)
        return out
