"""Filters that are begun from a batch: what becomes of a filter that is spared its beginning, when
it does not know yet where to linearise.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.core.packing import pack, packed_time, time_in, under, unpack
from relnav_graph.core.problem import Problem, padded
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import (
    ITERATIONS,
    FilterState,
    FilterSweep,
    filter_step,
    run_filter,
)
from relnav_graph.estimators.gauss_newton import Solution
from relnav_graph.estimators.incremental import RATIO, IncrementalSmoother, SmootherState
from relnav_graph.estimators.rts import smooth
from relnav_graph.estimators.source import UNSOLVED, Driven, RecordedSource, Source, drive
from relnav_graph.estimators.trust import judge
from relnav_graph.estimators.weights import count_downweighted, count_rejected, left_out, lost
from relnav_graph.linear.assembly import Assembly

__all__ = ["BatchStartEngine", "BatchStarted", "EkfBatchStart", "IteratedEkfBatchStart"]

#: Length of the batch where the problem has no window, s.
SPAN = 100.0


@dataclass(frozen=True, eq=False)
class BatchStarted:
    """Where the estimator stands, see `relnav_graph.estimators.online.engine.EngineState`.

    first: time of the first epoch, s; batch: the smoother, within the span, and epochs, those that
    it has taken in; None and none after it. ended: of the state that ended it, where the filter
    goes on from, and the batch.
    """

    t: float | None
    x: Array
    P: Array
    done: FilterSweep | None = None
    first: float = np.nan
    batch: SmootherState | None = None
    epochs: tuple[Epoch, ...] = ()
    ended: tuple[FilterState, Solution] | None = None


class BatchStartEngine:
    """A smoother of all epochs of the first `span` seconds, and the filter that goes on from it.

    iterations: of the filter's updates; span: s.
    """

    compact = True

    def __init__(self, problem: Problem, iterations: int, span: float) -> None:
        self.problem, self.iterations, self.span = problem, iterations, span
        self.smoother = IncrementalSmoother(problem, RATIO)

    def begin(self) -> BatchStarted:
        """At the prior, before the first epoch."""
        begun = self.smoother.begin()
        return BatchStarted(None, begun.x, begun.P, batch=begun)

    def advance(
        self, state: BatchStarted, epoch: Epoch, assembly: Assembly | None = None
    ) -> BatchStarted:
        """The state with one more epoch. Raises EstimationError when there is no estimate,
        ModelError when a kernel breaks its contract."""
        first = epoch.t if state.t is None else state.first
        if state.batch is not None and epoch.t <= first + self.span + SAME_TIME:
            batch = self.smoother.advance(state.batch, epoch, assembly)
            epochs = (*state.epochs, epoch)
            state = BatchStarted(batch.t, batch.x, batch.P, batch.done, first, batch, epochs)
            return state if epoch.t < first + self.span - SAME_TIME else self.ended(state)
        ended = None
        if state.batch is not None:  # no epoch is at the span's end
            state = self.ended(state)
            ended = state.ended
        before = FilterState(state.t, state.x, state.P)
        done = filter_step(self.problem, self.iterations, before, epoch, assembly)
        return BatchStarted(*done.end, done, first, ended=ended)

    def ended(self, state: BatchStarted) -> BatchStarted:
        """A state within the span, where the filter goes on from: with the batch's estimate."""
        assert state.batch is not None
        self.smoother.state = state.batch
        _, solution = self.smoother.finish()
        s = self.smoother.state
        ended = FilterState(s.t, s.x, s.P), solution
        return BatchStarted(*ended[0], state.done, state.first, ended=ended)

    def grown(self, state: BatchStarted, before: BatchStartEngine) -> BatchStarted:
        """The state of an engine whose problem has fewer numbered blocks."""
        if state.batch is None:
            x, P = padded(self.problem.prior, state.x, state.P)
            return replace(state, x=x, P=P, ended=None)
        batch = self.smoother.grown(state.batch, before.smoother)
        return replace(state, x=batch.x, P=batch.P, batch=batch)

    def save(self, state: BatchStarted) -> dict[str, Array]:
        """t (NaN before the first epoch), first, x, P and, within the span, ``epochs.*``: see
        `relnav_graph.core.packing.pack`."""
        t = packed_time(state.t)
        out = {"t": t, "first": np.array(state.first), "x": state.x, "P": state.P}
        if state.batch is not None:
            out |= {f"epochs.{name}": array for name, array in pack(state.epochs).items()}
        return out

    def load(self, arrays: Mapping[str, Array]) -> BatchStarted:
        """The state again; within the span by taking in its epochs."""
        if "epochs.times" in arrays:
            state = self.begin()
            for epoch in unpack(under(arrays, "epochs.")):
                state = self.advance(state, epoch)
            return state
        t, first, x, P = (np.array(arrays[name]) for name in ("t", "first", "x", "P"))
        return BatchStarted(time_in(t), x, P, first=float(first))


