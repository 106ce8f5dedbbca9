"""Rotation of a target of known inertia under the gravity gradient of its orbit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.dynamics.euler_rotation import MAX_STEP, EulerRotation
from relnav_factors.dynamics.euler_rotation import known_kernel as free_rotation
from relnav_factors.shared.statuses import LOST_ORBIT, ROTATION_FAILURES, TOO_FAST, finite
from relnav_factors.shared.white_noise import duration, step_count
from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.catalogue import TARGET_ATTITUDE, TARGET_RATE
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion
from relnav_graph.units import Quantity

#: Where the numbers of the kernel stand in p, after the orbit (5,).
_PERIFOCAL, _INERTIA, _INVERSE, _FREE = 5, 14, 23, 32


@jit
def gradient_torque(p: Array, t: float, R_it: Array) -> tuple[Array, Array]:
    """``3 mu / r^3 u x J u``, u the unit vector from the Earth's centre (Hughes 1986, section 8.1).

    p (59,): orbit (5,), R_ip (9): its perifocal axes, J (9), kg m^2, J^-1 (9), then the (27,) of
    `EulerRotation`; t: s; R_it: (3, 3). Returns the torque (3,) in t, N m, and its Jacobian (3, 3),
    N m/rad, to a right perturbation ``R_it Exp(d)``.
    """
    motion, J = chief_motion(p, t), dense.matrix_at(p, _INERTIA)
    R_ip, u_i = dense.matrix_at(p, _PERIFOCAL), np.empty(3)
    for i in range(3):
        u_i[i] = np.cos(motion[2]) * R_ip[i, 0] + np.sin(motion[2]) * R_ip[i, 1]
    u = dense.transposed_matvec(R_it, u_i)
    scale, Ju, turned = 3 * p[3] / motion[0] ** 3, dense.matvec(J, u), so3.skew(u)
    # d(u) = u x d: d(u x J u) = ([u x] J - [J u x]) [u x] d.
    slope = dense.add_scaled(dense.matmul(turned, J), so3.skew(Ju), -1.0)
    slope = dense.matmul(slope, turned)
    torque = so3.cross(u, Ju)
    for i in range(3):
        torque[i] *= scale
        for j in range(3):
            slope[i, j] *= scale
    return torque, slope


@jit
def _kick(p: Array, t: float, h: float, R_it: Array, w: Array, total: Array) -> Array:
    """The rate (3,), rad/s, after the torque of time t has acted for h seconds.

    w: (3,), rad/s, before; total: (6, n), sensitivities of attitude and rate, brought up to date in
    place.
    """
    torque, slope = gradient_torque(p, t, R_it)
    inverse = dense.matrix_at(p, _INVERSE)
    slope = dense.matmul(inverse, slope)
    for j in range(total.shape[1]):
        for i in range(3):
            for k in range(3):
                total[3 + i, j] += h * slope[i, k] * total[k, j]
    return dense.add_scaled_vector(w, dense.matvec(inverse, torque), h)


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``J w' = -w x J w + 3 mu / r^3 u x J u`` by splitting (Strang 1968), of second order.

    p (59,): as of `gradient_torque`; its longest step, s, among them. u (rows, 1): dt, s. x, x_next
    (12,): R_it row by row, w_ti_t (rad/s). F, Q (6, 6), in rad and rad/s.

    In each step the torque acts at both ends, for half the step each time, with a free rotation
    between: exact but for how the torque changes within a step.
    """
    length = duration(u)
    steps = step_count(length, p[_FREE + MAX_STEP])
    h = length / steps
    free, one, y = p[_FREE:], np.array([[h]]), x.copy()
    total, noise = dense.identity(6), np.zeros((6, 6))
    step_F, step_Q, after = np.empty((6, 6)), np.empty((6, 6)), np.empty(12)
    for n in range(steps):
        give_way(n)
        kicked = dense.identity(6)
        w = _kick(p, t + n * h, 0.5 * h, dense.matrix_at(y, 0), dense.vector_at(y, 9), kicked)
        dense.put_vector(y, 9, w)
        if not finite(w.reshape(1, 3)):
            return TOO_FAST if np.isfinite(chief_motion(p, t + n * h)[2]) else LOST_ORBIT
        status = free_rotation(free, t + n * h, one, y, after, step_F, step_Q)
        if status != 0:
            return status
        kicked = dense.matmul(step_F, kicked)
        last = dense.identity(6)
        R_it, w = dense.matrix_at(after, 0), dense.vector_at(after, 9)
        w = _kick(p, t + (n + 1) * h, 0.5 * h, R_it, w, last)
        dense.put_vector(after, 9, w)
        step = dense.matmul(last, kicked)
        total = dense.matmul(step, total)
        added = dense.propagate_covariance(last, step_Q)
        noise = dense.add_scaled(dense.propagate_covariance(step, noise), added, 1.0)
        for i in range(12):
            y[i] = after[i]
    if not (finite(total) and finite(y.reshape(1, 12))):
        return TOO_FAST if np.isfinite(chief_motion(p, t + length)[2]) else LOST_ORBIT
    for i in range(12):
        x_next[i] = y[i]
    dense.put_block(F, 0, 0, total, 1.0)
    dense.put_block(Q, 0, 0, noise, 1.0)
    return 0


