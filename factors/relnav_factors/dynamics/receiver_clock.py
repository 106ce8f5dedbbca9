"""Clock of a satellite navigation receiver on the chaser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.white_noise import duration
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity

#: Offset of the clock times the speed of light, m, and its rate, m/s.
CLOCK_BIAS = Block("clock_bias", "c_b", "vector", 1, "m", "-", "m")
CLOCK_DRIFT = Block("clock_drift", "c_d", "vector", 1, "m/s", "-", "m/s")


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``b' = d + white``, ``d' = white``, in closed form.

    p (2,): density of the phase's random walk (m/sqrt(s)), of the frequency's (m/s^1.5). u
    (rows, 1): dt, s. x, x_next (2,): b (m), d (m/s). F, Q (2, 2), SI. Of a constant d, which is
    only read: x_next (1,), F (1, 2), Q (1, 1).
    """
    h = duration(u)
    phase, frequency = p[0] ** 2, p[1] ** 2
    x_next[0] = x[0] + h * x[1]
    F[0, 0], F[0, 1] = 1.0, h
    Q[0, 0] = phase * h + frequency * h**3 / 3
    if x_next.shape[0] > 1:
        x_next[1] = x[1]
        F[1, 0], F[1, 1] = 0.0, 1.0
        Q[0, 1] = Q[1, 0] = frequency * h**2 / 2
        Q[1, 1] = frequency * h
    return 0


@dataclass(frozen=True, kw_only=True)
class ReceiverClock(DynamicsModel):
    """b' = d + white, d' = white: phase and frequency of a clock, times the speed of light.

    The two-state model of Brown and Hwang 2012, section 9.3.

    phase_density: m/sqrt(s); frequency_density: m/s^1.5; 0, the default: d is constant, a static
    block. Raises InputError where neither walks.
    """

    kind: ClassVar[str] = "receiver_clock"
    kernel = staticmethod(kernel)

    phase_density: Annotated[float, Quantity("m/sqrt(s)", nonnegative=True)]
    frequency_density: Annotated[float, Quantity("m/s^1.5", nonnegative=True)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.phase_density or self.frequency_density):
            raise InputError(
                f"{self.kind}: found phase_density and frequency_density both 0, expected one"
                " above; a constant clock_bias needs no process"
            )

    @property
    def advances(self) -> tuple[Block, ...]:
        return (CLOCK_BIAS, CLOCK_DRIFT) if self.frequency_density else (CLOCK_BIAS,)

    @property
    def reads(self) -> tuple[Block, ...]:
        return () if self.frequency_density else (CLOCK_DRIFT,)

    @property
    def noises(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("phase_density", "frequency_density")[: len(self.advances)]

    def constants(self) -> Array:
        return np.array([self.phase_density, self.frequency_density])
