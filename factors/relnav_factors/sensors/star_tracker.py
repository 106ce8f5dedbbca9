"""A star tracker on the chaser: its attitude among the stars."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.attitude import AttitudeSensor, attitude_residual
from relnav_factors.shared.mounting import mounting_of
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion, orbit_array
from relnav_graph.units import Quantity


@jit
def inertial_attitude(p: Array, q: Array, x: Array) -> Array:
    """``R_is = R_io R_oc R_cs``, (3, 3), the attitude of the sensor in the inertial frame.

    p: (13,), of the mounting; q: (9,): R_io row by row, or (0,): o is i; x: (9,): R_oc, then (9,):
    R_ns of an estimated mounting. Matrices of rotations, without unit.
    """
    R_os = dense.matmul(dense.matrix_at(x, 0), dense.matrix_at(mounting_of(p, x), 0))
    return dense.matmul(dense.matrix_at(q, 0), R_os) if q.shape[0] > 0 else R_os


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = Log(R_measured^T R_io R_oc R_cs)``, in sensor axes.

    p (13,): of the mounting. q (9,): R_io row by row, or (0,): o is i. z (4,): q_wxyz of R_is. x
    (9,): R_oc row by row; then (9,): R_ns of an estimated mounting. r (3,), rad. H (3, 3), or
    (3, 6) with the mounting, rad/rad.
    """
    jacobian = attitude_residual(z, inertial_attitude(p, q, x), r)
    mounting = mounting_of(p, x)
    for i in range(3):
        for j in range(3):
            H[i, j] = 0.0
            for k in range(3):  # a turn d of c is R_cs^T d of s
                H[i, j] += jacobian[i, k] * mounting[3 * j + k]
    if p[12] > 0.0:
        dense.put_block(H, 0, 3, jacobian, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class StarTracker(AttitudeSensor):
    """Attitude of the sensor in the inertial frame, z = R_io R_oc R_cs as q_wxyz.

    The measurement of Xiong et al. 2013, eq. 26, with the residual on SO(3): the Jacobian
    of identity that the paper prints holds only for the error q_hat^-1 x q_measured.

    orbit: the target's, with which o turns, None where o is i; inclination, raan and
    argument_of_perigee: rad, how it lies in i: R_io turns by raan about z, by the inclination about
    x, by argument of perigee and true anomaly about z; time: s, see `at`. Raises InputError on
    an orbit without these.
    """

    kind: ClassVar[str] = "star_tracker"
    kernel = staticmethod(kernel)

    orbit: KeplerOrbit | None = None
    inclination: Annotated[float | None, Quantity("rad")] = None
    raan: Annotated[float | None, Quantity("rad")] = None
    argument_of_perigee: Annotated[float | None, Quantity("rad")] = None
    time: Annotated[float, Quantity("s")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("inclination", "raan", "argument_of_perigee"):
            if (getattr(self, name) is None) != (self.orbit is None):
                needed = (
                    "an [orbit], with which o rotates, and" if self.orbit else "no [orbit], but"
                )
                raise InputError(
                    f"star_tracker.{name}: found {needed} {getattr(self, name)}, expected both or"
                    " none: the stars are at rest in i"
                )

    @property
    def reads_time(self) -> bool:
        return self.orbit is not None

    def at(self, t: float) -> StarTracker:
        """The sensor at time t, s: o is where the orbit says."""
        return self if self.orbit is None else replace(self, time=t)

    def observation_data(self, ids: Indices) -> Array:
        """R_io row by row, (k, 9), at the sensor's time; (k, 0) where o is i."""
        return np.tile(self._axes().reshape(-1), (len(ids), 1))

    def _axes(self) -> Array:
        """R_io (3, 3) at the sensor's time, (0,) where o is i."""
        if self.orbit is None:
            return np.zeros(0)
        assert self.inclination is not None
        assert self.raan is not None
        assert self.argument_of_perigee is not None
        z, x = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
        latitude = self.argument_of_perigee + chief_motion(orbit_array(self.orbit), self.time)[2]
        plane = so3.exp(self.raan * z) @ so3.exp(self.inclination * x)
        out: Array = plane @ so3.exp(latitude * z)
        return out

    @property
    def reads(self) -> tuple[Block, ...]:
        return CHASER_ATTITUDE, *self.mounting_blocks

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """The one attitude that the first measurement gives.

        z: (k, 4), q_wxyz; known: values of the other blocks, of which none is needed.
        """
        R_ic = so3.from_quaternion(z[0]) @ self.mounted(known)[0].T
        yield {CHASER_ATTITUDE.name: R_ic if self.orbit is None else self._axes().T @ R_ic}

    def attitude(self, *x: Array) -> Array:
        """R_is (3, 3), which takes sensor axes to inertial ones.

        x: R_oc (3, 3), and R_ns (3, 3) of an estimated mounting.
        """
        packed = np.concatenate([np.ravel(value) for value in x])
        return inertial_attitude(self.constants(), self._axes().reshape(-1), packed)
