"""Filters that are begun from a batch: what becomes of a filter that is spared its beginning, when
it does not know yet where to linearise.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Innovations, Track, estimates
from relnav_graph.estimators.ekf import ITERATIONS, FilterState, run_filter
from relnav_graph.estimators.incremental import RATIO, IncrementalSmoother
from relnav_graph.estimators.source import UNSOLVED
from relnav_graph.estimators.trust import judge
from relnav_graph.estimators.weights import count_downweighted, count_rejected, lost
from relnav_graph.linear.assembly import Assembly

__all__ = ["EkfBatchStart", "IteratedEkfBatchStart"]

#: Length of the batch where the problem has no window, s.
SPAN = 100.0


@dataclass(frozen=True)
class EkfBatchStart:
    """Extended Kalman filter that goes on from a batch over the first `span` seconds.

    span: s; None for the problem's window, or, where it has none, `SPAN`; of a shorter pass, all
    of it. At the last epoch of the span stand the batch's mean and covariance, static blocks and
    cross-covariances included; from there the filter goes on, and has innovations. The epochs
    before it have what `incremental` says of each when it is the newest, since a filtered
    estimate knows nothing of later ones. iterations: Gauss-Newton steps of each update.
    """

    kind: ClassVar[str] = "ekf_batch_start"
    iterations: int = 1
    span: float | None = None

    def run(self, problem: Problem) -> Track:
        """Estimate the whole pass."""
        begun, seconds, layout = time.perf_counter(), list[float](), problem.layout
        epochs, whole = problem.epochs, Assembly.of(problem)
        x = np.full((len(epochs), layout.size), np.nan)
        P = np.full((len(epochs), layout.dim, layout.dim), np.nan)
        weights, innovations = np.ones(whole.observations), dict[str, Innovations]()
        smoother, count = IncrementalSmoother(problem, RATIO), self._epochs_of_batch(problem)
        try:
            for k, epoch in enumerate(epochs[:count]):
                started = time.perf_counter()
                x[k], P[k] = smoother.step(epoch, whole.at(k))
                if k == count - 1:
                    _, batch = smoother.finish()
                    x[k], P[k] = smoother.x, smoother.P
                seconds.append(time.perf_counter() - started)
            at = FilterState(epochs[count - 1].t, smoother.x, smoother.P)
            models = layout, problem.processes, problem.sensors
            rest = Assembly(*models, epochs[count:], at.t, checked=True)
            done = run_filter(problem, self.iterations, rest, at, keep=False, seconds=seconds)
            x[count:], P[count:], innovations = done.x, done.P, done.innovations()
            weights = np.concatenate([batch.weights, done.reached_weights])
            rows = int(whole.rows_of(weights > 0)[: whole.row_offsets[count]].sum())
            misfit, rows = 2 * batch.cost + float(done.nis.sum()), rows + int(done.used.sum())
            verdict = judge(lost(whole, weights), problem, misfit, rows)
            if done.stopped:
                verdict = "diverged", done.stopped
        except UNSOLVED as error:
            verdict = "diverged", str(error)
        return Track(
            name=self.kind,
            kind="filtered",
            t=problem.times,
            **estimates(layout, x, P),
            runtime_s=time.perf_counter() - begun,
            step_s=np.array(seconds),
            status=verdict[0],
            message=verdict[1],
            rejected=count_rejected(whole, weights),
            downweighted=count_downweighted(whole, weights),
            innovations=innovations,
        )

    def _epochs_of_batch(self, problem: Problem) -> int:
        """How many epochs are in the span; one at least."""
        span = SPAN if problem.window is None else problem.window
        end = problem.times[0] + (span if self.span is None else self.span) + SAME_TIME
        return max(int((problem.times <= end).sum()), 1)


@dataclass(frozen=True)
class IteratedEkfBatchStart(EkfBatchStart):
    """`ekf_batch_start` with the updates of its filter iterated to convergence."""

    kind: ClassVar[str] = "iekf_batch_start"
    iterations: int = ITERATIONS