@dataclass(frozen=True)
class EkfBatchStart:
    """Extended Kalman filter that goes on from a batch over the first `span` seconds.

    span: s; None for the problem's window, or, where it has none, `SPAN`. At the end of the span
    stand the batch's mean and covariance, static blocks and cross-covariances included; from there
    the filter goes on, and has innovations. The epochs before, all of a shorter pass, have what
    `incremental` says of each when it is the newest, since a filtered estimate knows nothing of
    later ones. iterations: Gauss-Newton steps of each update. As `smoothed`, the whole pass: back
    over the filter (Rauch, Tung, Striebel), and through the batch's own elimination.
    """

    kind: ClassVar[str] = "ekf_batch_start"
    iterations: int = 1
    span: float | None = None

    def engine(self, problem: Problem) -> BatchStartEngine:
        """For use online."""
        span = SPAN if problem.window is None else problem.window
        return BatchStartEngine(problem, self.iterations, span if self.span is None else self.span)

    def run(self, problem: Problem) -> Track:
        """Estimate the pass epoch by epoch."""
        return self.drive(RecordedSource(problem))

    def drive(self, source: Source) -> Track:
        """Estimate epochs as they come."""
        engine, last = self.engine(source.problem), dict[bool, BatchStarted]()

        def notice(state: BatchStarted) -> None:
            if state.batch is not None or state.ended is not None:
                last[state.ended is not None] = state

        driven = drive(source, engine, notice)
        problem, begun = driven.problem, time.perf_counter()
        nothing = np.full_like(driven.x, np.nan), np.full_like(driven.P, np.nan)
        found: dict[str, Any] = {"status": "diverged", "message": driven.stopped}
        ended = estimates(problem.layout, *nothing)
        try:
            if True not in last and not driven.stopped:
                last[True] = engine.ended(last[False])
            if True in last and (batch := last[True].ended) is not None:
                found, ended = self._concluded(driven, *batch)
        except UNSOLVED as error:
            found["message"] = str(error)
        return driven.tracks(self.kind, ended, time.perf_counter() - begun, **found)

    def _concluded(
        self, driven: Driven, at: FilterState, batch: Solution
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """What the track has besides its states, and what the smoothed one has of its own.

        The filter's steps once more, in one compiled call, keep all that a smoother wants of them.
        """
        problem, whole = driven.problem, Assembly.of(driven.problem)
        layout, count = problem.layout, len(batch.x)
        models = layout, problem.processes, problem.sensors
        rest = Assembly(*models, problem.epochs[count:], at.t, checked=True)
        done = run_filter(problem, self.iterations, rest, at)
        weights = np.concatenate([batch.weights, done.reached_weights])
        rows = int(whole.rows_of(weights > 0)[: whole.row_offsets[count]].sum())
        misfit, rows = 2 * batch.cost + float(done.nis.sum()), rows + int(done.used.sum())
        verdict = judge(lost(whole, weights), problem, misfit, rows)
        if done.stopped:
            verdict = "diverged", done.stopped
        found = {
            "status": verdict[0],
            "message": verdict[1],
            "rejected": count_rejected(whole, weights),
            "left_out": left_out(whole, weights),
            "downweighted": count_downweighted(whole, weights),
            "innovations": done.innovations(),
        }
        x, P = np.full_like(driven.x, np.nan), np.full_like(driven.P, np.nan)
        ended: dict[str, Any] = {"innovations": {}}
        if not done.stopped:
            try:
                x[count - 1 :], P[count - 1 :] = smooth(_preceded(done, at))
                x[:count], P[:count] = _behind(layout, batch, x[count - 1], P[count - 1])
            except EstimationError as error:
                ended |= {"status": "diverged", "message": str(error)}
        return found, ended | estimates(layout, x, P)


def _preceded(done: FilterSweep, at: FilterState) -> FilterSweep:
    """A sweep with one more epoch in front, where it began, without measurements."""

    def led(first: Array, rest: Array) -> Array:
        return np.concatenate([first[None], rest])

    return replace(
        done,
        assembly=done.assembly.preceded() if len(done.x) else done.assembly,
        x=led(at.x, done.x),
        P=led(at.P, done.P),
        x_predicted=led(at.x, done.x_predicted),
        P_predicted=led(at.P, done.P_predicted),
        F=led(0.0 * at.P, done.F),
    )


def _behind(layout: Layout, batch: Solution, x_end: Array, P_end: Array) -> tuple[Array, Array]:
    """States x (N, size) and covariances P (N, n, n) of a batch whose last epoch later data have
    brought to x_end (size,), P_end (n, n): each epoch given the next one, as it was eliminated."""
    end = layout.local(batch.x[-1], x_end)
    steps, back = batch.conditionals.solution(end), layout.right_jacobian_inverse(end)
    P = batch.conditionals.marginals(back @ P_end @ back.T).whole()
    J = np.array([layout.right_jacobian(d) for d in steps])
    return layout.retract(batch.x, steps), J @ P @ J.transpose(0, 2, 1)


@dataclass(frozen=True)
class IteratedEkfBatchStart(EkfBatchStart):
    """`ekf_batch_start` with the updates of its filter iterated to convergence."""

    kind: ClassVar[str] = "iekf_batch_start"
    iterations: int = ITERATIONS
