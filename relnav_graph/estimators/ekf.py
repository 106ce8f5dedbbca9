"""Error-state extended Kalman filter, plain and with iterated updates."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from relnav_graph.assembly import Assembly, MeasurementRows
from relnav_graph.errors import EstimationError, GeometryError, ModelError
from relnav_graph.estimators.gating import count_rejected, innovation_weights
from relnav_graph.problem import Epoch, Problem
from relnav_graph.state import Layout
from relnav_graph.track import Innovations, Status, Track

__all__ = ["Ekf", "FilterStep", "IteratedEkf", "KalmanFilter", "update"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FilterStep:
    """One epoch of a filter.

    The predicted and the updated state, F since the epoch before (None at the first), the
    weights of the epoch's observations and how many each sensor lost; nis: the squared
    normalised innovation of the observations used, over `rows` rows; innovations: of each
    sensor, whitened on its own.
    """

    t: float
    x_predicted: Array
    P_predicted: Array
    F: Array | None
    x: Array
    P: Array
    weights: Array
    rejected: Mapping[str, int]
    nis: float
    rows: int
    innovations: Mapping[str, Array]


def symmetric(P: Array) -> Array:
    """P without the asymmetry of rounding."""
    return 0.5 * (P + P.T)


#: Gauss-Newton steps of an iterated update, at most; the same wherever one is made.
ITERATIONS = 20


def _cost(layout: Layout, x0: Array, whiten: Array, x: Array, rows: MeasurementRows) -> float:
    e = whiten @ layout.local(x0, x)
    return float(e @ e + rows.r @ rows.r)


def _measured(
    assembly: Assembly, x: Array, weights: Array, before: MeasurementRows
) -> MeasurementRows | None:
    """Rows at a new state; None where it is none: not finite, or so that an observation,
    possible before, has become impossible, which must not pass for one that fits."""
    try:
        rows = assembly.measure(x[None], weights)
    except ModelError:
        return None
    lost = (rows.status > 0) & (before.status == 0)
    return None if lost.any() else rows


def update(
    assembly: Assembly, x0: Array, P0: Array, weights: Array, iterations: int
) -> tuple[Array, Array]:
    """Measurement update of one epoch: the state and the covariance, in Joseph's form.

    One iteration is the extended Kalman filter; more are Gauss-Newton steps towards the
    maximum a posteriori (Bell and Cathey 1993), halved while the cost grows and given up
    when that does not help. P is in the tangent of the updated state.
    """
    layout = assembly.layout
    scale = np.sqrt(np.diag(P0))
    factor = np.linalg.cholesky(P0 / np.outer(scale, scale))
    whiten = solve_triangular(factor, np.diag(1 / scale), lower=True)
    x, x_next = x0, x0
    rows = assembly.measure(x0[None], weights)
    cost = _cost(layout, x0, whiten, x0, rows)
    H: Array = rows.H
    gain: Array = H.T
    for _ in range(iterations):
        e = layout.local(x0, x)
        J = layout.right_jacobian(e)
        H = rows.H @ J  # to perturbations in the tangent of x0
        S = H @ P0 @ H.T + np.eye(len(rows.r))
        gain = np.linalg.solve(S, H @ P0).T.astype(np.float64, copy=False)
        step = J @ (-gain @ (rows.r - H @ e) - e)
        if iterations == 1:
            x_next = layout.retract(x, step)
            break
        found = None
        for _halving in range(10):
            x_try = layout.retract(x, step)
            rows_try = _measured(assembly, x_try, weights, rows)
            if rows_try is not None:
                cost_try = _cost(layout, x0, whiten, x_try, rows_try)
                if cost_try <= cost * (1 + 1e-9) + 1e-9:
                    found = x_try, rows_try, cost_try
                    break
            step = 0.5 * step
        if found is None:  # no way down from here: x is the best there is
            break
        # The length of the step in sigmas of the posterior; the next would be its square.
        length2 = float(np.sum((whiten @ step) ** 2) + np.sum((rows.H @ step) ** 2))
        x, rows, cost = found
        x_next = x
        if length2 < 1e-6:
            break
    left = np.eye(layout.dim) - gain @ H
    P = left @ P0 @ left.T + gain @ gain.T
    J = layout.right_jacobian(layout.local(x0, x_next))
    return x_next, symmetric(J @ P @ J.T)


def predict(assembly: Assembly, x: Array, P: Array) -> tuple[Array, Array, Array, Array]:
    """State (size,) and covariance (n, n) at the end of the assembly's one interval, with
    its F and Q (n, n). Raises GeometryError, ModelError."""
    x_next, F, Q = assembly.transition(x[None])
    return x_next[0], symmetric(F[0] @ P @ F[0].T + Q[0]), F[0], Q[0]


def _whitened(S: Array, r: Array) -> Array:
    """S^-1/2 r, by the symmetric root, which turns no axis from epoch to epoch.

    S = H P H^T + I has no eigenvalue below 1, whatever rounding makes of it.
    """
    w, V = np.linalg.eigh(S)
    white: Array = V @ (V.T @ r / np.sqrt(np.maximum(w, 1.0)))
    return white


class KalmanFilter:
    """The filter's machinery: one `step` per epoch."""

    def __init__(self, problem: Problem, iterations: int) -> None:
        self.problem, self.iterations = problem, iterations
        self.t: float | None = None
        self.x, self.P = problem.prior.x, problem.prior.P

    def step(self, epoch: Epoch, assembly: Assembly | None = None) -> FilterStep:
        """Predict to the epoch and update with its measurements.

        assembly: of this epoch, where the caller has it already.
        Raises EstimationError when the state cannot be propagated or updated, or is no
        longer finite; the filter then stands where it stood before.
        """
        try:
            return self._step(epoch, assembly)
        except (GeometryError, np.linalg.LinAlgError) as error:
            raise EstimationError(f"t = {epoch.t} s: {error}") from error

    def _step(self, epoch: Epoch, assembly: Assembly | None) -> FilterStep:
        problem = self.problem
        if assembly is None:
            assembly = Assembly(
                problem.layout, problem.processes, problem.sensors, [epoch], t_before=self.t
            )
        x, P, F = self.x, self.P, None
        if self.t is not None:
            x, P, F, _ = predict(assembly, x, P)
        x_predicted, P_predicted = x, P
        weights = np.ones(assembly.observations)
        nis, used, innovations = 0.0, 0, dict[str, Array]()
        if assembly.observations:
            rows = assembly.measure(x[None], weights)
            weights = innovation_weights(assembly, rows, P, problem.gates)
            kept = assembly.rows_of(weights > 0)
            r, H = rows.r[kept], rows.H[kept]
            S = H @ P @ H.T + np.eye(len(r))
            nis = float(r @ np.linalg.solve(S, r))
            used = len(r)
            for name, part in assembly.sensor_rows.items():
                own = part[kept]
                if own.any():
                    innovations[name] = _whitened(S[np.ix_(own, own)], r[own])
            x, P = update(assembly, x, P, weights, self.iterations)
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            raise EstimationError(f"t = {epoch.t} s: the estimate is not finite")
        self.t, self.x, self.P = epoch.t, x, P
        rejected = count_rejected(assembly, weights)
        return FilterStep(
            *(epoch.t, x_predicted, P_predicted, F, x, P, weights, rejected, nis, used),
            innovations,
        )


