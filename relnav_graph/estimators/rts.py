"""Rauch-Tung-Striebel smoother on the iterated filter."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import ITERATIONS, FilterSweep, filter_problem
from relnav_graph.linear.filter import FAILURES
from relnav_graph.linear.rts import backward

__all__ = ["Rts", "smooth", "smoothed_of"]


def smooth(done: FilterSweep, covariances: bool = True) -> tuple[Array, Array]:
    """Smoothed states (N, size) and covariances (N, n, n) of a filter's whole pass.

    covariances: whether they are wanted; without, there are none. Raises EstimationError
    when a predicted covariance is not positive definite.
    """
    x, P = np.empty_like(done.x), np.empty_like(done.P if covariances else done.P[:0])
    failure = np.zeros(4, dtype=np.int64)
    kept = done.x_predicted, done.P_predicted, done.F
    kinds = done.assembly.layout.kinds
    backward(kinds, done.x, done.P, *kept, int(covariances), x, P, failure)
    if failure[0]:
        t = done.assembly.times[failure[3]]
        raise EstimationError(f"backward pass: t = {t} s: {FAILURES[int(failure[0])]}")
    return x, P


def smoothed_of(done: FilterSweep, problem: Problem) -> dict[str, Any]:
    """status and message of a filter's whole pass, and layout, x, P and statics of it smoothed;
    NaN where it cannot be."""
    x, P = np.full_like(done.x, np.nan), np.full_like(done.P, np.nan)
    status, message = done.verdict(problem)
    if not done.stopped:
        try:
            x, P = smooth(done)
        except EstimationError as error:
            status, message = "diverged", str(error)
    return {"status": status, "message": message, **estimates(problem.layout, x, P)}


@dataclass(frozen=True)
class Rts:
    """Forward iterated filter, backward smoother; each update is linearised once only,
    at what the filter knew."""

    kind: ClassVar[str] = "rts"
    iterations: int = ITERATIONS

    def run(self, problem: Problem) -> Track:
        """Smooth the whole pass."""
        start = time.perf_counter()
        done = filter_problem(problem, self.iterations)
        return Track(
            name=self.kind,
            kind="smoothed",
            t=problem.times,
            **smoothed_of(done, problem),
            runtime_s=time.perf_counter() - start,
            rejected=done.rejected,
            left_out=done.left_out,
            downweighted=done.downweighted,
        )
