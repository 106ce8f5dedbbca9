"""Thienel, VanEepoel and Sanner's observer of a target's angular momentum."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import TARGET_ATTITUDE, TARGET_RATE
from relnav_graph.core.contracts import KnowsTorque, ProposesStarts
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Status, Track
from relnav_graph.errors import EstimationError, ModelError
from relnav_graph.estimators.source import RecordedSource, Source, drive
from relnav_graph.linear.assembly import Assembly
from relnav_graph.maths import dense, so3

__all__ = ["MomentumObserver"]


@jit
def momentum_rate(inverse: Array, R_it: Array, h_i: Array) -> Array:
    """w_ti_t (3,), rad/s, of an angular momentum: J^-1 R_it^T h_i.

    inverse: J^-1 (3, 3), in t, 1/(kg m^2); R_it (3, 3); h_i (3,): in i, N m s.
    """
    return dense.matvec(inverse, dense.transposed_matvec(R_it, h_i))


@jit
def observer_step(
    numbers: Array, inverse: Array, R_hat: Array, h_i: Array, R_seen: Array, torque_t: Array
) -> tuple[Array, Array]:
    """R_hat (3, 3) and h_i (3,), N m s, in i, at the end of an interval.

    numbers (3,): k, 1/s, beta, kg^2 m^4 / s^2, and the interval's length, s; inverse: J^-1
    (3, 3), in t, 1/(kg m^2); R_hat, R_seen (3, 3): R_it as estimated and as measured, at the
    start; h_i (3,): angular momentum then; torque_t (3,): known torque, in t, N m. Over the
    interval the measured attitude is taken to turn with the target.
    """
    k, beta, dt = numbers
    error = so3.quaternion(dense.transposed_matmul(R_hat, R_seen))  # its scalar is >= 0
    e = dense.vector_at(error, 1)
    change = dense.add_scaled_vector(torque_t, dense.matvec(inverse, e), 0.5 * beta)
    h_next = dense.add_scaled_vector(h_i, dense.matvec(R_seen, change), dt)
    # J^-1 R h of the measured attitude, half the interval on.
    w = momentum_rate(inverse, R_seen, h_i)
    half = np.empty(3)
    for i in range(3):
        half[i] = 0.5 * dt * w[i]
    w = momentum_rate(inverse, dense.matmul(R_seen, so3.exp(half)), h_i)
    turn = dense.add_scaled_vector(w, e, k)
    turn = dense.transposed_matvec(R_hat, dense.matvec(R_seen, turn))
    for i in range(3):
        turn[i] *= dt
    return so3.project(dense.matmul(R_hat, so3.exp(turn))), h_next


@jit
def observed_acceleration(
    beta: float, inertia: Array, R_hat: Array, h_i: Array, R_seen: Array, torque_t: Array
) -> Array:
    """w_ti_t' (3,), rad/s^2, as the observer has it: of ``w = J^-1 R_hat^T h``.

        w' = J^-1 (-w x J w + torque + beta/2 R_hat^T R_seen J^-1 e)

    beta: kg^2 m^4 / s^2; inertia (2, 3, 3): J, in t, kg m^2, and its inverse; the rest: as of
    `observer_step`. R_hat is taken to turn by w, as printed, and not by what brings it to the
    measured attitude besides.
    """
    w = momentum_rate(inertia[1], R_hat, h_i)
    between = dense.transposed_matmul(R_hat, R_seen)
    e = dense.vector_at(so3.quaternion(between), 1)
    gyration = so3.cross(w, dense.matvec(inertia[0], w))
    pull = dense.add_scaled_vector(torque_t, gyration, -1.0)
    told = dense.matvec(between, dense.matvec(inertia[1], e))
    return dense.matvec(inertia[1], dense.add_scaled_vector(pull, told, 0.5 * beta))


def _seen(problem: Problem, epoch: Epoch) -> Iterator[Array]:
    """Attitudes (3, 3) of the target as measured in an epoch."""
    for m in epoch.measurements:
        sensor = problem.sensors[m.sensor]
        if isinstance(sensor, ProposesStarts):
            for values in sensor.starts(m.ids, sensor.accept(m.z), {}):
                if TARGET_ATTITUDE.name in values:
                    yield values[TARGET_ATTITUDE.name]


@dataclass(frozen=True)
class MomentumObserver:
    """Nonlinear observer of attitude and angular momentum, h in i (no covariance).

    With q~ = (e, n) from the predicted to the measured attitude: q^' by the rate
    R(q~)^T (J^-1 R h^ + k e sign(n)), h^' = beta/2 R^T J^-1 e sign(n) + torque, and the rate
    J^-1 R h^ at the predicted attitude (Thienel, VanEepoel, Sanner 2006, eqs. 6, 7, 10, 11).
    The first measurement is where it begins, with no momentum. Between measurements the
    innovation is held, in the target's axes; the estimate at a time has seen those before it.

    The gains are not printed. Their linear theory about axis j: natural frequency
    sqrt(beta) / (2 J_j), damping k / (4 natural frequency). frequency (rad/s), damping: at
    the mean moment of inertia.
    """

    kind: ClassVar[str] = "momentum_observer"
    frequency: float = 0.005
    damping: float = 1.0

    def run(self, problem: Problem) -> Track:
        """Observe the whole pass."""
        return self.drive(RecordedSource(problem))

    def drive(self, source: Source) -> Track:
        """Observe epochs as they come. Raises ModelError unless the state is an attitude and a
        rate, advanced by a process that knows inertia and torque."""
        observer = _Observer(source.problem, self.frequency, self.damping)
        done = drive(source, observer)
        status: Status = "diverged" if done.stopped else "ok"
        return done.track(self.kind, status=status, message=done.stopped)


@dataclass(frozen=True, eq=False)
class ObserverState:
    """The observer at one epoch: t, s, None before the first.

    R_hat (3, 3): R_it as estimated; h_i (3,), N m s, in i; held (3, 3): R_it as measured last,
    torque_t (3,), N m, in t: what the next interval is observed with; x (size,): the estimate
    as stored; P (n, n): all NaN, the observer has no covariance; besides: target_acceleration
    (3,), w_ti_t', rad/s^2.
    """

    t: float | None
    R_hat: Array
    h_i: Array
    held: Array
    torque_t: Array
    x: Array
    P: Array
    besides: Mapping[str, Array]


class _Observer:
    """Carries the observer from epoch to epoch."""

    def __init__(self, problem: Problem, frequency: float, damping: float) -> None:
        self.problem = problem
        self.process, inertia = _process(problem)
        self.inverse = np.asarray(np.linalg.inv(inertia), dtype=np.float64)
        self.inertia = np.array([inertia, self.inverse])
        mean = np.trace(inertia) / 3
        self.k, self.beta = 4 * damping * frequency, (2 * mean * frequency) ** 2

    def begin(self) -> ObserverState:
        """With no momentum, before the first epoch."""
        layout = self.problem.layout
        x, P = np.full(layout.size, np.nan), np.full((layout.dim, layout.dim), np.nan)
        return ObserverState(None, np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), x, P, {})

    def advance(
        self, s: ObserverState, epoch: Epoch, assembly: Assembly | None = None
    ) -> ObserverState:
        """The state with one more epoch. Raises EstimationError without an attitude to begin
        with, or when the estimate is not finite."""
        seen, R_hat, h_i = next(_seen(self.problem, epoch), None), s.R_hat, s.h_i
        if s.t is not None:
            numbers = np.array([self.k, self.beta, epoch.t - s.t])
            R_hat, h_i = observer_step(numbers, self.inverse, R_hat, h_i, s.held, s.torque_t)
        elif seen is None:
            raise EstimationError(f"t = {epoch.t} s: no attitude to begin with")
        else:
            R_hat = np.ascontiguousarray(seen)
        if not (np.isfinite(h_i).all() and np.isfinite(R_hat).all()):
            raise EstimationError(f"t = {epoch.t} s: the estimate is not finite")
        held = R_hat if seen is None else np.ascontiguousarray(seen)
        rate = momentum_rate(self.inverse, R_hat, h_i)
        x = self.problem.layout.pack({TARGET_ATTITUDE.name: R_hat, TARGET_RATE.name: rate})
        torque_t = self.process.torque(epoch.t, R_hat)
        turning = observed_acceleration(self.beta, self.inertia, R_hat, h_i, held, torque_t)
        besides = {"target_acceleration": turning}
        return ObserverState(epoch.t, R_hat, h_i, held, torque_t, x, s.P, besides)


def _process(problem: Problem) -> tuple[KnowsTorque, Array]:
    """The one process, and the inertia of its body."""
    processes = list(problem.processes.values())
    own = [p for p in processes if isinstance(p, KnowsTorque)]
    if problem.layout.blocks != (TARGET_ATTITUDE, TARGET_RATE) or len(own) != 1:
        raise ModelError(
            f"momentum_observer: found {problem.layout} with processes"
            f" {[p.kind for p in processes]}, expected attitude and rate of a target, advanced"
            " by gravity_gradient_rotation"
        )
    return own[0], np.ascontiguousarray(own[0].known_inertia)