@dataclass(frozen=True, kw_only=True)
class GravityGradientRotation(DynamicsModel):
    """Attitude and rate of a rigid target of known inertia on a known orbit.

    R_it' = R_it [w_ti_t x]; J w' = -w x J w + 3 mu / r^3 u x J u + white (Thienel et al.
    2006, section III, with the torque that they call estimated). o does not rotate: it is i.

    torque_density: rad/s^1.5, of the angular acceleration per axis, for torques that are not
    known (drag); known_inertia: J about the axes of t, kg m^2. semi_major_axis (m),
    eccentricity, true_anomaly, inclination, raan, argument_of_perigee (rad): orbit, of which the
    anomaly holds at the epoch, s; mu: m^3/s^2; max_step: s, the longest step.

    Raises InputError on an inertia that no body has, or an orbit that does not exist.
    """

    kind: ClassVar[str] = "gravity_gradient_rotation"
    #: o does not turn.
    orbit: ClassVar[None] = None
    noises: ClassVar[tuple[str, ...]] = ("torque_density", "torque_density")
    kernel = staticmethod(kernel)
    failures = ROTATION_FAILURES

    torque_density: Annotated[float, Quantity("rad/s^1.5", positive=True)]
    known_inertia: Annotated[Array, Quantity("kg*m^2", (3, 3))]
    semi_major_axis: Annotated[float, Quantity("m")]
    eccentricity: Annotated[float, Quantity("1", nonnegative=True)] = 0.0
    true_anomaly: Annotated[float, Quantity("rad")] = 0.0
    inclination: Annotated[float, Quantity("rad")] = 0.0
    raan: Annotated[float, Quantity("rad")] = 0.0
    argument_of_perigee: Annotated[float, Quantity("rad")] = 0.0
    mu: Annotated[float, Quantity("m^3/s^2", positive=True)] = MU_EARTH
    epoch: Annotated[float, Quantity("s")] = 0.0
    max_step: Annotated[float, Quantity("s", positive=True)] = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "_numbers", self._constants())

    @property
    def inertial_orbit(self) -> KeplerOrbit:
        """The orbit in its plane. Raises InputError when there is none such."""
        elements = self.semi_major_axis, self.eccentricity, self.true_anomaly
        return KeplerOrbit(*elements, self.mu, self.epoch)

    @property
    def free(self) -> EulerRotation:
        """The same body without the torque. Raises InputError as it does."""
        return EulerRotation(
            torque_density=self.torque_density,
            inertia="known",
            known_inertia=self.known_inertia,
            max_step=self.max_step,
        )

    @property
    def advances(self) -> tuple[Block, ...]:
        return TARGET_ATTITUDE, TARGET_RATE

    def caution(self, length: float, *x: Array) -> str:
        """As of a free rotation: half a turn between epochs is aliased."""
        return self.free.caution(length, *x)

    def constants(self) -> Array:
        return self._numbers  # type: ignore[attr-defined,no-any-return]

    def _constants(self) -> Array:
        z, x = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
        R_ip = so3.exp(self.raan * z) @ so3.exp(self.inclination * x)
        R_ip = R_ip @ so3.exp(self.argument_of_perigee * z)
        J = self.known_inertia
        rest = [R_ip.ravel(), J.ravel(), np.linalg.inv(J).ravel(), self.free.constants()]
        return np.concatenate([self.inertial_orbit.array(), *rest])

    def torque(self, t: float, R_it: Array) -> Array:
        """The known torque (3,) at time t, s, in t, N m."""
        return gradient_torque(self.constants(), t, np.ascontiguousarray(R_it))[0]

    def directions(self, *x: Array) -> dict[str, tuple[Array, ...]]:
        """What a steady spin hides."""
        return self.free.directions(*x)
