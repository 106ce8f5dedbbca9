"""Thrust in the kernels: an acceleration that holds over a row of inputs, and its noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.manoeuvres import COVARIANCE, THRUST_COLUMNS
from relnav_graph.core.models import DynamicsModel

#: How many numbers are a row's thrust: acceleration (3,), and covariance density of its noise (6,).
THRUST = len(THRUST_COLUMNS)


@jit
def thrust_of(u: Array, row: int) -> Array:
    """The thrust (9,) of a row of inputs: acceleration (3,), covariance density (6,).

    u: (rows, 10): length of the row, s, then these, m/s^2 and m^2/s^3; or (rows, 1), without.
    """
    out = np.zeros(THRUST)
    if u.shape[1] > THRUST:
        for i in range(THRUST):
            out[i] = u[row, 1 + i]
    return out


@jit
def add_thrust_noise(Q: Array, thrust: Array, h: float) -> None:
    """Add to Q the noise of a position and velocity under thrust with white noise, over h seconds.

    Q: (n, n), changed in place: three positions, then their velocities; thrust: (9,), as of
    `thrust_of`; h: s. With C the covariance density: Q_vv += C h^3 / 3, Q_vr += C h^2 / 2,
    Q_rr += C h, as of `relnav_factors.shared.white_noise.add_integrated_white_noise`.
    """
    if thrust[3] + thrust[6] + thrust[8] == 0.0:  # no variance, so no covariance
        return
    for i in range(3):
        for j in range(3):
            c = thrust[3 + COVARIANCE[i, j]] * h
            Q[i, j] += c * h * h / 3
            Q[i, 3 + j] += c * h / 2
            Q[3 + i, j] += c * h / 2
            Q[3 + i, 3 + j] += c


@dataclass(frozen=True, kw_only=True)
class Thrusted(DynamicsModel):
    """What the processes of a craft that may have thrust share.

    thrust: whether that is an input, known accelerations with a covariance of what they miss, in
    the axes of the velocity (`relnav_graph.core.manoeuvres`).
    """

    thrust: bool = False

    @property
    def inputs(self) -> Mapping[str, tuple[str, ...]]:  # type: ignore[override]
        return {"thrust": THRUST_COLUMNS} if self.thrust else {}
