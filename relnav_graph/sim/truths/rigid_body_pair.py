"""Truth for a chaser near a tumbling target: two orbits and a rigid body.

Nothing here is shared with the models of the estimators, so that no error of theirs can
hide in the data that they are tested with.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.steps import check_steps
from relnav_graph.core.track import Truth
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.maths.frames import rtn_axes
from relnav_graph.maths.inertia import check_inertia
from relnav_graph.memory import check_room
from relnav_graph.sim.truths.integrate import STATE_SIZE, integrate
from relnav_graph.units import Quantity, check_fields

__all__ = ["OrbitElements", "RigidBodyPair", "checked_times"]


def _zeros() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False, kw_only=True)
class OrbitElements:
    """Orbital elements of the craft that the other one's position is given from.

    semi_major_axis (m), eccentricity (0 <= e < 1), true_anomaly, inclination, raan,
    argument_of_perigee (rad); epoch: s, the time at which the true anomaly holds.
    """

    semi_major_axis: Annotated[float, Quantity("m", positive=True)]
    eccentricity: Annotated[float, Quantity("1", nonnegative=True)] = 0.0
    true_anomaly: Annotated[float, Quantity("rad")] = 0.0
    inclination: Annotated[float, Quantity("rad")] = 0.0
    raan: Annotated[float, Quantity("rad")] = 0.0
    argument_of_perigee: Annotated[float, Quantity("rad")] = 0.0
    epoch: Annotated[float, Quantity("s")] = 0.0

    def _mean_anomaly(self) -> float:
        """That at the epoch, rad, within half a turn of zero."""
        e = self.eccentricity
        lag = np.arctan2(
            np.sqrt(1 - e * e) * np.sin(self.true_anomaly), e + np.cos(self.true_anomaly)
        )
        return float(lag - e * np.sin(lag))

    def _anomaly(self, t: float, mu: float) -> float:
        """The true anomaly at time t, s, rad: Kepler's equation by halving, from its bounds."""
        if t == self.epoch:
            return self.true_anomaly
        e, mean = self.eccentricity, self._mean_anomaly()
        mean += np.remainder((t - self.epoch) * np.sqrt(mu / self.semi_major_axis**3), 2 * np.pi)
        low, high = mean - e, mean + e
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (middle, high) if middle - e * np.sin(middle) < mean else (low, middle)
        return float(
            2 * np.arctan2(*(np.sqrt(1 + e) * np.sin(high / 2), np.sqrt(1 - e) * np.cos(high / 2)))
        )

    def initial_R_io(self, t: float = 0.0, mu: float = MU_EARTH) -> Array:
        """R_io (3, 3) at the start t, s: from RTN axes of the orbit to inertial ones."""
        return self._to_perigee(self._anomaly(t, mu))

    def _to_perigee(self, beyond: float = 0.0) -> Array:
        """R_ip (3, 3) of the axes of the perigee p, or of those turned beyond it by an angle, rad,
        about the normal."""
        z, x = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
        plane = so3.exp(self.raan * z) @ so3.exp(self.inclination * x)
        return np.asarray(plane @ so3.exp((self.argument_of_perigee + beyond) * z))

    def initial_orbits(
        self, position: Array, velocity: Array, t: float = 0.0, mu: float = MU_EARTH
    ) -> Array:
        """(12,): position and velocity of the craft in i at the start t, s, then those of the
        other relative to it.

        position: of the other from the craft, m, and velocity, m/s, its derivative there, in
        RTN axes of the orbit. Raises InputError on an orbit that is not an ellipse.
        """
        e = self.eccentricity
        if e >= 1:
            raise InputError(f"{type(self).__name__}.eccentricity: found {e}, expected below 1")
        nu = self._anomaly(t, mu)
        parameter = self.semi_major_axis * (1 - e * e)
        radius = parameter / (1 + e * np.cos(nu))
        momentum = np.sqrt(mu * parameter)
        v_o = np.array([mu / momentum * e * np.sin(nu), momentum / radius, 0.0])
        w_oi_o = np.array([0.0, 0.0, momentum / radius**2])
        # Derivative taken in i, components in o.
        d_dot_o = velocity + np.cross(w_oi_o, position)
        R_io = self.initial_R_io(t, mu)
        return np.concatenate([radius * R_io[:, 0], R_io @ v_o, R_io @ position, R_io @ d_dot_o])


