"""The target's orbit in its plane, where it is estimated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.planar_orbit import planar_motion
from relnav_factors.shared.statuses import NO_ORBIT, ORBIT_FAILURES, finite
from relnav_factors.shared.white_noise import add_driven_pair, carry, duration, step_count
from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit
from relnav_graph.core.catalogue import ORBIT
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import dense
from relnav_graph.maths.orbit import KeplerOrbit, orbit_array
from relnav_graph.units import Quantity

#: Where the numbers of the kernel stand in p, after the orbit (5,).
_DENSITY, _MAX_STEP = 5, 6


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``r'' = r th'^2 - mu / r^2 + white``, ``r th'' = -2 r' th' + white``, see `planar_motion`.

    p (7,): orbit (5,), acceleration density (m/s^1.5), longest step (s), which serves the noise. u
    (rows, 1): dt, s. x, x_next (4,): r (m), r' (m/s), th (rad), th' (rad/s). F, Q (4, 4), SI.
    Returns 0, or the status `NO_ORBIT`.
    """
    steps = step_count(duration(u), p[_MAX_STEP])
    h, y = duration(u) / steps, x
    total, noise = dense.identity(4), np.zeros((4, 4))
    for n in range(steps):
        give_way(n)
        y, step = planar_motion(p[3], y, h)
        if not finite(step):
            return NO_ORBIT
        carry(step, total, noise)
        add_driven_pair(noise, 0, 1, p[_DENSITY] ** 2, h)
        add_driven_pair(noise, 2, 3, (p[_DENSITY] / y[0]) ** 2, h)
    dense.put_vector(x_next, 0, y)
    dense.put_block(F, 0, 0, total, 1.0)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class PlanarOrbit(DynamicsModel):
    """The target's radius and angle in the plane of its orbit, and their rates: two-body motion.

    r'' = r th'^2 - mu / r^2, th'' = -2 r' th' / r (Zhang et al. 2015, eq. 1, which has them in the
    state as an option). The plane itself counts for nothing relative to the target. th is told by
    nothing that is relative to o: only its change is, and what it is depends on who sees
    directions at rest, such as stars.

    orbit: with estimated = true, of which mu counts; acceleration_density: m/s^1.5, white, radial
    and transverse; max_step: s, the longest step of the noise. Raises InputError on an orbit that
    is known.
    """

    kind: ClassVar[str] = "planar_orbit"
    noises: ClassVar[tuple[str, ...]] = ("acceleration_density",) * 4
    kernel = staticmethod(kernel)
    failures = ORBIT_FAILURES

    acceleration_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    orbit: KeplerOrbit
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.orbit.estimated:
            raise InputError(
                f"{self.kind}: found an orbit that is known, expected one with estimated = true"
            )

    @property
    def advances(self) -> tuple[Block, ...]:
        return ORBIT

    def constants(self) -> Array:
        return np.array([*orbit_array(self.orbit), self.acceleration_density, self.max_step])

    def directions(self, *x: Array) -> dict[str, tuple[Array, ...]]:
        """The angle from a direction at rest, of which nothing tells that is relative to o."""
        along = (np.full((1, 1), float(block == ORBIT[2])) for block in ORBIT)
        return {"angle of the target along its orbit": tuple(along)}
