"""Truth for attitude control: a rigid chaser, which takes torques, beside a rigid target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.steps import check_steps
from relnav_graph.core.track import Truth
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.maths.inertia import check_inertia
from relnav_graph.sim.truths.attitude_dynamics import advance, circular_orbit
from relnav_graph.sim.truths.rigid_body_pair import checked_times
from relnav_graph.units import Quantity, check_fields

__all__ = ["ControlledBodies"]


def _zeros() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False, kw_only=True)
class ControlledBodies:
    """Rigid target and chaser on one circular orbit; commands are torques on the chaser.

    o does not rotate (it is i). Gravity gradient and drag turn both bodies; how far they are
    from each other does not matter. All holds at the start, but the argument of latitude at the
    epoch.

    semi_major_axis (m), inclination, raan, argument_of_latitude (rad), epoch (s): the orbit.
    target_inertia, chaser_inertia: kg m^2, about the axes of t and c. target_attitude,
    chaser_attitude: R_it and R_ic as rotation vectors, rad; random_attitude: the target's is
    drawn, uniform over all. target_rate, chaser_rate: w_ti_t and w_ci_c, rad/s;
    target_rate_sigma: per axis, of what is drawn and added to the target's, rad/s.
    atmosphere: its density, kg/m^3; drag_coefficient; target_faces, chaser_faces: areas
    across the body's axes, m^2; target_pressure_centre, chaser_pressure_centre: from the
    centre of mass, m.
    max_step: longest integration step, s.

    Raises InputError on an inertia that no body has.
    """

    kind: ClassVar[str] = "controlled_bodies"

    semi_major_axis: Annotated[float, Quantity("m", positive=True)]
    target_inertia: Annotated[Array, Quantity("kg*m^2", (3, 3))]
    chaser_inertia: Annotated[Array, Quantity("kg*m^2", (3, 3))]
    inclination: Annotated[float, Quantity("rad")] = 0.0
    raan: Annotated[float, Quantity("rad")] = 0.0
    argument_of_latitude: Annotated[float, Quantity("rad")] = 0.0
    epoch: Annotated[float, Quantity("s")] = 0.0
    target_attitude: Annotated[Array, Quantity("rad", (3,))] = field(default_factory=_zeros)
    random_attitude: bool = False
    target_rate: Annotated[Array, Quantity("rad/s", (3,))] = field(default_factory=_zeros)
    target_rate_sigma: Annotated[float, Quantity("rad/s", nonnegative=True)] = 0.0
    chaser_attitude: Annotated[Array, Quantity("rad", (3,))] = field(default_factory=_zeros)
    chaser_rate: Annotated[Array, Quantity("rad/s", (3,))] = field(default_factory=_zeros)
    atmosphere: Annotated[float, Quantity("kg/m^3", nonnegative=True)] = 0.0
    drag_coefficient: Annotated[float, Quantity("1", nonnegative=True)] = 2.2
    target_faces: Annotated[Array, Quantity("m^2", (3,), nonnegative=True)] = field(
        default_factory=_zeros
    )
    target_pressure_centre: Annotated[Array, Quantity("m", (3,))] = field(default_factory=_zeros)
    chaser_faces: Annotated[Array, Quantity("m^2", (3,), nonnegative=True)] = field(
        default_factory=_zeros
    )
    chaser_pressure_centre: Annotated[Array, Quantity("m", (3,))] = field(default_factory=_zeros)
    max_step: Annotated[float, Quantity("s", positive=True)] = 1.0

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("target_inertia", "chaser_inertia"):
            check_inertia(f"ControlledBodies.{name}", getattr(self, name))

    @property
    def source(self) -> str:
        """What it is, and what it leaves out."""
        return (
            "controlled_bodies: rigid target and chaser under Euler's equations, with gravity"
            " gradient and drag, on one circular orbit. Not modelled: oblateness, the turning"
            " of the air, solar pressure, flexibility, wheels and thrusters, relative position"
        )

    def fly(self, t: float, rng: np.random.Generator) -> BodiesFlight:
        """A flight that begins at time t, s, with what is drawn of the start."""
        shape = rng.standard_normal(4)
        w = self.target_rate + self.target_rate_sigma * rng.standard_normal(3)
        R_it = so3.exp(self.target_attitude.copy())
        if self.random_attitude:
            R_it = R_it @ so3.from_quaternion(shape)
        q_ic = so3.quaternion(so3.exp(self.chaser_attitude.copy()))
        y = np.concatenate([so3.quaternion(R_it), w, q_ic, self.chaser_rate])
        return BodiesFlight(self, float(t), y)

    def simulate(self, times: Array, rng: np.random.Generator) -> Truth:
        """Truth at `times` (N,), s, without commands. Raises InputError on times out of order.

        Values: target_attitude R_it and chaser_attitude R_ic (N, 3, 3), target_rate w_ti_t
        and chaser_rate w_ci_c (N, 3).
        """
        t = checked_times(times)
        flight, found = self.fly(float(t[0]), rng), []
        for now in t:
            flight.advance(float(now), None, {})
            found.append(flight.values())
        return Truth(
            t, {name: np.array([v[name] for v in found]) for name in found[0]}, self.source
        )

    def mean_rate(self, t_start: Array, t_end: Array) -> Array:
        """Raises InputError: the rate depends on commands, and no input is driven here.

        t_start, t_end: (n,), s, as for truths that have mean rates.
        """
        raise InputError("controlled_bodies: found a gyro among the inputs, expected none")


class BodiesFlight:
    """The two bodies at one time."""

    def __init__(self, truth: ControlledBodies, t: float, y: Array) -> None:
        self.t, self._y, self._max_step = t, y, truth.max_step
        self._orbit = circular_orbit(
            *(truth.semi_major_axis, truth.inclination, truth.raan, truth.argument_of_latitude),
            truth.epoch,
            truth.atmosphere * truth.drag_coefficient,
        )
        self._bodies = np.array(
            [
                np.concatenate([J.ravel(), np.linalg.inv(J).ravel(), faces, centre])
                for J, faces, centre in (
                    (truth.target_inertia, truth.target_faces, truth.target_pressure_centre),
                    (truth.chaser_inertia, truth.chaser_faces, truth.chaser_pressure_centre),
                )
            ]
        )

    def values(self) -> dict[str, Array]:
        """Attitudes and rates of both."""
        y = self._y
        return {
            "target_attitude": so3.from_quaternion(y[0:4]),
            "target_rate": y[4:7].copy(),
            "chaser_attitude": so3.from_quaternion(y[7:11]),
            "chaser_rate": y[11:14].copy(),
        }

    def advance(
        self, t: float, command: Array | None, edges: Mapping[str, Array]
    ) -> dict[str, Array]:
        """Fly to time t, s, with a torque on the chaser (3,), N m, in its axes, held.

        Raises InputError on a command of another shape, and on inputs.
        """
        if edges:
            raise InputError(f"controlled_bodies: cannot drive the inputs {', '.join(edges)}")
        torque = np.zeros(3) if command is None else np.array(command, dtype=np.float64)
        if torque.shape != (3,) or not np.isfinite(torque).all():
            raise InputError(f"controlled_bodies: found command {command}, expected 3 numbers, N m")
        length = t - self.t
        check_steps("truth", length, self._max_step)
        steps = np.ceil(length / self._max_step * (1 - 1e-12))
        if steps > 0:
            span = np.array([self.t, length / steps, steps])
            advance(self._orbit, self._bodies, span, torque, self._y)
        self.t = t
        return {}
