"""Truth of a chaser that thrusts towards a free target, with what its receivers carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.core.steps import check_steps
from relnav_graph.core.track import Truth
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.maths.geopotential import geopotential
from relnav_graph.sim.truths.earth_gravity import TurningEarth
from relnav_graph.sim.truths.powered_dynamics import fly_orbits, sample_attitude, wobbled
from relnav_graph.sim.truths.rigid_body_pair import OrbitElements, checked_times
from relnav_graph.units import Quantity, check_fields

__all__ = ["PoweredFlight", "PoweredOrbits"]


def _zeros() -> Array:
    return np.zeros(3)


def nadir_attitude(r: Array, v: Array) -> Array:
    """R_ic (3, 3) of a craft with z towards the Earth's centre and y against its orbit's normal.

    r (3,), m, and v (3,), m/s: its position and velocity in i, from the Earth's centre.
    """
    z_i, y_i = -r / np.sqrt(r @ r), so3.cross(v, r)
    y_i /= np.sqrt(y_i @ y_i)
    return np.array([so3.cross(y_i, z_i), y_i, z_i]).T.copy()


@dataclass(frozen=True, eq=False, kw_only=True)
class PoweredOrbits(OrbitElements):
    """Chaser and target under the Earth's gravity, by default with J2, J3, J4, each with an
    acceleration of its own that wanders (Gauss-Markov); the chaser has a thruster. All holds at
    the start of the pass, but the true anomaly at the epoch.

    semi_major_axis to argument_of_perigee (see
    `relnav_graph.sim.truths.rigid_body_pair.OrbitElements`): orbit of the target.
    relative_position: r_tc, m, and relative_velocity, m/s, its derivative there, in RTN axes of
    the target. mass: kg, constant; max_thrust: N, the longest that a command can have;
    acceleration_sigma: m/s^2, per axis, and acceleration_time_constant: s, of the wandering
    accelerations. The chaser's z looks at the Earth; wobble: rad, amplitude of small turns about
    that, and wobble_period: s.

    clock_bias: m, clock_drift: m/s, frequency_density: m/s^1.5, of the receiver's clock;
    earth_sensor_bias: rad, of both angles, constant; earth_sensor_sigma: rad, of what each drifts
    about that (Gauss-Markov), and earth_sensor_time_constant: s, of the drift.

    degree, order: of the Earth's field; an order of 0 and a degree of 4 are J2, J3, J4 about z of
    i, anything else the field of EGM2008, that turns with the Earth; third_bodies: "sun", "moon".
    These need the absolute time of t = 0, [time] epoch, which makes the clock.

    Raises InputError on an orbit that is not an ellipse, or a field that there is not.
    """

    kind: ClassVar[str] = "powered_orbits"

    relative_position: Annotated[Array, Quantity("m", (3,))]
    relative_velocity: Annotated[Array, Quantity("m/s", (3,))] = field(default_factory=_zeros)
    mass: Annotated[float, Quantity("kg", positive=True)]
    max_thrust: Annotated[float, Quantity("N", nonnegative=True)]
    acceleration_sigma: Annotated[float, Quantity("m/s^2", nonnegative=True)] = 0.0
    acceleration_time_constant: Annotated[float, Quantity("s", positive=True)] = 3600.0
    wobble: Annotated[float, Quantity("rad", nonnegative=True)] = 0.0
    wobble_period: Annotated[float, Quantity("s", positive=True)] = 10.0
    clock_bias: Annotated[float, Quantity("m")] = 0.0
    clock_drift: Annotated[float, Quantity("m/s")] = 0.0
    frequency_density: Annotated[float, Quantity("m/s^1.5", nonnegative=True)] = 0.0
    earth_sensor_bias: Annotated[float, Quantity("rad")] = 0.0
    earth_sensor_sigma: Annotated[float, Quantity("rad", nonnegative=True)] = 0.0
    earth_sensor_time_constant: Annotated[float, Quantity("s", positive=True)] = 3600.0
    max_step: Annotated[float, Quantity("s", positive=True)] = 1.0
    degree: int = 4
    order: int = 0
    third_bodies: tuple[Literal["sun", "moon"], ...] = ()
    clock: AbsoluteTime | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.degree < 4:
            raise InputError(f"degree: found {self.degree}, expected 4 or more of a truth")
        geopotential().upto(self.degree, self.order)
        self.craft(0.0)  # it refuses what is no ellipse

    @property
    def turns(self) -> bool:
        """Whether gravity depends on the time."""
        return (self.degree, self.order) != (4, 0) or bool(self.third_bodies)

    @property
    def undated(self) -> bool:
        """Whether the absolute time of t = 0 is needed, and missing."""
        return self.turns and self.clock is None

    @property
    def earth(self) -> TurningEarth | None:
        """The Earth as it turns; None where gravity does not depend on the time.

        Raises InputError where the absolute time is missing, or cannot be used.
        """
        if not self.turns:
            return None
        if self.clock is None:
            raise InputError("powered_orbits: found no absolute time of t = 0: give [time] epoch")
        return TurningEarth(self.degree, self.order, self.third_bodies, self.clock)

    @property
    def source(self) -> str:
        """What it is, and what it leaves out."""
        with_ = "J2, J3, J4"
        if self.turns:
            with_ = f"EGM2008 to {self.degree} x {self.order}"
            with_ += "".join(f", {name.capitalize()}" for name in self.third_bodies)
        missing = "other harmonics" if self.third_bodies else "other harmonics, third bodies"
        return (
            f"powered_orbits: both craft integrated in an inertial frame with {with_} and"
            " wandering accelerations; the chaser's attitude is a given motion. Not modelled:"
            f" {missing}, propellant used, thruster errors, attitude control"
        )

    def craft(self, t: float) -> Array:
        """(12,): position and velocity of the target at the start t, s, then of the chaser."""
        y = self.initial_orbits(self.relative_position, self.relative_velocity, t)
        y[6:] += y[:6]
        return y

    def fly(self, t: float, rng: np.random.Generator) -> PoweredFlight:
        """A flight that begins at time t, s."""
        return PoweredFlight(self, float(t), rng)

    def simulate(self, times: Array, rng: np.random.Generator) -> Truth:
        """Truth at `times` (N,), s, without thrust. Raises InputError on times out of order.

        Values: see `PoweredFlight.values`.
        """
        t = checked_times(times)
        flight = self.fly(float(t[0]), rng)
        found = [flight.values()]
        for now in t[1:]:
            flight.advance(float(now), None, {})
            found.append(flight.values())
        values = {name: np.array([v[name] for v in found]) for name in found[0]}
        return Truth(t, values, self.source)


class PoweredFlight:
    """Both craft at one time."""

    def __init__(self, truth: PoweredOrbits, t: float, rng: np.random.Generator) -> None:
        self.t, self._truth, self._rng = t, truth, rng
        self._y, self._earth = truth.craft(t), truth.earth
        self._wandering = truth.acceleration_sigma * rng.standard_normal(6)
        self._clock = np.array([truth.clock_bias, truth.clock_drift])
        self._earth_drift = truth.earth_sensor_sigma * rng.standard_normal(2)
        self._wobble = np.array([truth.wobble, 2 * np.pi / truth.wobble_period])

    def _steady(self) -> Array:
        return nadir_attitude(self._y[6:9], self._y[9:12])

    def values(self) -> dict[str, Array]:
        """chaser_position, chaser_velocity in i, relative_position r_tc, relative_velocity
        v_tc in i, chaser_attitude R_ic, clock_bias, clock_drift, earth_sensor_bias, which is
        constant, and earth_sensor_drift."""
        y = self._y
        return {
            "relative_position": y[6:9] - y[0:3],
            "relative_velocity": y[9:12] - y[3:6],
            "chaser_attitude": wobbled(self._steady(), self._wobble, self.t),
            "chaser_position": y[6:9].copy(),
            "chaser_velocity": y[9:12].copy(),
            "clock_bias": self._clock[:1].copy(),
            "clock_drift": self._clock[1:].copy(),
            "earth_sensor_bias": np.full(2, self._truth.earth_sensor_bias),
            "earth_sensor_drift": self._earth_drift.copy(),
        }

    def advance(
        self, t: float, command: Array | None, edges: Mapping[str, Array]
    ) -> dict[str, Array]:
        """Fly to time t, s, with a thrust on the chaser (3,), N, in i, held; one that is too
        long is cut to `max_thrust`.

        Gives the means of w_ci_c, rad/s, for "gyro", and of the specific force in c, m/s^2,
        for "accelerometer". Raises InputError on other inputs and on a command of another
        shape.
        """
        thrust = np.zeros(3) if command is None else np.array(command, dtype=np.float64)
        if thrust.shape != (3,) or not np.isfinite(thrust).all():
            raise InputError(f"powered_orbits: found command {command}, expected 3 numbers, N")
        truth, h = self._truth, t - self.t
        size = np.sqrt(thrust @ thrust)
        if size > truth.max_thrust:
            thrust *= truth.max_thrust / size
        pushed_i = thrust / truth.mass + self._wandering[3:]
        before, t_before = self._steady(), self.t
        held = np.concatenate([self._wandering[:3], pushed_i])
        check_steps("truth", h, truth.max_step)
        steps = max(1, int(np.ceil(h / truth.max_step * (1 - 1e-9))))
        if self._earth is None:
            self._y = fly_orbits(self._y, held, h / steps, steps)
        else:
            self._y = self._earth.fly(self._y, held, self.t, h / steps, steps)
        self.t = t
        self._wander(h)
        turned = so3.log(np.ascontiguousarray(before.T @ self._steady())) / h
        found: dict[str, Array] = {}
        for name, own in edges.items():
            if name not in ("gyro", "accelerometer"):
                raise InputError(f"powered_orbits: cannot drive the input {name!r}")
            if abs(own[0] - t_before) > SAME_TIME or abs(own[-1] - t) > SAME_TIME:
                raise InputError(f"inputs.{name}: samples do not cover {t_before} s to {t} s")
            both = sample_attitude(before, turned, self._wobble, own, pushed_i)
            found[name] = both[0 if name == "gyro" else 1]
        return found

    def _wander(self, h: float) -> None:
        """What wanders, h seconds later."""
        truth, draw = self._truth, self._rng.standard_normal(10)
        self._wandering = _forget(
            self._wandering, h, truth.acceleration_time_constant, truth.acceleration_sigma, draw[:6]
        )
        self._earth_drift = _forget(
            *(self._earth_drift, h, truth.earth_sensor_time_constant),
            *(truth.earth_sensor_sigma, draw[6:8]),
        )
        q = truth.frequency_density * np.sqrt(h)
        bias, drift = self._clock
        # A random walk's integral: half the step, and a bridge of variance h^2 / 12.
        mean = drift + q * (0.5 * draw[8] + draw[9] / np.sqrt(12.0))
        self._clock = np.array([bias + h * mean, drift + q * draw[8]])


def _forget(x: Array, h: float, time_constant: float, sigma: float, draw: Array) -> Array:
    """A Gauss-Markov process h seconds later."""
    kept = np.exp(-h / time_constant)
    out: Any = kept * x + sigma * np.sqrt(1 - kept**2) * draw
    return np.asarray(out)