def add_counts(counts: list[Mapping[str, int]], sensors: Mapping[str, object]) -> dict[str, int]:
    """Sum of counts by sensor, every sensor named."""
    return {name: sum(c.get(name, 0) for c in counts) for name in sensors}


#: Mean squared normalised residual, per row, beyond which a track is not to be trusted.
#: Consistent ones have 1; a lively linearisation error has a few.
TRUSTED = 30.0


def judge(
    rejected: Mapping[str, int], problem: Problem, misfit: float, rows: int
) -> tuple[Status, str]:
    """Degraded when a sensor lost more than half of its observations, when there was none
    to use, or when the squared residuals, `misfit` over `rows` rows, are far too large."""
    seen = dict.fromkeys(problem.sensors, 0)
    for epoch in problem.epochs:
        for m in epoch.measurements:
            seen[m.sensor] += len(m.z)
    for name, count in rejected.items():
        if count > 0.5 * seen[name]:
            return "degraded", f"{count} of {seen[name]} observations of {name} rejected"
    if not rows:
        return "degraded", "not one observation was used"
    if misfit > TRUSTED * rows:
        return "degraded", (
            f"squared residuals are {misfit / rows:.3g} times what the covariance says;"
            f" expected about 1, at most {TRUSTED:g}"
        )
    return "ok", ""


