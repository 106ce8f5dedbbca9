"""Error-state extended Kalman filter, plain and with iterated updates."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.packing import packed_time, time_in
from relnav_graph.core.problem import Problem, padded
from relnav_graph.core.track import Track
from relnav_graph.errors import EstimationError, GeometryError
from relnav_graph.estimators.filter_sweep import FilterState, FilterSweep
from relnav_graph.estimators.first_sights import first_epochs, first_sights
from relnav_graph.estimators.source import Source, drive
from relnav_graph.estimators.weights import (
    losses_of,
    thresholds,
)
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.filter import (
    FAILURES,
    SENSOR_BROKE,
    FilterInput,
    FilterOutput,
    filter_epochs,
)

__all__ = [
    "Ekf",
    "FilterState",
    "FilterSweep",
    "IteratedEkf",
    "KalmanFilter",
    "filter_problem",
    "filter_step",
    "run_filter",
    "sweep",
]


#: Gauss-Newton steps of an iterated update, at most; the same wherever one is made.
ITERATIONS = 20


#: Does epochs k to end - 1, from a state, to be linearised a step ahead first: of `sweep`.
Steps = Callable[[FilterInput, int, int, FilterState, Array, FilterOutput, Indices], None]


class _At(Protocol):
    """Where a filter stands: t, s, of its newest epoch, None before the first."""

    @property
    def t(self) -> float | None: ...


At = TypeVar("At", bound=_At)
Done = TypeVar("Done", bound=FilterSweep)


def sweep(
    problem: Problem,
    assembly: Assembly,
    steps: Steps,
    start: FilterState | None = None,
    keep: bool = True,
    seconds: list[float] | None = None,
) -> FilterSweep:
    """Go through the epochs of an assembly by `steps`, or as many as the filter survives.

    start, keep, seconds: as of `run_filter`. Raises ModelError when a kernel breaks its contract.
    """
    considered = problem.considered_columns
    count, n, size = len(assembly.times), problem.layout.dim, problem.layout.size
    kept, moving = count if keep else 1, problem.layout.moving.dim
    out = FilterOutput(
        x_predicted=np.zeros((count, size)),
        P_predicted=np.zeros((count, n, n)),
        F=np.zeros((kept, n, n)),
        Q=np.zeros((1, moving, moving)),
        x=np.full((count, size), np.nan),
        P=np.full((count, n, n), np.nan),
        weights=np.ones(assembly.observations),
        nis=np.zeros(count),
        used=np.zeros(count, dtype=np.int64),
    )
    fixed = np.arange(moving, n)  # static states
    out.F[:, fixed, fixed] = 1.0
    given = FilterInput(
        epoch_offsets=assembly.epoch_offsets,
        row_offsets=assembly.row_offsets,
        kinds=assembly.layout.kinds,
        limits=thresholds(assembly, problem.gates),
        losses=losses_of(assembly, problem.losses),
        considered=considered,
    )
    at = FilterState.at_prior(problem) if start is None else start
    failure, reached = np.zeros(4, dtype=np.int64), 0
    nowhere = np.zeros(n)
    starts = first_epochs(assembly)
    begins = range(count) if seconds is not None else sorted({0, *starts})
    for k, end in pairwise([*begins, count]):
        begun, ahead = time.perf_counter(), nowhere
        if k in starts:
            ahead = first_sights(assembly.at(k), at.x, at.P)
            ahead[considered] = 0.0
        steps(given, k, end, at, ahead, out, failure)
        reached = int(failure[3]) if failure[0] else end
        if reached:
            t = float(assembly.times[reached - 1])
            at = FilterState(t, out.x[reached - 1], out.P[reached - 1])
        if failure[0]:
            out.x[reached:], out.P[reached:] = np.nan, np.nan
            break
        if seconds is not None:
            seconds.append(time.perf_counter() - begun)
    why = _why(assembly, failure)
    return FilterSweep(assembly, **out._asdict(), end=at, reached=reached, stopped=why)


def run_filter(
    problem: Problem,
    iterations: int,
    assembly: Assembly,
    start: FilterState | None = None,
    keep: bool = True,
    seconds: list[float] | None = None,
) -> FilterSweep:
    """Filter the epochs of an assembly, or as many as the filter survives.

    iterations: Gauss-Newton steps of each measurement update; start: where the filter stands
    before the first epoch, by default the prior; keep: F of all epochs, for a smoother;
    seconds: gets the time of each epoch, s. Considered blocks have no gain. Raises ModelError when
    a kernel breaks its contract, InputError on considered blocks with more than one iteration.
    """
    if iterations > 1:
        problem.expect_none_considered("a filter with iterated updates")

    def steps(given: FilterInput, k: int, end: int, at: FilterState, *rest: Any) -> None:
        filter_epochs(assembly.tables, given, iterations, k, end, at.x, at.P, *rest)

    return sweep(problem, assembly, steps, start, keep, seconds)


def advanced(
    problem: Problem,
    state: At,
    epoch: Epoch,
    assembly: Assembly | None,
    through: Callable[[Assembly, At], Done],
) -> Done:
    """What a filter leaves that goes `through` one more epoch from a state.

    assembly: of this epoch, where the caller has it already. Raises EstimationError when the state
    cannot be propagated or updated, or is no longer finite, ModelError when a kernel breaks its
    contract.
    """
    if assembly is None:
        assembly = Assembly.ahead(problem, epoch, state.t)
    done = through(assembly, state)
    if done.stopped:
        raise EstimationError(done.stopped)
    return done


def filter_step(
    problem: Problem,
    iterations: int,
    state: FilterState,
    epoch: Epoch,
    assembly: Assembly | None = None,
) -> FilterSweep:
    """Predict from a state to an epoch and update with its measurements.

    The new state is the `end` of what it gives. assembly, and what it raises: as of `advanced`.
    """
    return advanced(problem, state, epoch, assembly, partial(run_filter, problem, iterations))


def _why(assembly: Assembly, failure: Indices) -> str:
    """Why a filter stopped, or "". Raises ModelError when a kernel broke its contract."""
    stage, which, status, k = (int(v) for v in failure)
    if not stage:
        return ""
    if stage in FAILURES:
        return f"t = {assembly.times[k]} s: {FAILURES[stage]}"
    lag = len(assembly.times) - len(assembly.tables.starts)
    try:
        if stage == SENSOR_BROKE:
            assembly.check(np.array([status]), which)
        assembly.check_propagated(np.array([k - lag, which, status]))
    except GeometryError as error:
        return f"t = {assembly.times[k]} s: {error}"
    raise AssertionError("unreachable")


@dataclass(frozen=True, eq=False)
class KalmanState:
    """A filter at one epoch; see `relnav_graph.estimators.online.driver.EngineState`."""

    t: float | None
    x: Array
    P: Array
    done: FilterSweep | None = None


class KalmanEngine:
    """The filter, driven online."""

    compact = True

    def __init__(self, problem: Problem, iterations: int) -> None:
        self.problem, self.iterations = problem, iterations

    def begin(self) -> KalmanState:
        """At the prior, before the first epoch."""
        return KalmanState(None, self.problem.prior.x, self.problem.prior.P)

    def through(
        self, assembly: Assembly, start: KalmanState, seconds: list[float] | None = None
    ) -> FilterSweep:
        """Filter the epochs of an assembly, or as many as the filter survives.

        seconds: gets the time of each epoch, s. Raises ModelError when a kernel breaks its
        contract.
        """
        at = FilterState(start.t, start.x, start.P)
        return run_filter(self.problem, self.iterations, assembly, at, False, seconds)

    def advance(
        self, state: KalmanState, epoch: Epoch, assembly: Assembly | None = None
    ) -> KalmanState:
        """Predict and update. Raises as `advanced`."""
        done = advanced(self.problem, state, epoch, assembly, self.through)
        return KalmanState(*done.end, done)

    def grown(self, state: KalmanState, before: KalmanEngine) -> KalmanState:
        """The state of an engine whose problem has fewer numbered blocks."""
        x, P = padded(self.problem.prior, state.x, state.P)
        return KalmanState(state.t, x, P, state.done)

    def save(self, state: KalmanState) -> dict[str, Array]:
        """t (NaN before the first epoch), x, P."""
        return {"t": packed_time(state.t), "x": state.x, "P": state.P}

    def load(self, arrays: Mapping[str, Array]) -> KalmanState:
        """The state again."""
        t, x, P = (np.array(arrays[name]) for name in ("t", "x", "P"))
        return KalmanState(time_in(t), x, P)


def filter_problem(
    problem: Problem, iterations: int, keep: bool = True, seconds: list[float] | None = None
) -> FilterSweep:
    """Filter all epochs, or as many as the filter survives; see `run_filter`."""
    assembly = Assembly.of(problem)
    return run_filter(problem, iterations, assembly, None, keep, seconds)


class Filters(Protocol):
    """An engine that can also go through many epochs at once, from the state that it begins at."""

    def begin(self) -> Any: ...
    def advance(self, state: Any, epoch: Epoch, assembly: Assembly | None = None) -> Any: ...
    def through(
        self, assembly: Assembly, start: Any, seconds: list[float] | None = None
    ) -> FilterSweep: ...


class KalmanFilter:
    """What the filters share; each says by which engine it goes."""

    kind: ClassVar[str]

    def engine(self, problem: Problem) -> Filters:
        """For use online."""
        raise NotImplementedError

    def drive(self, source: Source) -> Track:
        """Filter epochs as they come."""
        driven = drive(source, self.engine(source.problem))
        # The same steps once more, in one compiled call, keep all that a track (and a smoother)
        # tells of them, and say why they stopped where they did.
        track = self.run(driven.problem)
        return replace(track, runtime_s=float(driven.step_s.sum()), step_s=driven.step_s)

    def run(self, problem: Problem) -> Track:
        """Filter the whole pass. Raises as `engine`."""
        return self.filtered(problem)[0]

    def filtered(self, problem: Problem) -> tuple[Track, FilterSweep]:
        """The track of the whole pass, and all that the filter left. Raises as `engine`."""
        start, seconds, engine = time.perf_counter(), list[float](), self.engine(problem)
        done = engine.through(Assembly.of(problem), engine.begin(), seconds)
        track = done.track(self.kind, problem, seconds)
        return replace(track, runtime_s=time.perf_counter() - start), done


@dataclass(frozen=True)
class Ekf(KalmanFilter):
    """Extended Kalman filter: error state on the manifold, updated by a QR decomposition.

    iterations: Gauss-Newton steps of each measurement update. Considered blocks have no gain, and
    all others count them (Schmidt 1966).
    """

    kind: ClassVar[str] = "ekf"
    iterations: int = 1

    def engine(self, problem: Problem) -> KalmanEngine:
        """For use online."""
        return KalmanEngine(problem, self.iterations)


@dataclass(frozen=True)
class IteratedEkf(Ekf):
    """The same filter with updates iterated to convergence."""

    kind: ClassVar[str] = "iekf"
    iterations: int = ITERATIONS
