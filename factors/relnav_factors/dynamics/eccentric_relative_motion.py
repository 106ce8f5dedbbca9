"""Relative motion about a target on a known orbit of any eccentricity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from relnav_factors.shared.statuses import LOST_ORBIT, NO_PLACE, degenerate, finite, length_status
from relnav_factors.shared.white_noise import add_step, duration, step_count
from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit
from relnav_graph.core.catalogue import RELATIVE_POSITION, RELATIVE_VELOCITY
from relnav_graph.core.contracts import Kernel
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion, orbit_array, relative_transition
from relnav_graph.units import Quantity

#: Where the numbers of the kernels stand in p, after the orbit (5,).
_DENSITY, _MAX_STEP = 5, 6
#: Status: the motion leaves what floats hold.
_LEFT = 2
FAILURES = {
    LOST_ORBIT: NO_PLACE,
    _LEFT: "the motion relative to the target is beyond what floats hold",
    **degenerate("the distance of the chaser from the centre of attraction"),
}


@jit
def relative_acceleration(motion: Array, mu: float, x: Array) -> tuple[Array, Array]:
    """Acceleration of the chaser relative to the target in rotating axes o, and its Jacobian.

    motion: (5,) of the target, see `relnav_graph.maths.orbit.chief_motion`; mu: m^3/s^2; x: (6,):
    r_tc_o (m), r_tc_o' in o (m/s), here r and r'. Returns r'' (3,), m/s^2, and its Jacobian (3, 6)
    to x, SI.

        r'' = g(r_t + r) - g(r_t) - 2 w x r' - w' x r - w x (w x r)

    w = w_oi_o along z. The difference of the two gravities is exact, in Battin's form
    (1999, eq. 8.61), which loses no digits however small the separation.
    """
    radius, rate, rate_dot = motion[0], motion[3], motion[4]
    rate2 = rate * rate
    q = (x[0] * (x[0] + 2 * radius) + x[1] * x[1] + x[2] * x[2]) / (radius * radius)
    stretch = q * (3 + 3 * q + q * q) / (1 + (1 + q) ** 1.5)
    distance = radius * np.sqrt(1 + q)
    pull = mu / distance**3
    out, n, jacobian = np.empty(3), np.empty(3), np.zeros((3, 6))
    for i in range(3):
        out[i] = -pull * x[i]
        n[i] = x[i] / distance
    out[0] += pull * stretch * radius + 2 * rate * x[4] + rate_dot * x[1] + rate2 * x[0]
    out[1] += -2 * rate * x[3] - rate_dot * x[0] + rate2 * x[1]
    n[0] += radius / distance
    for i in range(3):
        for j in range(3):
            jacobian[i, j] = 3 * pull * n[i] * n[j]
        jacobian[i, i] -= pull
    jacobian[0, 0] += rate2
    jacobian[1, 1] += rate2
    jacobian[0, 1] += rate_dot
    jacobian[1, 0] -= rate_dot
    jacobian[0, 4] = 2 * rate
    jacobian[1, 3] = -2 * rate
    return out, jacobian


@jit
def exact_step(orbit: Array, t: float, h: float, x: Array) -> tuple[Array, Array]:
    """One Runge-Kutta step of `relative_acceleration`, of fourth order.

    orbit: starts with the (5,) of `relnav_graph.maths.orbit.orbit_array`; t: start, s; h: length,
    s; x: (6,): r_tc_o (m), r_tc_o' (m/s). Returns x after the step, (6,), and its Jacobian (6, 6)
    to x, which is exact for the step as computed.
    """
    one = dense.identity(6)
    at_x, at_d, end_x, end_d = x, one, x, one
    k, dk = np.empty(6), np.empty((6, 6))
    motion = chief_motion(orbit, t)
    for stage in range(4):
        if stage in (1, 3):
            motion = chief_motion(orbit, t + h if stage == 3 else t + 0.5 * h)
        a, da = relative_acceleration(motion, orbit[3], at_x)
        chained = dense.matmul(da, at_d)
        for i in range(3):
            k[i], k[3 + i] = at_x[3 + i], a[i]
            for j in range(6):
                dk[i, j], dk[3 + i, j] = at_d[3 + i, j], chained[i, j]
        weight = h / 6 if stage in (0, 3) else h / 3
        end_x, end_d = (
            dense.add_scaled_vector(end_x, k, weight),
            dense.add_scaled(end_d, dk, weight),
        )
        ahead = h if stage == 2 else 0.5 * h
        at_x, at_d = dense.add_scaled_vector(x, k, ahead), dense.add_scaled(one, dk, ahead)
    return end_x, end_d


@jit
def _why(p: Array, t: float, length: float, x: Array) -> int:
    """The status of an interval over which the motion is not finite; see `LOST_ORBIT`.

    p, x: as of `exact_kernel`; t: its start, length, s.
    """
    for at in (t, t + length):
        motion = chief_motion(p, at)
        if not np.isfinite(motion[0] + motion[2]):
            return LOST_ORBIT
    r = chief_motion(p, t)[0]
    distance = np.sqrt((r + x[0]) ** 2 + x[1] ** 2 + x[2] ** 2)
    return max(length_status(distance, 0), _LEFT)


@jit
def exact_kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """Exact difference of two two-body motions, see `relative_acceleration`, plus white noise.

    p (7,): orbit (5,), acceleration density (m/s^1.5), longest step (s). u (rows, 1): dt, s. x,
    x_next (6,): r_tc_o (m), r_tc_o' in o (m/s). F, Q (6, 6), SI. Status: see `FAILURES`.
    """
    length = duration(u)
    steps = step_count(length, p[_MAX_STEP])
    h = length / steps
    state, total, noise = x, dense.identity(6), np.zeros((6, 6))
    for n in range(steps):
        give_way(n)
        state, step = exact_step(p, t + n * h, h, state)
        add_step(step, p[_DENSITY] ** 2, h, total, noise)
    if not (finite(total) and finite(state.reshape(1, 6))):
        return _why(p, t, length, x)
    dense.put_vector(x_next, 0, state)
    dense.put_block(F, 0, 0, total, 1.0)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@jit
def linear_kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """The motion under linear gravity: ``x_next = Phi(t, t + h) x``, Phi in closed form.

    p, u, x, x_next, F, Q: as of `exact_kernel`, (6,) and (6, 6), m and m/s. Steps serve the noise
    only: each adds that of constant velocity over its length. Phi: see
    `relnav_graph.maths.orbit.relative_transition`.
    """
    length = duration(u)
    steps = step_count(length, p[_MAX_STEP])
    h = length / steps
    total, noise = dense.identity(6), np.zeros((6, 6))
    for n in range(steps):
        give_way(n)
        step = relative_transition(p, t + n * h, t + (n + 1) * h)
        add_step(step, p[_DENSITY] ** 2, h, total, noise)
    if not finite(total):
        return _why(p, t, length, x)
    dense.put_vector(x_next, 0, dense.matvec(total, x))
    dense.put_block(F, 0, 0, total, 1.0)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class EccentricRelativeMotion(DynamicsModel):
    """Position and velocity of the chaser relative to the target, in the rotating frame.

    gravity = "linear": Zhang et al. 2015, eq. 1, whose transition matrix is known in
    closed form (`relnav_graph.maths.orbit.relative_transition`); it neglects 1.5 mu r^2 / R^4,
    2.5e-8 m/s^2 at 300 m in low orbit. gravity = "exact": the difference of the two
    two-body motions, of which the linear equations are the first order.

    acceleration_density: m/s^1.5, white, per axis; max_step: s, the longest step of the
    integration; relative_velocity is the derivative in the rotating frame.
    """

    kind: ClassVar[str] = "eccentric_relative_motion"
    noises: ClassVar[tuple[str, ...]] = ("acceleration_density", "acceleration_density")
    failures = FAILURES

    acceleration_density: Annotated[float, Quantity("m/s^1.5", positive=True)]
    orbit: KeplerOrbit
    gravity: Literal["exact", "linear"] = "exact"
    max_step: Annotated[float, Quantity("s", positive=True)] = 10.0

    @property
    def kernel(self) -> Kernel:  # type: ignore[override]
        return exact_kernel if self.gravity == "exact" else linear_kernel

    @property
    def advances(self) -> tuple[Block, ...]:
        return RELATIVE_POSITION, RELATIVE_VELOCITY

    def constants(self) -> Array:
        return np.array([*orbit_array(self.orbit), self.acceleration_density, self.max_step])
