"""Batch smoother: the maximum a posteriori estimate of a whole pass."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.considered import considering
from relnav_graph.estimators.ekf import ITERATIONS, FilterSweep, filter_problem
from relnav_graph.estimators.first_sights import has_map
from relnav_graph.estimators.gauss_newton import is_small, solve_gated
from relnav_graph.estimators.incremental import RATIO, IncrementalSmoother
from relnav_graph.estimators.rts import smooth
from relnav_graph.estimators.second_look import conclude
from relnav_graph.estimators.source import UNSOLVED, RecordedSource, drive
from relnav_graph.estimators.trust import gave_up
from relnav_graph.linear.assembly import Assembly
from relnav_graph.maths.losses import Loss

__all__ = ["Batch", "begun"]


def _filtered(problem: Problem) -> FilterSweep:
    """The filter's pass to start from. A gate that has closed on the wrong estimate leaves most
    observations out for good: then the pass of a filter with a robust loss instead."""
    done = filter_problem(problem, ITERATIONS)
    if not problem.gates or done.verdict(problem)[0] == "ok":
        return done
    losses = {**problem.losses, **dict.fromkeys(problem.gates, Loss("huber"))}
    robust = filter_problem(replace(problem, gates={}, losses=losses), ITERATIONS)
    return done if robust.stopped else robust


def begun(problem: Problem) -> tuple[Assembly, Array, Array]:
    """All epochs, and a trajectory (N, size) and weights (observations,) to start from: of the
    iterated filter and its smoother; of the incremental smoother where there is a map to make, of
    which a filter makes a bad one. Raises EstimationError when there is none."""
    if has_map(problem.layout):
        smoother = IncrementalSmoother(problem, RATIO)
        whole = drive(RecordedSource(problem), smoother)
        if whole.stopped:
            raise EstimationError(whole.stopped)
        assembly, solution = smoother.finish()
        return assembly, solution.x, solution.weights
    done = _filtered(problem)
    if done.stopped:
        raise EstimationError(done.stopped)
    return done.assembly, smooth(done, covariances=False)[0], done.weights


@dataclass(frozen=True)
class Batch:
    """Maximum a posteriori estimate of the whole pass, all marginal covariances included.

    Starts from the iterated filter and its smoother, not from open-loop propagation,
    which a tumbling target soon leads astray; with unknown points, from `incremental`. Considered
    blocks must be static: they are held, and counted.
    """

    kind: ClassVar[str] = "batch"

    def run(self, problem: Problem) -> Track:
        """Smooth the whole pass."""
        return considering(problem, self._estimated, self.kind)

    def _estimated(self, problem: Problem) -> Track:
        """Smooth the whole pass, all blocks estimated."""
        start, seconds = time.perf_counter(), 0.0
        layout, count = problem.layout, len(problem.epochs)
        nothing = np.full((count, layout.size), np.nan), np.full((count, *2 * [layout.dim]), np.nan)
        ended = estimates(layout, *nothing)
        try:
            assembly, begin, weights = begun(problem)
            solution = solve_gated(assembly, problem, begin, weights)
            near = is_small(solution.distance, solution.conditionals.states)
            unconverged = None if near else solution.distance
            ended, found, seconds = conclude(problem, assembly, solution, start, unconverged)
        except UNSOLVED as error:
            found = gave_up(problem, str(error))
        return Track(
            name=self.kind,
            kind="smoothed",
            t=problem.times,
            runtime_s=seconds or time.perf_counter() - start,
            **ended,
            **found,
        )
