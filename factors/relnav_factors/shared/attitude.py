"""Attitudes as measured: quaternions, and the residual on SO(3) that all share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.mounting import MountedSensor
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.measurement import QUATERNION, Measurement
from relnav_graph.core.state import UNIT_QUATERNION
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity


@jit
def attitude_residual(q_wxyz: Array, predicted: Array, r: Array) -> Array:
    """Fill r with ``Log(R_measured^T R_predicted)``, and give its Jacobian.

    q_wxyz: (4,), of R_measured; q and -q are the same; predicted: (3, 3); r: (3,), rad. Returns the
    inverse right Jacobian of SO(3) at r, (3, 3): dr to a right perturbation of the prediction.
    """
    error = so3.log(dense.transposed_matmul(so3.from_quaternion(q_wxyz), predicted))
    dense.put_vector(r, 0, error)
    return so3.right_jacobian_inverse(error)


def unit_quaternions(where: str, q_wxyz: Array) -> Array:
    """Quaternions (k, 4) normalised, scalar first, without unit.

    where: name for the message. Raises InputError when a length is not 1 +- 1e-3.
    """
    lengths = np.linalg.norm(q_wxyz, axis=1, keepdims=True)
    error = np.abs(lengths - 1)
    if not (error <= UNIT_QUATERNION).all():
        worst = q_wxyz[error.argmax()]
        raise InputError(
            f"{where}: found {worst} of length {np.linalg.norm(worst):.6g}, expected a unit"
            " quaternion, scalar first"
        )
    return np.ascontiguousarray(q_wxyz / lengths)


def turned(q_wxyz: Array, e: Array) -> Array:
    """Quaternions (k, 4) of R Exp(e), for e (k, 3), rad."""
    pairs = zip(np.ascontiguousarray(q_wxyz), np.ascontiguousarray(e), strict=True)
    return dense.stacked((so3.quaternion(so3.from_quaternion(q) @ so3.exp(d)) for q, d in pairs), 4)


@dataclass(frozen=True, kw_only=True)
class AttitudeSensor(MountedSensor):
    """What the sensors of attitude share: z is q_wxyz, Hamilton, scalar first.

    sigma: rad, about each axis of the measured attitude's right-hand frame, one for all or
    one each; sensor_attitude: R_cs. Raises InputError when R_cs is not a rotation within
    1e-6.
    """

    columns: ClassVar[tuple[str, ...]] = QUATERNION
    rows: ClassVar[int] = 3
    residual_columns: ClassVar[tuple[str, ...]] = ("x_rad", "y_rad", "z_rad")

    sigma: Annotated[Array, Quantity("rad", (3,), positive=True, fill=True)]

    def accept(self, z: Array) -> Array:
        """Unit quaternions (k, 4). Raises InputError when a length is not 1 within 1e-3."""
        return unit_quaternions(self.kind, super().accept(z))

    def attitude(self, *x: Array) -> Array:
        """The attitude (3, 3) that would be measured without noise."""
        raise NotImplementedError

    def predict(self, ids: Indices, *x: Array) -> Array:
        """q_wxyz (k, 4), w >= 0."""
        one = so3.quaternion(np.ascontiguousarray(self.attitude(*x)))
        return np.tile(one, (len(ids), 1))

    def perturb(self, z: Array, e: Array) -> Array:
        """Turn each attitude by e (k, 3), rad, on the right."""
        return turned(z, e)

    def noise(self, m: Measurement) -> Array:
        return np.tile(np.diag(self.sigma**2), (len(m.z), 1, 1))


def axis_rotations() -> list[Array]:
    """The 24 rotations (3, 3) that take axes to axes.

    Any rotation is within 63 deg of one of them.
    """
    found = []
    for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]):
        for signs in np.ndindex(2, 2, 2):
            R = np.zeros((3, 3))
            R[range(3), order] = 1.0 - 2.0 * np.array(signs)
            if np.linalg.det(R) > 0:
                found.append(R)
    return found
