"""An infrared Earth sensor on the chaser: where the middle of the Earth's disc is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from relnav_factors.shared.mounting import MountedSensor, mounting_of, without_mounting
from relnav_factors.shared.statuses import degenerate, length_status
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    CHASER_POSITION,
    EARTH_SENSOR_BIAS,
    EARTH_SENSOR_DRIFT,
)
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity


@jit
def earth_in_sensor(R_cs: Array, x: Array) -> tuple[Array, Array]:
    """``e = R_cs^T R_ic^T (-r_c_i)``: the Earth's centre in sensor axes, and its Jacobian.

    R_cs: (3, 3); x: starts with R_ic row by row (9,), r_c_i (3,), m. Returns e (3,), m, and its
    Jacobian (3, 6) to (R_ic, r_c_i): per rad of a right perturbation, then per m.
    """
    R_ic, down_i = dense.matrix_at(x, 0), dense.vector_at(x, 9)
    for i in range(3):
        down_i[i] = -down_i[i]
    down_c = dense.transposed_matvec(R_ic, down_i)
    R_is, jacobian = dense.matmul(R_ic, R_cs), np.empty((3, 6))
    dense.put_block(jacobian, 0, 0, dense.transposed_matmul(R_cs, so3.skew(down_c)), 1.0)
    dense.put_block(jacobian, 0, 3, dense.transposed_matmul(R_is, dense.identity(3)), -1.0)
    return dense.transposed_matvec(R_cs, down_c), jacobian


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = (atan2(e_y, e_z), atan2(e_x, e_z)) + b - z``, see `earth_in_sensor`.

    p (13,): of the mounting. q (0,). z (2,): roll, pitch, rad. x (14,): R_ic row by row, r_c_i (m),
    b (2,), rad; then (2,): what drifts about b, if it does, rad; then (9,): R_ns of an estimated
    mounting. r (2,), rad. H (2, 8) to (R_ic, r_c_i, b), and 2 columns more for the drift, 3 for the
    mounting. Status 1: the Earth is behind; or that of
    `length_status` for its distance.
    """
    e, de = earth_in_sensor(dense.matrix_at(mounting_of(p, x), 0), x)
    to_mounting = so3.skew(e)
    status = length_status(dense.norm(e), 0)
    if status != 0:
        return status
    if e[2] <= 0.0:
        return 1
    biases = without_mounting(p, x).shape[0] - 12
    for i in range(2):
        side = e[1] if i == 0 else e[0]
        square = side * side + e[2] * e[2]
        r[i] = np.arctan2(side, e[2]) + x[12 + i] - z[i]
        if biases > 2:
            r[i] += x[14 + i]
        for j in range(6):
            d_side = de[1, j] if i == 0 else de[0, j]
            H[i, j] = (e[2] * d_side - side * de[2, j]) / square
        for j in range(biases):
            H[i, 6 + j] = 1.0 if j % 2 == i else 0.0
        for j in range(int(p[12])):
            d_side = to_mounting[1, j] if i == 0 else to_mounting[0, j]
            H[i, 6 + biases + j] = (e[2] * d_side - side * to_mounting[2, j]) / square
    return 0


@dataclass(frozen=True, kw_only=True)
class EarthSensor(MountedSensor):
    """Direction of the Earth's centre, e = R_cs^T R_ic^T (-r_c): roll and pitch, with a bias.

    Roll atan2(e_y, e_z), pitch atan2(e_x, e_z), about the sensor's axis z, which looks at the
    Earth; each has a bias of its own (`EarthSensorBias`). As used by Yang et al. 2016; the
    Earth is a sphere. o must not rotate: it is i.

    sigma: rad, white, of each angle; drift: whether what drifts about a constant bias is a block of
    its own; sensor_attitude: R_cs. Raises InputError when it is not a rotation within 1e-6.
    """

    kind: ClassVar[str] = "earth_sensor"
    #: o does not turn.
    orbit: ClassVar[None] = None
    columns: ClassVar[tuple[str, ...]] = ("roll_rad", "pitch_rad")
    rows: ClassVar[int] = 2
    kernel = staticmethod(kernel)
    failures = {
        1: "the Earth is behind the sensor",
        **degenerate("the distance from the chaser to the Earth's centre"),
    }

    sigma: Annotated[float, Quantity("rad", positive=True)]
    drift: bool = False

    @property
    def reads(self) -> tuple[Block, ...]:
        biases = (EARTH_SENSOR_BIAS, EARTH_SENSOR_DRIFT) if self.drift else (EARTH_SENSOR_BIAS,)
        return CHASER_ATTITUDE, CHASER_POSITION, *biases, *self.mounting_blocks

    def without_drift(self) -> Self:
        """The same with a constant bias, see `relnav_graph.core.contracts.Drifts`."""
        return replace(self, drift=False)

    def accept(self, z: Array) -> Array:
        """z (k, 2), rad. Raises InputError on angles too large to be in rad."""
        z = super().accept(z)
        bad = np.abs(z) > 0.5 * np.pi + 0.1
        if bad.any():
            raise InputError(
                f"{self.kind}: found {z[bad][0]}, expected an angle below pi / 2 rad (deg given"
                " for rad?)"
            )
        return z

    def noise(self, m: Measurement) -> Array:
        return np.tile(self.sigma**2 * np.eye(2), (len(m.z), 1, 1))
