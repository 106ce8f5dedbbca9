"""A chaser that turns with the target: passivity-based attitude tracking."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3
from relnav_graph.maths.inertia import check_inertia
from relnav_graph.sim.truths.attitude_dynamics import circular_orbit, gravity_gradient
from relnav_graph.units import Quantity, check_fields

__all__ = ["AttitudeTracking"]

CONTROL_ATTITUDE = Block("control_attitude", "R_tc", "SO3", 3, "rad", "tc", "deg")
CONTROL_RATE = Block("control_rate", "w_ct_c", "vector", 3, "rad/s", "c", "deg/s")


@jit
def free_acceleration(inertias: Array, target: Array, orbit: Array, t: float) -> Array:
    """w_ti_t' (3,), rad/s^2, by Euler's equations under the gravity gradient. inertias (3, 3, 3),
    target (7,), t: as of `tracking_torque`."""
    J_t, w_t = inertias[0], dense.vector_at(target, 4)
    gyration = so3.cross(w_t, dense.matvec(J_t, w_t))
    pull_t = gravity_gradient(orbit, J_t, t, target[0:4])
    return dense.matvec(inertias[1], dense.add_scaled_vector(pull_t, gyration, -1.0))


@jit
def tracking_torque(
    gains: Array,
    inertias: Array,
    target: Array,
    desired: Array,
    chaser: Array,
    orbit: Array,
    t: float,
) -> Array:
    """The torque (3,), N m, in c, at time t, s. gains: lambda, k (1/s); inertias (3, 3, 3):
    J_t, its inverse, J_c; target, chaser (7,): attitude in i as q_wxyz and rate in own axes;
    desired (3,): w_ti_t', rad/s^2."""
    J_c = inertias[2]
    R_ic = so3.from_quaternion(chaser[0:4])
    R_ct = dense.transposed_matmul(R_ic, so3.from_quaternion(target[0:4]))
    w_t, w_c = dense.vector_at(target, 4), dense.vector_at(chaser, 4)
    q_tc = so3.quaternion(dense.transposed_matmul(R_ct, dense.identity(3)))  # its sign is +
    aim = dense.matvec(R_ct, w_t)
    pull_c = gravity_gradient(orbit, J_c, t, chaser[0:4])
    a_t = dense.matvec(R_ct, desired)
    e, error = dense.vector_at(q_tc, 1), dense.add_scaled_vector(w_c, aim, -1.0)
    turning, sideways = so3.cross(e, error), so3.cross(error, aim)
    w_r, a_r, s = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        w_r[i] = aim[i] - gains[0] * e[i]
        s[i] = w_c[i] - w_r[i]
        a_r[i] = a_t[i] - sideways[i] - 0.5 * gains[0] * (q_tc[0] * error[i] + turning[i])
        a_r[i] -= gains[1] * s[i]
    torque = dense.matvec(J_c, a_r)
    gyration = so3.cross(w_r, dense.matvec(J_c, w_c))
    for i in range(3):
        torque[i] += gyration[i] - pull_c[i]
    return torque


def _pose(attitude: Array, rate: Array) -> Array:
    """(7,): an attitude (3, 3) as q_wxyz, and a rate (3,)."""
    return np.concatenate([so3.quaternion(np.ascontiguousarray(attitude)), rate])


@dataclass(frozen=True, eq=False, kw_only=True)
class AttitudeTracking:
    """Brings the chaser's axes onto the target's and keeps them there.

    With s = w_c - w_r and w_r = R_ct w_t - lambda e, e the vector part of the quaternion of
    R_tc: torque = -k J_c s + J_c w_r' + w_r x J_c w_c - gravity gradient on the chaser
    (Egeland and Godhavn 1994, without adaptation; Thienel et al. 2006, section IV; their K_D
    is k J_c here). acceleration: whence the target's angular acceleration. "euler": from its
    estimated attitude and rate by Euler's equations, so that the noise of an observer's innovations
    is left out; "observer": as an observer gives it, the derivative of its rate, as the paper has
    it; by Euler's equations, with which they predict, of estimators that give none.

    start: s; semi_major_axis (m), inclination, raan, argument_of_latitude (rad, at the epoch, s):
    the orbit;
    attitude_gain lambda, rate_gain k: 1/s; target_inertia, chaser_inertia: kg m^2. The
    chaser's own attitude and rate are known exactly, as from a star tracker and calibrated
    gyros.

    Raises InputError on an inertia that no body has.
    """

    kind: ClassVar[str] = "attitude_tracking"
    reads: ClassVar[tuple[str, ...]] = ("target_attitude", "target_rate")
    besides: ClassVar[tuple[str, ...]] = ("target_acceleration",)
    own: ClassVar[tuple[str, ...]] = ("chaser_attitude", "chaser_rate")
    controlled: ClassVar[tuple[Block, ...]] = (CONTROL_ATTITUDE, CONTROL_RATE)

    semi_major_axis: Annotated[float, Quantity("m", positive=True)]
    target_inertia: Annotated[Array, Quantity("kg*m^2", (3, 3))]
    chaser_inertia: Annotated[Array, Quantity("kg*m^2", (3, 3))]
    attitude_gain: Annotated[float, Quantity("1/s", positive=True)]
    rate_gain: Annotated[float, Quantity("1/s", positive=True)]
    start: Annotated[float, Quantity("s", nonnegative=True)] = 0.0
    inclination: Annotated[float, Quantity("rad")] = 0.0
    raan: Annotated[float, Quantity("rad")] = 0.0
    argument_of_latitude: Annotated[float, Quantity("rad")] = 0.0
    epoch: Annotated[float, Quantity("s")] = 0.0
    acceleration: Literal["euler", "observer"] = "euler"

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("target_inertia", "chaser_inertia"):
            check_inertia(f"AttitudeTracking.{name}", getattr(self, name))

    @cached_property
    def _orbit(self) -> Array:
        elements = self.semi_major_axis, self.inclination, self.raan, self.argument_of_latitude
        return circular_orbit(*elements, self.epoch, 0.0)

    @cached_property
    def _gains_and_inertias(self) -> tuple[Array, Array]:
        J_t, J_c = self.target_inertia, self.chaser_inertia
        inertias = np.array([J_t, np.linalg.inv(J_t), J_c])
        return np.array([self.attitude_gain, self.rate_gain]), inertias

    def command(self, t: float, estimate: Mapping[str, Array], own: Mapping[str, Array]) -> Array:
        """Torque on the chaser (3,), N m, in c."""
        gains, inertias = self._gains_and_inertias
        target = _pose(estimate["target_attitude"], estimate["target_rate"])
        desired = estimate.get("target_acceleration") if self.acceleration == "observer" else None
        if desired is None:
            desired = free_acceleration(inertias, target, self._orbit, t)
        chaser = _pose(own["chaser_attitude"], own["chaser_rate"])
        found: Array = tracking_torque(gains, inertias, target, desired, chaser, self._orbit, t)
        return found

    def control_errors(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """R_tc (N, 3, 3) and the rate of c relative to t, in c, rad/s, (N, 3)."""
        R_tc = np.swapaxes(values["target_attitude"], 1, 2) @ values["chaser_attitude"]
        turned = np.einsum("nji,nj->ni", R_tc, values["target_rate"])
        return {"control_attitude": R_tc, "control_rate": values["chaser_rate"] - turned}
