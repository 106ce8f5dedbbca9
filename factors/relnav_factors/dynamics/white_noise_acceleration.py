"""Relative motion without an orbit: constant velocity driven by white acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.points import Pose
from relnav_factors.shared.white_noise import add_integrated_white_noise, duration
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import (
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    RELATIVE_VELOCITY,
    RELATIVE_VELOCITY_T,
)
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.units import Quantity


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``r'' = white``, in closed form.

    p (1,): acceleration density, m/s^1.5. u (rows, 1): dt, s. x, x_next (6,): r (m), v (m/s), of c
    from t, both in o or both in t. F, Q (6, 6), SI.
    """
    dt = duration(u)
    dense.put_block(F, 0, 0, dense.identity(6), 1.0)
    dense.put_block(Q, 0, 0, np.zeros((6, 6)), 1.0)
    for i in range(3):
        x_next[i] = x[i] + dt * x[3 + i]
        x_next[3 + i] = x[3 + i]
        F[i, 3 + i] = dt
    add_integrated_white_noise(Q, 0, p[0] ** 2, dt)
    return 0


@dataclass(frozen=True, kw_only=True)
class WhiteNoiseAcceleration(DynamicsModel):
    """Position and velocity in a frame that does not rotate, r'' = white.

    Bar-Shalom, Li, Kirubarajan 2001, section 6.2.2.
    acceleration_density: m/s^1.5, per axis; pose: whether r and v are in o or in t.
    """

    kind: ClassVar[str] = "white_noise_acceleration"
    #: o does not turn.
    orbit: ClassVar[None] = None
    noises: ClassVar[tuple[str, ...]] = ("acceleration_density", "acceleration_density")
    kernel = staticmethod(kernel)

    acceleration_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    pose: Pose = "orbital"

    @property
    def advances(self) -> tuple[Block, ...]:
        if self.pose == "orbital":
            return RELATIVE_POSITION, RELATIVE_VELOCITY
        return RELATIVE_POSITION_T, RELATIVE_VELOCITY_T

    def constants(self) -> Array:
        return np.array([self.acceleration_density])
