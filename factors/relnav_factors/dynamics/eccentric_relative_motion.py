"""Relative motion about a target on an orbit of any eccentricity, known or in the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from relnav_factors.shared.planar_orbit import in_state, motions_over, orbit_blocks, planar_motion
from relnav_factors.shared.relative_orbit import exact_step, linear_step
from relnav_factors.shared.statuses import (
    LOST_ORBIT,
    NO_ORBIT,
    ORBIT_FAILURES,
    degenerate,
    finite,
    length_status,
)
from relnav_factors.shared.thrust import Thrusted, add_thrust_noise, thrust_of
from relnav_factors.shared.white_noise import add_step, duration, put_advanced, step_count
from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit
from relnav_graph.core.catalogue import RELATIVE_POSITION, RELATIVE_VELOCITY
from relnav_graph.core.contracts import Kernel
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import dense
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion, orbit_array
from relnav_graph.units import Quantity

#: Where the numbers of the kernels stand in p, after the orbit (5,).
_DENSITY, _MAX_STEP = 5, 6
#: Status: the motion leaves what floats hold.
_LEFT = 2
FAILURES = {
    **ORBIT_FAILURES,
    _LEFT: "the motion relative to the target is beyond what floats hold",
    **degenerate("the distance of the chaser from the centre of attraction"),
}


@jit
def _why(p: Array, t: float, length: float, x: Array) -> int:
    """The status of an interval over which the motion is not finite; see `LOST_ORBIT`.

    p, x: as of `exact_kernel`; t: its start, length, s.
    """
    if in_state(p) > 0:
        r = x[6]
        if not finite(planar_motion(p[3], x[6:], length)[1]):
            return NO_ORBIT
    else:
        for at in (t, t + length):
            motion = chief_motion(p, at)
            if not np.isfinite(motion[0] + motion[2]):
                return LOST_ORBIT
        r = chief_motion(p, t)[0]
    distance = np.sqrt((r + x[0]) ** 2 + x[1] ** 2 + x[2] ** 2)
    return max(length_status(distance, 0), _LEFT)


@jit
def _stepped(
    p: Array, t: float, u: Array, state: Array, y: Array, exact: bool
) -> tuple[Array, Array, Array]:
    """A state (6,) carried over an interval from t, s, with its sensitivity and noise.

    p, u: as of `exact_kernel`; y (k,): the orbit where it is in the state, (4,), else (0,); exact:
    by `exact_step`, or by `linear_step`. The sensitivity (6 + k, 6 + k) and the noise, of which the
    orbit has none here, end with y.
    """
    m = 6 + y.shape[0]
    total, noise, own, begin = dense.identity(m), np.zeros((m, m)), np.zeros((m, m)), t
    for row in range(u.shape[0]):
        thrust, length = thrust_of(u, row), u[row, 0]
        steps = step_count(length, p[_MAX_STEP])
        h = length / steps
        for n in range(steps):
            give_way(n)
            if exact:
                motions, slopes = motions_over(p, begin + n * h, h, y)
                state, step = exact_step(motions, slopes, p[3], h, state, thrust)
            else:
                state, step = linear_step(p, begin + n * h, h, state, thrust)
            dense.put_block(own, 0, 0, step, 1.0)
            if m > 6:
                y, ahead = planar_motion(p[3], y, h)
                dense.put_block(own, 6, 6, ahead, 1.0)
            add_step(own, p[_DENSITY] ** 2, h, total, noise)
            add_thrust_noise(noise, thrust, h)
        begin += length
    return state, total, noise


@jit
def exact_kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """Exact difference of two two-body motions, see `exact_step`, plus white noise.

    p (7,): orbit (5,), acceleration density (m/s^1.5), longest step (s). u (rows, 1): dt, s, or
    (rows, 10), see `thrust_of`. x, x_next (6,): r_tc_o (m), r_tc_o' in o (m/s). F, Q (6, 6), SI. An
    orbit in the state stands last in x (10,) and F (6, 10). Status: see `FAILURES`.
    """
    state, total, noise = _stepped(p, t, u, x[:6], x[6 : 6 + in_state(p)], True)
    if not (finite(total) and finite(state.reshape(1, 6))):
        return _why(p, t, duration(u), x)
    dense.put_vector(x_next, 0, state)
    put_advanced(total, noise, F, Q)
    return 0


@jit
def linear_kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """The motion under linear gravity: ``x_next = Phi(t, t + h) x + ...``, Phi in closed form.

    p, u, x, x_next, F, Q: as of `exact_kernel`, (6,) and (6, 6), m and m/s. Steps serve the noise
    and the thrust: each adds that of constant velocity over its length; see `linear_step`.
    """
    # From rest, by thrust alone.
    pushed, total, noise = _stepped(p, t, u, np.zeros(6), x[6:], False)
    if not finite(total):
        return _why(p, t, duration(u), x)
    moved = dense.add_scaled_vector(dense.matvec(total, x), pushed, 1.0)
    dense.put_vector(x_next, 0, moved)
    dense.put_block(F, 0, 0, total, 1.0)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class EccentricRelativeMotion(Thrusted):
    """Position and velocity of the chaser relative to the target, in the rotating frame.

    gravity = "linear": Zhang et al. 2015, eq. 1, whose transition matrix is known in
    closed form (`relnav_graph.maths.orbit.relative_transition`); it neglects 1.5 mu r^2 / R^4,
    2.5e-8 m/s^2 at 300 m in low orbit. gravity = "exact": the difference of the two
    two-body motions, of which the linear equations are the first order; it is integrated jointly
    with an orbit that is estimated, where that has no noise (the orbit's own process has).

    acceleration_density: m/s^1.5, white, per axis; max_step: s, the longest step of the
    integration; relative_velocity is the derivative in the rotating frame. Raises InputError on
    linear gravity about an orbit that is estimated.
    """

    kind: ClassVar[str] = "eccentric_relative_motion"
    noises: ClassVar[tuple[str, ...]] = ("acceleration_density", "acceleration_density")
    failures = FAILURES

    acceleration_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    orbit: KeplerOrbit
    gravity: Literal["exact", "linear"] = "exact"
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.orbit.estimated and self.gravity != "exact":
            raise InputError(
                f"{self.kind}.gravity: found {self.gravity!r} and an estimated orbit, expected"
                " 'exact': how the transition matrix depends on the orbit is not known"
            )

    @property
    def kernel(self) -> Kernel:  # type: ignore[override]
        return exact_kernel if self.gravity == "exact" else linear_kernel

    @property
    def advances(self) -> tuple[Block, ...]:
        return RELATIVE_POSITION, RELATIVE_VELOCITY

    @property
    def reads(self) -> tuple[Block, ...]:
        return orbit_blocks(self.orbit)

    def constants(self) -> Array:
        return np.array([*orbit_array(self.orbit), self.acceleration_density, self.max_step])
