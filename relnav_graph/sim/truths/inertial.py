"""Truths in axes that do not rotate: a body of any inertia, alone or beside a chaser.

Nothing here is shared with the models of the estimators. The body is integrated about its
principal axes (`relnav_graph.sim.truths.integrate`), whatever the axes that it is described in.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.steps import check_steps
from relnav_graph.core.track import Truth
from relnav_graph.maths import dense, so3
from relnav_graph.maths.inertia import check_inertia, inertia_parameters, principal_moments
from relnav_graph.memory import check_room
from relnav_graph.sim.truths.integrate import STATE_SIZE, integrate
from relnav_graph.sim.truths.rigid_body_pair import OrbitElements, checked_times
from relnav_graph.units import Quantity, check_fields

__all__ = ["InertialPair", "TumblingBody", "inertia_parameters"]

#: Position and velocity of a body whose orbit does not matter.
_ANYWHERE = np.array([7e6, 0.0, 0.0, 0.0, 7.5e3, 0.0, *[0.0] * 6])


def _zeros() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False, kw_only=True)
class TumblingBody:
    """A free rigid body seen from axes o that do not rotate. All holds at t = 0.

    target_inertia: J about the axes of t, any symmetric matrix that a body can have,
    kg m^2; target_rate: w_ti_t, rad/s; target_attitude: R_ot as a rotation vector, rad;
    torque_density: white angular acceleration per axis, rad/s^1.5; max_step: longest
    integration step, s.

    Raises InputError on an inertia that no body has.
    """

    kind: ClassVar[str] = "tumbling_body"
    leaves_out: ClassVar[str] = "gravity-gradient torque, flexibility"

    target_inertia: Annotated[Array, Quantity("kg*m^2", (3, 3))]
    target_rate: Annotated[Array, Quantity("rad/s", (3,))]
    target_attitude: Annotated[Array, Quantity("rad", (3,))] = field(default_factory=_zeros)
    torque_density: Annotated[float, Quantity("rad/s^1.5", nonnegative=True)] = 0.0
    max_step: Annotated[float, Quantity("s", positive=True)] = 0.25

    def __post_init__(self) -> None:
        check_fields(self)
        check_inertia(f"{type(self).__name__}.target_inertia", self.target_inertia)

    def simulate(self, times: Array, rng: np.random.Generator) -> Truth:
        """Truth at `times` (N,), s: increasing, the first not before t = 0.

        Values: target_attitude R_ot (N, 3, 3), target_rate (N, 3), and
        inertia_matrix_parameters (N, 5). Raises InputError on times out of order.
        """
        t = checked_times(times)
        return Truth(t, self._rotation_values(self._integrate(t, _ANYWHERE, rng)), self._source())

    def mean_rate(self, t_start: Array, t_end: Array) -> Array:
        """Mean of w_ci_c (n, 3), rad/s: the axes that the body is seen from do not turn."""
        return np.zeros((len(t_start), 3))

    def _source(self) -> str:
        return (
            f"{self.kind}: integrated in an inertial frame, the rigid target about its"
            f" principal axes with white torque. Not modelled: {self.leaves_out}"
        )

    def _densities(self) -> tuple[float, float]:
        """Of the angular acceleration and of the relative acceleration."""
        return self.torque_density, 0.0

    def _kick(self, y: Array, dt: float, rng: np.random.Generator) -> None:
        """Random part of the state's change, added at the end of dt seconds."""

    def _integrate(self, t: Array, craft: Array, rng: np.random.Generator) -> Array:
        """States y (N, 19) from the two craft's state (12,) at t = 0; see `integrate`."""
        moments, R_tp = principal_moments(self.target_inertia)
        p = np.array([MU_EARTH, *(moments.sum() - moments)])
        q_ip = so3.quaternion(so3.exp(self.target_attitude.copy()) @ R_tp)
        y, out = np.array([*craft, *q_ip, *(R_tp.T @ self.target_rate)]), np.empty((1, STATE_SIZE))
        found, density = [], np.repeat(self._densities(), 3)
        for dt in np.diff(t, prepend=0.0):
            check_steps("truth", float(dt), self.max_step)
            steps = np.ceil(dt / self.max_step * (1 - 1e-12))
            check_room(f"truth.max_step {self.max_step} s, {steps:.3g} steps", 6 * steps)
            count = int(steps)
            h = dt / max(count, 1)
            disturbance = rng.standard_normal((count, 6)) * density / np.sqrt(h or 1.0)
            if count:
                integrate(p, y, np.array([count]), np.array([h]), disturbance, out)
                y = out[0].copy()
                self._kick(y, dt, rng)
            found.append(y.copy())
        return np.array(found)

    def _rotation_values(self, y: Array) -> dict[str, Array]:
        R_tp = principal_moments(self.target_inertia)[1]
        R_ip = dense.stacked((so3.from_quaternion(q) for q in y[:, 12:16]), 3, 3)
        return {
            "target_attitude": R_ip @ R_tp.T,
            "target_rate": y[:, 16:19] @ R_tp.T,
            "inertia_matrix_parameters": np.tile(
                inertia_parameters(self.target_inertia), (len(y), 1)
            ),
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class InertialPair(TumblingBody, OrbitElements):
    """A chaser on a two-body orbit near a tumbling target; o is the inertial frame.

    semi_major_axis to argument_of_perigee (see
    `relnav_graph.sim.truths.rigid_body_pair.OrbitElements`): orbit of the chaser.
    relative_position: r_tc, m, and relative_velocity, m/s, its derivative there, in RTN axes of
    the chaser's orbit. chaser_attitude: R_ic as a rotation vector, rad; chaser_rate: w_ci_c,
    rad/s, constant.

    relative_acceleration_density: white acceleration of the relative motion per axis,
    m/s^1.5. position_density (m/sqrt(s)) and acceleration_density (m/s^1.5): noise of the
    orbit that both craft share, drawn at the epochs.

    Raises InputError on an orbit that is not an ellipse and on an inertia that no body has.
    """

    kind: ClassVar[str] = "inertial_pair"
    leaves_out: ClassVar[str] = "oblateness, drag, solar pressure, third bodies, " + (
        TumblingBody.leaves_out
    )

    relative_position: Annotated[Array, Quantity("m", (3,))]
    relative_velocity: Annotated[Array, Quantity("m/s", (3,))] = field(default_factory=_zeros)
    chaser_attitude: Annotated[Array, Quantity("rad", (3,))] = field(default_factory=_zeros)
    chaser_rate: Annotated[Array, Quantity("rad/s", (3,))] = field(default_factory=_zeros)
    relative_acceleration_density: Annotated[float, Quantity("m/s^1.5", nonnegative=True)] = 0.0
    position_density: Annotated[float, Quantity("m/sqrt(s)", nonnegative=True)] = 0.0
    acceleration_density: Annotated[float, Quantity("m/s^1.5", nonnegative=True)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._craft()  # it refuses what is no ellipse

    def _craft(self) -> Array:
        """(12,): position and velocity of the chaser, then those of the target relative to
        it, in i at t = 0: the orbit that has noise of its own is integrated itself."""
        return self.initial_orbits(-self.relative_position, -self.relative_velocity)

    def simulate(self, times: Array, rng: np.random.Generator) -> Truth:
        """Truth at `times` (N,), s: increasing, the first not before t = 0.

        Values beside those of the body: chaser_attitude R_ic (N, 3, 3), chaser_position,
        chaser_velocity, relative_position r_tc, relative_velocity, all in i, and chaser_rate
        w_ci_c (N, 3). Raises InputError on times out of order.
        """
        t = checked_times(times)
        y = self._integrate(t, self._craft(), rng)
        turns = dense.stacked((so3.exp(self.chaser_rate * s) for s in t), 3, 3)
        values = self._rotation_values(y) | {
            "chaser_attitude": so3.exp(self.chaser_attitude.copy()) @ turns,
            "chaser_position": y[:, 0:3].copy(),
            "chaser_velocity": y[:, 3:6].copy(),
            "relative_position": -y[:, 6:9],
            "relative_velocity": -y[:, 9:12],
            "chaser_rate": np.tile(self.chaser_rate, (len(t), 1)),
        }
        return Truth(t, values, self._source())

    def mean_rate(self, t_start: Array, t_end: Array) -> Array:
        """Mean of w_ci_c over each interval (n, 3), rad/s. Exact: the rate is constant."""
        return np.tile(self.chaser_rate, (len(t_start), 1))

    def _densities(self) -> tuple[float, float]:
        return self.torque_density, self.relative_acceleration_density

    def _kick(self, y: Array, dt: float, rng: np.random.Generator) -> None:
        """White noise of velocity and acceleration of the shared orbit over dt seconds."""
        walk, white, area = rng.standard_normal((3, 3))
        # The end of a Brownian path and, given it, the area below it.
        velocity = self.acceleration_density * np.sqrt(dt) * white
        position = 0.5 * dt * velocity + self.acceleration_density * np.sqrt(dt**3 / 12) * area
        y[0:3] += position + self.position_density * np.sqrt(dt) * walk
        y[3:6] += velocity