@dataclass(frozen=True, eq=False, kw_only=True)
class RigidBodyPair(OrbitElements):
    """Two craft on two-body orbits; the target a free rigid body, the chaser turning steadily.

    All that follows holds at t = 0, but the true anomaly at the epoch. Frame o is RTN of the
    target's orbit.

    semi_major_axis to argument_of_perigee (see `OrbitElements`), mu (m^3/s^2): orbit of the
    target. relative_position: r_tc_o, m; relative_velocity: its derivative in o, m/s.
    target_attitude, chaser_attitude: R_ot and R_oc as rotation vectors, rad.
    target_inertia: principal moments about the axes of t, kg m^2; target_rate: w_ti_t,
    rad/s; chaser_rate: w_ci_c, rad/s, constant.
    torque_density: white angular acceleration of the target per axis of t, rad/s^1.5;
    acceleration_density: white acceleration of the chaser per axis of i, m/s^1.5.
    max_step: longest integration step, s. With steps that turn the target by less than
    0.05 rad the attitude is within 1e-9 rad after an hour.

    Raises InputError on an orbit that is not an ellipse, on moments that no body has
    (one at least the sum of the others), and on values of a wrong shape or sign.
    """

    kind: ClassVar[str] = "rigid_body_pair"

    relative_position: Annotated[Array, Quantity("m", (3,))]
    relative_velocity: Annotated[Array, Quantity("m/s", (3,))]
    target_inertia: Annotated[Array, Quantity("kg*m^2", (3,), positive=True)]
    target_rate: Annotated[Array, Quantity("rad/s", (3,))]
    mu: Annotated[float, Quantity("m^3/s^2", positive=True)] = MU_EARTH
    target_attitude: Annotated[Array, Quantity("rad", (3,))] = field(default_factory=_zeros)
    chaser_attitude: Annotated[Array, Quantity("rad", (3,))] = field(default_factory=_zeros)
    chaser_rate: Annotated[Array, Quantity("rad/s", (3,))] = field(default_factory=_zeros)
    torque_density: Annotated[float, Quantity("rad/s^1.5", nonnegative=True)] = 0.0
    acceleration_density: Annotated[float, Quantity("m/s^1.5", nonnegative=True)] = 0.0
    max_step: Annotated[float, Quantity("s", positive=True)] = 0.5

    def __post_init__(self) -> None:
        check_fields(self)
        self._orbits()  # it refuses what is no ellipse
        check_inertia("RigidBodyPair.target_inertia", self.target_inertia)

    def simulate(self, times: Array, rng: np.random.Generator) -> Truth:
        """Truth at `times` (N,), s, of a pass without manoeuvres; see `flown`."""
        return self.flown(times, rng, np.zeros((0, 4)))

    def flown(self, times: Array, rng: np.random.Generator, steps: Array) -> Truth:
        """Truth at `times` (N,), s: increasing, the first not before t = 0.

        steps (n, 4): time, s, in order, and step of the chaser's velocity, m/s, in o; those after
        t = 0 and before the last time are flown.

        Values: chaser_attitude R_oc and target_attitude R_ot (N, 3, 3), relative_position
        r_tc_o and relative_velocity (its derivative in o), target_rate w_ti_t, chaser_rate
        w_ci_c (N, 3), inertia_parameters (N, 2), and the target's orbit, orbit_radius,
        orbit_radial_rate, orbit_angle (from the first perigee) and orbit_angular_rate (N, 1).
        Noise is constant over each integration
        step with variance density^2 / step. Raises InputError on times out of order, or too far
        apart for the steps.
        """
        t, due = checked_times(times), steps[(steps[:, 0] >= 0) & (steps[:, 0] < times[-1])]
        stops = np.union1d(t, due[:, 0])
        spans = np.diff(stops, prepend=0.0)
        check_steps("truth", float(spans.max()), self.max_step)
        # The margin keeps a span of 10 s, rounded up, from taking one step more.
        most = np.ceil(spans / self.max_step * (1 - 1e-12))
        check_room(f"truth.max_step {self.max_step} s, {most.sum():.3g} steps", 6 * most.sum())
        counts = most.astype(np.int64)
        h = spans / np.maximum(counts, 1)
        density = np.repeat([self.torque_density, self.acceleration_density], 3)
        # Always six numbers a step: one noise switched on leaves the other as it was.
        disturbance = rng.standard_normal((int(counts.sum()), 6)) * density
        disturbance /= np.sqrt(np.repeat(h, counts))[:, None]
        y = np.empty((len(stops), STATE_SIZE))
        p = np.array([self.mu, *self.target_inertia])
        now, begin, rows = self._initial_state(), 0, np.concatenate([[0], np.cumsum(counts)])
        for time, *step_o in (*due, (np.inf, 0.0, 0.0, 0.0)):
            end = int(np.searchsorted(stops, time, side="right"))
            if end > begin:
                own = slice(begin, end), slice(rows[begin], rows[end])
                integrate(p, now, counts[own[0]], h[own[0]], disturbance[own[1]], y[own[0]])
                now, begin = y[end - 1].copy(), end
            now[9:12] += rtn_axes(now[None])[0][0].T @ step_o
        y = y[np.searchsorted(stops, t)]
        return Truth(
            t=t,
            values=self._values(t, y),
            source=(
                "rigid_body_pair: two-body orbits of both craft integrated in an inertial frame,"
                " rigid target under Euler's equations with white torque, chaser at a constant"
                " body rate with white acceleration. Not modelled: oblateness, drag, solar"
                " pressure, third bodies, gravity-gradient torque, flexibility; a manoeuvre is a"
                " step of the velocity"
            ),
        )

    def mean_rate(self, t_start: Array, t_end: Array) -> Array:
        """Mean of w_ci_c over each interval [t_start, t_end] (n,), s: (n, 3), rad/s.

        What a rate-integrating gyro without errors gives. Exact: the rate is constant.
        Raises InputError on an interval that does not run forwards.
        """
        backwards = ~(np.asarray(t_end) > np.asarray(t_start))
        if backwards.any():
            t = np.asarray(t_start)[backwards][0]
            raise InputError(f"mean_rate: the interval from t = {t} s does not run forwards")
        return np.tile(self.chaser_rate, (len(backwards), 1))

    def _orbits(self) -> Array:
        return self.initial_orbits(self.relative_position, self.relative_velocity, mu=self.mu)

    def _initial_state(self) -> Array:
        """The state y (19,) at t = 0; see `relnav_graph.sim.truths.integrate`."""
        R_it = self.initial_R_io(mu=self.mu) @ so3.exp(self.target_attitude.copy())
        return np.concatenate([self._orbits(), so3.quaternion(R_it), self.target_rate])

    def _unwrapped(self, t: Array, wrapped: Array) -> Array:
        """True anomalies (N,), rad, at times t, s, with the whole turns since the epoch.

        wrapped: the same but for whole turns. Less than half a turn lies between a true and a mean
        anomaly.
        """
        begin, turn = self._mean_anomaly(), 2 * np.pi
        mean = begin + (t - self.epoch) * np.sqrt(self.mu / self.semi_major_axis**3)
        begun = np.rint((self.true_anomaly - begin) / turn)
        return np.asarray(wrapped + turn * (begun + np.rint((mean - wrapped) / turn)))

    def _values(self, t: Array, y: Array) -> dict[str, Array]:
        """Values of the blocks from the integrated states y (N, 19)."""
        r_i, (R_oi, w_oi_o) = y[:, 0:3], rtn_axes(y)
        radius = np.linalg.norm(r_i, axis=1)
        r_p = r_i @ self._to_perigee()
        r_tc_o = np.einsum("nij,nj->ni", R_oi, y[:, 6:9])
        R_it = dense.stacked((so3.from_quaternion(q) for q in y[:, 12:16]), 3, 3)
        R_ic0 = self.initial_R_io(mu=self.mu) @ so3.exp(self.chaser_attitude.copy())
        R_ic = R_ic0 @ dense.stacked((so3.exp(self.chaser_rate * s) for s in t), 3, 3)
        jx, jy, jz = self.target_inertia
        inertia_parameters = np.arctanh([(jy - jz) / jx, (jz - jx) / jy])
        return {
            "chaser_attitude": R_oi @ R_ic,
            "target_attitude": R_oi @ R_it,
            "relative_position": r_tc_o,
            "relative_velocity": np.einsum("nij,nj->ni", R_oi, y[:, 9:12])
            - np.cross(w_oi_o, r_tc_o),
            "target_rate": y[:, 16:19].copy(),
            "chaser_rate": np.tile(self.chaser_rate, (len(t), 1)),
            "inertia_parameters": np.tile(inertia_parameters, (len(t), 1)),
            "orbit_radius": radius[:, None],
            "orbit_radial_rate": ((r_i * y[:, 3:6]).sum(axis=1) / radius)[:, None],
            "orbit_angle": self._unwrapped(t, np.arctan2(r_p[:, 1], r_p[:, 0]))[:, None],
            "orbit_angular_rate": w_oi_o[:, 2:].copy(),
        }


def checked_times(times: Array) -> Array:
    """Times (N,), s, as an array. Raises InputError unless they are finite and increase
    from no earlier than t = 0."""
    t = np.array(times, dtype=np.float64)
    if t.ndim != 1 or not len(t) or not np.isfinite(t).all():
        raise InputError(f"times: found shape {t.shape}, expected one or more finite times (N,)")
    if t[0] < 0:
        raise InputError(f"times: found {t[0]} s, expected none before t = 0")
    backwards = np.nonzero(np.diff(t) <= 0)[0]
    if len(backwards):
        k = backwards[0]
        raise InputError(f"times: found {t[k + 1]} s after {t[k]} s, expected increasing times")
    return t