@dataclass(frozen=True, eq=False)
class FilterPass:
    """A filter's way through a pass: its steps, the time of each in s, why it stopped
    early (or ""), and the assembly of the whole pass."""

    steps: list[FilterStep]
    seconds: list[float]
    stopped: str
    assembly: Assembly

    def verdict(self, rejected: Mapping[str, int], problem: Problem) -> tuple[Status, str]:
        """Whether to trust what the filter found, by its innovations."""
        if self.stopped:
            return "diverged", self.stopped
        rows = sum(s.rows for s in self.steps)
        return judge(rejected, problem, sum(s.nis for s in self.steps), rows)

    def innovations(self, problem: Problem) -> dict[str, Innovations]:
        """Those of each sensor that saw anything."""
        found = {}
        for name in problem.sensors:
            seen = [(s.t, s.innovations[name]) for s in self.steps if name in s.innovations]
            if seen:
                t, v = np.array([t for t, _ in seen]), np.concatenate([v for _, v in seen])
                offsets = np.cumsum([0, *(len(v) for _, v in seen)])
                found[name] = Innovations(t, v, offsets)
        return found


def filter_pass(problem: Problem, iterations: int) -> FilterPass:
    """Filter all epochs, or as many as the filter survives."""
    assembly = Assembly(problem.layout, problem.processes, problem.sensors, problem.epochs)
    kalman = KalmanFilter(problem, iterations)
    steps: list[FilterStep] = []
    seconds: list[float] = []
    for k, epoch in enumerate(problem.epochs):
        start = time.perf_counter()
        try:
            steps.append(kalman.step(epoch, assembly.at(k)))
        except EstimationError as error:
            return FilterPass(steps, seconds, str(error), assembly)
        seconds.append(time.perf_counter() - start)
    return FilterPass(steps, seconds, "", assembly)


def nan_tail(values: list[Array], count: int, shape: tuple[int, ...]) -> Array:
    """(count, *shape): the values, then NaN for the epochs that were never reached."""
    out = np.full((count, *shape), np.nan)
    if values:
        out[: len(values)] = values
    return out


@dataclass(frozen=True)
class Ekf:
    """Extended Kalman filter: error state on the manifold, Joseph's covariance update.

    iterations: Gauss-Newton steps of each measurement update.
    """

    kind: ClassVar[str] = "ekf"
    iterations: int = 1

    def run(self, problem: Problem) -> Track:
        """Filter the whole pass."""
        start = time.perf_counter()
        done = filter_pass(problem, self.iterations)
        steps, seconds = done.steps, done.seconds
        n, size = problem.layout.dim, problem.layout.size
        rejected = add_counts([s.rejected for s in steps], problem.sensors)
        status, message = done.verdict(rejected, problem)
        return Track(
            name=self.kind,
            kind="filtered",
            layout=problem.layout,
            t=problem.times,
            x=nan_tail([s.x for s in steps], len(problem.epochs), (size,)),
            P=nan_tail([s.P for s in steps], len(problem.epochs), (n, n)),
            status=status,
            message=message,
            runtime_s=time.perf_counter() - start,
            step_s=np.array(seconds),
            rejected=rejected,
            innovations=done.innovations(problem),
        )


@dataclass(frozen=True)
class IteratedEkf(Ekf):
    """The same filter with updates iterated to convergence."""

    kind: ClassVar[str] = "iekf"
    iterations: int = ITERATIONS
