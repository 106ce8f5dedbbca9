"""Relative position, measured as a whole: differential satellite navigation, radio."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.points import Pose
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import RELATIVE_POSITION, RELATIVE_POSITION_T
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import SensorModel
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = r_tc - z``. p (0,). q (0,). z, x (3,): m. r (3,), m. H (3, 3), m/m."""
    dense.put_vector(r, 0, dense.add_scaled_vector(x, z, -1.0))
    dense.put_block(H, 0, 0, dense.identity(3), 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class PositionFix(SensorModel):
    """Position of the chaser relative to the target, z = r_tc, in the axes of the state.

    As the difference of two solutions of satellite navigation, already turned into these axes.

    sigma: m, per axis, one for all or one each; pose: whether r_tc is in o or in t.
    """

    kind: ClassVar[str] = "position_fix"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    rows: ClassVar[int] = 3
    kernel = staticmethod(kernel)

    sigma: Annotated[Array, Quantity("m", (3,), positive=True, fill=True)]
    pose: Pose = "orbital"

    @property
    def reads(self) -> tuple[Block, ...]:
        return (RELATIVE_POSITION if self.pose == "orbital" else RELATIVE_POSITION_T,)

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """The one position that a fix gives. z: (k, 3), m; known: nothing is needed."""
        yield {self.reads[0].name: z[0]}

    def noise(self, m: Measurement) -> Array:
        return np.tile(np.diag(self.sigma**2), (len(m.z), 1, 1))
