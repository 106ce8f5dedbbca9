"""Free rotation of the target: attitude, rate and inertia ratios."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit
from relnav_graph.models import DynamicsModel
from relnav_graph.orbit import KeplerOrbit, frame_rotation, orbit_array
from relnav_graph.state import INERTIA, TARGET_ATTITUDE, TARGET_RATE, Block
from relnav_graph.units import Quantity

from ._white_noise import add_integrated_white_noise, duration, step_count

Array = NDArray[np.float64]


@jit
def inertia_ratios(k: Array) -> tuple[Array, Array]:
    """l = tanh(k_x, k_y, -(k_x + k_y)), (3,), and its Jacobian to (k_x, k_y), (3, 2)."""
    l, jacobian = np.empty(3), np.zeros((3, 2))
    l[0], l[1], l[2] = np.tanh(k[0]), np.tanh(k[1]), -np.tanh(k[0] + k[1])
    jacobian[0, 0] = 1 - l[0] ** 2
    jacobian[1, 1] = 1 - l[1] ** 2
    jacobian[2, 0] = jacobian[2, 1] = l[2] ** 2 - 1
    return l, jacobian


@jit
def euler_acceleration(w: Array, k: Array) -> tuple[Array, Array, Array]:
    """w' (3,) of a torque-free body, and its Jacobians to w (3, 3) and to k (3, 2)."""
    l, dl = inertia_ratios(k)
    out, to_w, to_k = np.empty(3), np.zeros((3, 3)), np.empty((3, 2))
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        out[i] = l[i] * w[j] * w[m]
        to_w[i, j] = l[i] * w[m]
        to_w[i, m] = l[i] * w[j]
        for n in range(2):
            to_k[i, n] = dl[i, n] * w[j] * w[m]
    return out, to_w, to_k


@jit
def _chained(to_w: Array, to_k: Array, dw: Array) -> Array:
    """The Jacobian to (w0, k), (3, 5), of a function of (w, k), with dw that of w."""
    out = so3.multiply(to_w, dw)
    for i in range(3):
        out[i, 3] += to_k[i, 0]
        out[i, 4] += to_k[i, 1]
    return out


