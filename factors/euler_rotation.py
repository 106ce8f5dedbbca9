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

Array = NDArray[np.float64]


@jit
def inertia_ratios(k: Array) -> tuple[Array, Array]:
    """l = tanh(k_x, k_y, -(k_x + k_y)), (3,), and its Jacobian to (k_x, k_y), (3, 2)."""
    l = np.array([np.tanh(k[0]), np.tanh(k[1]), -np.tanh(k[0] + k[1])])
    jacobian = np.zeros((3, 2))
    jacobian[0, 0] = 1 - l[0] ** 2
    jacobian[1, 1] = 1 - l[1] ** 2
    jacobian[2, 0] = jacobian[2, 1] = l[2] ** 2 - 1
    return l, jacobian


@jit
def euler_acceleration(w: Array, k: Array) -> tuple[Array, Array]:
    """w' (3,) of a torque-free body, and its Jacobian to (w, k), (3, 5)."""
    l, dl = inertia_ratios(k)
    out = np.empty(3)
    jacobian = np.zeros((3, 5))
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        out[i] = l[i] * w[j] * w[m]
        jacobian[i, j] = l[i] * w[m]
        jacobian[i, m] = l[i] * w[j]
        jacobian[i, 3] = dl[i, 0] * w[j] * w[m]
        jacobian[i, 4] = dl[i, 1] * w[j] * w[m]
    return out, jacobian


@jit
def rate_step(w: Array, k: Array, h: float) -> tuple[Array, Array, Array, Array]:
    """One Runge-Kutta step of the rate: w (3,) and turn (3,) over h seconds, with their
    Jacobians to (w, k), (3, 5) each, which are exact for the step as computed.

    The turn is Magnus' series to fourth order: the mean rate, with the midpoint from the
    Hermite polynomial, and the coning term (w0 x w1) h^2 / 12.
    """
    start = np.zeros((3, 5))
    start[:, :3] = np.eye(3)
    rate, drate = w, start
    slope, dslope = np.zeros(3), np.zeros((3, 5))
    first, dfirst = np.zeros(3), np.zeros((3, 5))
    for stage in range(4):
        a, da = euler_acceleration(rate, k)
        chained = so3.multiply(np.ascontiguousarray(da[:, :3]), drate)
        chained[:, 3:] += da[:, 3:]
        if stage == 0:
            first, dfirst = a, chained
        weight = (1.0 if stage in (0, 3) else 2.0) / 6
        slope = slope + weight * a
        dslope = dslope + weight * chained
        ahead = h if stage == 2 else 0.5 * h
        rate, drate = w + ahead * a, start + ahead * chained
    w1, dw1 = w + h * slope, start + h * dslope
    last, da = euler_acceleration(w1, k)
    dlast = so3.multiply(np.ascontiguousarray(da[:, :3]), dw1)
    dlast[:, 3:] += da[:, 3:]
    turn = h / 2 * (w + w1) + h * h / 12 * (first - last + so3.cross(w, w1))
    coning = so3.multiply(so3.skew(w), dw1) - so3.multiply(so3.skew(w1), start)
    dturn = h / 2 * (start + dw1) + h * h / 12 * (dfirst - dlast + coning)
    return w1, turn, dw1, dturn


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """x = (R_ot, w_ti_t, k). Steps of at most p[6] seconds."""
    orbit, torque2, inertia2 = p[:4], p[4] ** 2, p[5] ** 2
    duration = u[:, 0].sum()
    steps = max(1, int(np.ceil(duration / p[6] - 1e-9)))
    h = duration / steps
    R_ot = x[:9].copy().reshape(3, 3)
    w, k = x[9:12].copy(), x[12:14]
    total, noise, step = np.eye(8), np.zeros((8, 8)), np.eye(8)
    for _ in range(steps):
        w, turn, dw, dturn = rate_step(w, k, h)
        R_ot = so3.multiply(R_ot, so3.exp(turn))
        step[:3, :3] = so3.exp(-turn)
        step[:3, 3:] = so3.multiply(so3.right_jacobian(turn), dturn)
        step[3:6, 3:] = dw
        total = so3.multiply(step, total)
        noise = so3.multiply(so3.multiply(step, noise), np.ascontiguousarray(step.T))
        for i in range(3):
            noise[i, i] += torque2 * h**3 / 3
            noise[i, 3 + i] += torque2 * h**2 / 2
            noise[3 + i, i] += torque2 * h**2 / 2
            noise[3 + i, 3 + i] += torque2 * h
        for i in range(6, 8):
            noise[i, i] += inertia2 * h
    R_ot = so3.multiply(frame_rotation(orbit, t, t + duration), R_ot)
    x_next[:9] = so3.project(R_ot).reshape(9)
    x_next[9:12] = w
    x_next[12:14] = k
    F[:, :] = total
    Q[:, :] = noise
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
