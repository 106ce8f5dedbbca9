"""Position of the chaser by satellite navigation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.mounting import Mounted, displacement
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE, CHASER_POSITION
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3
from relnav_graph.units import Quantity


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = r_c_i + R_ic r_ac_c - z``.

    p (3,): r_ac_c, m, the antenna in c. q (0,). z (3,): the antenna in i, m. x (3,): r_c_i (m), or,
    with an antenna away from the chaser's origin, (12,): r_c_i, R_ic row by row, or (15,): then
    d_sn_c (m), what is estimated of its place. r (3,), m. H (3, 3), (3, 6) or (3, 9).
    """
    dense.put_block(H, 0, 0, dense.identity(3), 1.0)
    for i in range(3):
        r[i] = x[i] - z[i]
    if x.shape[0] > 3:
        R_ic, arm = dense.matrix_at(x, 3), p.copy()
        for i in range(x.shape[0] - 12):
            arm[i] += x[12 + i]
        dense.put_vector(r, 0, dense.add_scaled_vector(r, dense.matvec(R_ic, arm), 1.0))
        dense.put_block(H, 0, 3, dense.matmul(R_ic, so3.skew(arm)), -1.0)
        if x.shape[0] > 12:
            dense.put_block(H, 0, 6, R_ic, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class GpsPosition(Mounted):
    """Position of the antenna in the inertial frame, z = r_c_i + R_ic r_ac_c.

    Xiong et al. 2013, eq. 23, with a lever arm: the receiver's solution, already turned
    from Earth-fixed to inertial axes. o must not rotate where the antenna has an arm.

    sigma: m, per axis of i, one for all or one each; antenna_position: r_ac_c, m, of the
    antenna in chaser axes, nominal where the mounting is estimated.
    """

    kind: ClassVar[str] = "gps_position"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    rows: ClassVar[int] = 3
    kernel = staticmethod(kernel)

    sigma: Annotated[Array, Quantity("m", (3,), positive=True, fill=True)]
    antenna_position: Annotated[Array, Quantity("m", (3,))] = field(
        default_factory=lambda: np.zeros(3)
    )

    @property
    def _arm(self) -> bool:
        return bool(self.antenna_position.any()) or self.mounting == "estimated"

    @property
    def reads(self) -> tuple[Block, ...]:
        if self.mounting == "estimated":
            return CHASER_POSITION, CHASER_ATTITUDE, displacement(self.mount)
        if self._arm:
            return CHASER_POSITION, CHASER_ATTITUDE
        return (CHASER_POSITION,)

    @property
    def orbit(self) -> None:
        """None where the antenna has an arm: o is i. Without one it does not matter."""
        if not self._arm:
            raise AttributeError("orbit")

    def constants(self) -> Array:
        return self.antenna_position

    def mounting_fields(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """r_ac_c (3,), m, with this value of what is estimated of it, by name."""
        moved = values.get(displacement(self.mount).name, np.zeros(3))
        return {"antenna_position": self.antenna_position + moved}

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """The one position that a fix gives.

        z: (k, 3), m; known: values of the other blocks: with an arm, R_ic (3, 3) is needed.
        """
        if not self._arm:
            yield {CHASER_POSITION.name: z[0]}
        elif CHASER_ATTITUDE.name in known:
            moved = known.get(displacement(self.mount).name, np.zeros(3))
            arm = known[CHASER_ATTITUDE.name] @ (self.antenna_position + moved)
            yield {CHASER_POSITION.name: z[0] - arm}

    def noise(self, m: Measurement) -> Array:
        return np.tile(np.diag(self.sigma**2), (len(m.z), 1, 1))