@jit
def rate_step(w: Array, k: Array, h: float) -> tuple[Array, Array, Array, Array]:
    """One Runge-Kutta step of the rate: w (3,) and turn (3,) over h seconds, with their
    Jacobians to (w, k), (3, 5) each, which are exact for the step as computed.

    The turn is Magnus' series to fourth order: the mean rate, with the midpoint from the
    Hermite polynomial, and the coning term (w0 x w1) h^2 / 12.
    """
    start = np.zeros((3, 5))
    start[0, 0] = start[1, 1] = start[2, 2] = 1.0
    first, to_w, to_k = euler_acceleration(w, k)
    dfirst = _chained(to_w, to_k, start)
    w1, dw1 = so3.add_vector(w, first, h / 6), so3.add(start, dfirst, h / 6)
    a, da = first, dfirst
    for stage in range(1, 4):
        ahead = h if stage == 3 else 0.5 * h
        rate, drate = so3.add_vector(w, a, ahead), so3.add(start, da, ahead)
        a, to_w, to_k = euler_acceleration(rate, k)
        da = _chained(to_w, to_k, drate)
        weight = h / 6 if stage == 3 else h / 3
        w1, dw1 = so3.add_vector(w1, a, weight), so3.add(dw1, da, weight)
    last, to_w, to_k = euler_acceleration(w1, k)
    dlast = _chained(to_w, to_k, dw1)
    coning = so3.cross(w, w1)
    dconing = so3.add(so3.multiply(so3.skew(w), dw1), so3.multiply(so3.skew(w1), start), -1.0)
    turn, dturn = np.empty(3), np.empty((3, 5))
    for i in range(3):
        turn[i] = h / 2 * (w[i] + w1[i]) + h * h / 12 * (first[i] - last[i] + coning[i])
        for j in range(5):
            bent = dfirst[i, j] - dlast[i, j] + dconing[i, j]
            dturn[i, j] = h / 2 * (start[i, j] + dw1[i, j]) + h * h / 12 * bent
    return w1, turn, dw1, dturn


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """x = (R_ot, w_ti_t, k). Steps of at most p[6] seconds."""
    length = duration(u)
    steps = step_count(length, p[6])
    h = length / steps
    R_ot, w, k = so3.matrix_at(x, 0), so3.vector_at(x, 9), np.empty(2)
    k[0], k[1] = x[12], x[13]
    total, noise, step = so3.identity(8), np.zeros((8, 8)), so3.identity(8)
    for _ in range(steps):
        w, turn, dw, dturn = rate_step(w, k, h)
        ahead = so3.exp(turn)
        R_ot = so3.multiply(R_ot, ahead)
        for i in range(3):
            for j in range(3):
                step[i, j] = ahead[j, i]
        so3.put(step, 0, 3, so3.multiply(so3.right_jacobian(turn), dturn), 1.0)
        so3.put(step, 3, 3, dw, 1.0)
        total = so3.multiply(step, total)
        noise = so3.propagate_covariance(step, noise)
        add_integrated_white_noise(noise, 0, p[4] ** 2, h)
        for i in range(6, 8):
            noise[i, i] += p[5] ** 2 * h
    R_ot = so3.multiply(frame_rotation(p, t, t + length), R_ot)
    so3.put_matrix(x_next, 0, so3.project(R_ot))
    so3.put_vector(x_next, 9, w)
    so3.put_vector(x_next, 12, k)
    so3.put(F, 0, 0, total, 1.0)
    so3.put(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class EulerRotation(DynamicsModel):
    """Attitude, rate and principal inertia of a free rigid target.

    R_ot' = R_ot [w_ti_t x] - [w_oi_o x] R_ot; w_x' = l_x w_y w_z + white, cyclic
    (Zhang et al. 2015, section 3; Euler's equations). The ratios l = tanh(k) stand in
    the state as k: see `relnav_graph.state.INERTIA`. The target's axes are its principal
    axes; torques are white.

    torque_density: rad/s^1.5, angular acceleration per axis; inertia_density: 1/sqrt(s),
    a small random walk that keeps the covariance regular; max_step: s, the longest
    Runge-Kutta step; orbit: the target's, None where o does not rotate.
    """

    kind: ClassVar[str] = "euler_rotation"
    kernel = staticmethod(kernel)

    torque_density: Annotated[float, Quantity("rad/s^1.5", positive=True)]
    inertia_density: Annotated[float, Quantity("1/sqrt(s)", positive=True)] = 1e-8
    max_step: Annotated[float, Quantity("s", positive=True)] = 1.0
    orbit: KeplerOrbit | None = None

    @property
    def advances(self) -> tuple[Block, ...]:
        return TARGET_ATTITUDE, TARGET_RATE, INERTIA

    def caution(self, length: float, *x: Array) -> str:
        """Half a turn or more between epochs looks like the rest of a turn backwards."""
        turn = float(np.linalg.norm(x[1])) * length
        if turn < 0.98 * np.pi:
            return ""
        return f"the target turns {np.degrees(turn):.0f} deg in {length:g} s: aliased from 180 deg"

    def constants(self) -> Array:
        own = [self.torque_density, self.inertia_density, self.max_step]
        return np.concatenate([orbit_array(self.orbit), own])


@dataclass(frozen=True)
class InertiaRatios:
    """(J_y - J_z) / J_x and cyclic, of the target's principal moments."""

    kind: ClassVar[str] = "inertia_ratios"
    block: ClassVar[Block] = Block("inertia_ratios", "l_t", "vector", 3, "1", "t", "1")
    reads: ClassVar[tuple[Block, ...]] = (INERTIA,)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """l (3,) and its Jacobian (3, 2)."""
        return inertia_ratios(np.ascontiguousarray(x[0]))
