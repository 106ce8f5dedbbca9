"""What the sensors of distance share: its formula, and biases, each of which is optional."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from relnav_factors.shared.points import Pose
from relnav_factors.shared.statuses import degenerate, length_status
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import SensorModel
from relnav_graph.core.state import Block
from relnav_graph.maths import dense

FAILURES: Mapping[int, str] = degenerate("the distance between target and chaser")


@jit
def line_to_chaser(x: Array) -> tuple[Array, float, int]:
    """Unit vector (3,) from the target to the chaser, the distance, m, and its `length_status`.

    x: starts with r_tc (3,), m.
    """
    line = dense.vector_at(x, 0)
    distance = dense.norm(line)
    status = length_status(distance, 0)
    for i in range(3):
        line[i] = line[i] / distance if status == 0 else 0.0
    return line, distance, status


@jit
def add_biases(x: Array, first: int, r: Array, H: Array) -> None:
    """Add to r (1,) what x (n,) holds from a place on, and put its slopes, one, in H (1, n).

    x and r: of one unit there, m or m/s.
    """
    for j in range(first, x.shape[0]):
        r[0] += x[j]
        H[0, j] = 1.0


@dataclass(frozen=True, kw_only=True)
class Ranging(SensorModel):
    """What the sensors of distance share.

    bias: whether the measurement has one, in a block that is constant where no process advances it;
    drift: whether it has what wanders about that, in a block of its own. Neither: a plain
    measurement. Sensors of one kind share these blocks. pose: whether r_tc is in o or in t.
    """

    rows: ClassVar[int] = 1
    failures = FAILURES

    bias: bool = False
    drift: bool = False
    pose: Pose = "orbital"
    sigma: float  # each kind has a unit of its own

    def without_drift(self) -> Self:
        """The same with a constant bias, see `relnav_graph.core.contracts.Drifts`."""
        return replace(self, drift=False)

    def biases(self, bias: Block, drift: Block) -> tuple[Block, ...]:
        """Those of the two blocks that the sensor reads."""
        return *((bias,) if self.bias else ()), *((drift,) if self.drift else ())

    def noise(self, m: Measurement) -> Array:
        return np.full((len(m.z), 1, 1), self.sigma**2)
