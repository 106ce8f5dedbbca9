"""A star tracker on the chaser: its attitude among the stars."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_factors.shared.attitude import AttitudeSensor, attitude_residual
from relnav_factors.shared.mounting import mounting_of
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.maths.orbit import KeplerOrbit


@jit
def inertial_attitude(p: Array, x: Array) -> Array:
    """``R_is = R_ic R_cs``, (3, 3), the attitude of the sensor in the inertial frame.

    p: (13,), of the mounting; x: (9,): R_ic, then (9,): R_ns of an estimated mounting. Matrices of
    rotations, without unit.
    """
    return dense.matmul(dense.matrix_at(x, 0), dense.matrix_at(mounting_of(p, x), 0))


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = Log(R_measured^T R_ic R_cs)``, in sensor axes.

    p (13,): of the mounting. q (0,). z (4,): q_wxyz of R_is. x (9,): R_ic row by row; then (9,):
    R_ns of an estimated mounting. r (3,), rad. H (3, 3), or (3, 6) with the mounting, rad/rad.
    """
    jacobian = attitude_residual(z, inertial_attitude(p, x), r)
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
    """Attitude of the sensor in the inertial frame, z = R_ic R_cs as q_wxyz.

    The measurement of Xiong et al. 2013, eq. 26, with the residual on SO(3): the Jacobian
    of identity that the paper prints holds only for the error q_hat^-1 x q_measured.

    o must not rotate (there it is i). orbit: taken only to be refused, because a scenario
    with an [orbit] has an o that does; raises InputError then.
    """

    kind: ClassVar[str] = "star_tracker"
    kernel = staticmethod(kernel)

    orbit: KeplerOrbit | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.orbit is not None:
            raise InputError(
                "star_tracker: found an [orbit], with which o rotates; a star tracker needs"
                " attitudes in a frame that does not rotate"
            )

    @property
    def reads(self) -> tuple[Block, ...]:
        return CHASER_ATTITUDE, *self.mounting_blocks

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """The one attitude that the first measurement gives.

        z: (k, 4), q_wxyz; known: values of the other blocks, of which none is needed.
        """
        yield {CHASER_ATTITUDE.name: so3.from_quaternion(z[0]) @ self.mounted(known)[0].T}

    def attitude(self, *x: Array) -> Array:
        """R_is (3, 3), which takes sensor axes to inertial ones.

        x: R_ic (3, 3), and R_ns (3, 3) of an estimated mounting.
        """
        packed = np.concatenate([np.ravel(value) for value in x])
        return inertial_attitude(self.constants(), packed)
