"""Incremental smoother: a square-root filter over the full history, re-anchored by Gauss-Newton.

Between relinearisations the graph is linear. What all data so far say of the newest epoch is a
triangle, and a step is the elimination of two epochs: constant cost. Each step leaves the
conditional of the epoch before, given the newest one; back-substitution through these gives the
whole trajectory. Thresholds that decide epoch by epoch what to relinearise cannot win here: a
line of sight leaves the heading of the orbital frame weakly observable, so that every new
measurement moves every past state a little. Instead the whole past is relinearised on a geometric
schedule (at epochs 1, 2, 3, 4, 6, 8, ... growing by a fixed ratio), which costs a constant amount
per epoch, amortised.

Of unknown points in cameras without depth, the first search of the target's motion
(`relnav_graph.estimators.first_motion`) gives the trajectory to begin with, and all epochs are
relinearised with each new one until the target has turned by a quarter: the size of the whole is so
weak that linear steps would lose it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem, lengthened
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import ITERATIONS, FilterState, FilterSweep, filter_step
from relnav_graph.estimators.first_motion import begun, motions, tells_no_depth, worth_a_search
from relnav_graph.estimators.first_sights import QUARTER, first_sights, turned
from relnav_graph.estimators.gauss_newton import Solution, solve, solve_gated
from relnav_graph.estimators.parts import in_order
from relnav_graph.estimators.second_look import conclude, second_look
from relnav_graph.estimators.source import UNSOLVED, RecordedSource, Source, drive
from relnav_graph.estimators.trust import gave_up
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Conditionals, anchor_of
from relnav_graph.linear.elimination import linearize

__all__ = ["Incremental", "IncrementalSmoother"]


#: By how much the history grows between relinearisations.
RATIO = 1.3
#: Epochs taken in one by one, at most, before they are relinearised among themselves.
WINDOW = 100
#: Length of the last step, in sigmas over all states together, of the whole in the end.
CONVERGED = 1e-3
#: By how much the cost of a motion is higher than the best one's, when it is given up.
UNLIKELY = 30.0


@dataclass(frozen=True, eq=False)
class _Part:
    """Adjoining epochs that were eliminated together; `before` it, another part or none.

    assembly, weights: of its own epochs; x (K, size): where these were linearised, after that of
    the newest epoch before them, if there is one; conditionals: of these states.
    """

    before: _Part | None
    assembly: Assembly
    weights: Array
    x: Array
    conditionals: Conditionals

    @property
    def anchor(self) -> Anchor:
        """What all data up to its last epoch say of that."""
        return self.conditionals.anchor(self.x[-1])


@dataclass(frozen=True, eq=False)
class SmootherState:
    """The smoother at one epoch: an immutable value.

    t: s, None before the first epoch; x (size,), P (n, n): the newest estimate;
    count: epochs taken in; last: the newest part, linked to those before, which other states
    share; singles: parts of one epoch, the newest ones; due: number of epochs at which the whole
    is relinearised next; done: the filter's part in the newest epoch; motions: states (size,)
    at the first epoch of the target's motions that are followed, see `first_motion`.
    """

    t: float | None
    x: Array
    P: Array
    count: int = 0
    last: _Part | None = None
    singles: int = 0
    due: int = 1
    done: FilterSweep | None = None
    motions: tuple[Array, ...] = ()

    def parts(self, count: int | None = None) -> list[_Part]:
        """The newest parts, by default all, in order of time."""
        return in_order(self.last, count)


class IncrementalSmoother:
    """One `step` per epoch; `finish` gives the whole smoothed trajectory.

    state: where it stands, an immutable value: to set it is to go back there.
    """

    def __init__(self, problem: Problem, ratio: float) -> None:
        problem.expect_none_considered("an incremental smoother")
        self.problem, self.ratio = problem, ratio
        self.no_depth = tells_no_depth(problem)
        self.state = self.begin()

    @property
    def x(self) -> Array:
        """The estimate at the newest epoch (size,)."""
        return self.state.x

    @property
    def P(self) -> Array:
        """Its covariance (n, n)."""
        return self.state.P

    def step(self, epoch: Epoch, assembly: Assembly | None = None) -> tuple[Array, Array]:
        """Take in one epoch; the estimate there, x (size,) and P (n, n).

        assembly: of this epoch, where the caller has it already.
        Raises EstimationError when the state cannot be propagated or updated, or is not
        determined or not finite; the smoother is then as it was before.
        """
        problem, s = self.problem, self.state
        if assembly is None:
            assembly = Assembly.ahead(problem, epoch, s.t)
        # Where the epoch is linearised: an iterated filter's estimate. Of a map without depths, all
        # epochs are linearised anew until the target's motion is known.
        iterations = 1 if self.no_depth else ITERATIONS
        done = filter_step(problem, iterations, FilterState(s.t, s.x, s.P), epoch, assembly)
        try:
            if s.motions:
                self.state = self._relinearized(s, 0.1, done)[0]
                return self.x, self.P
            after = self._extended(s, done)
            if after.count >= s.due:
                after = self._relinearized(after, 0.1)[0]
                after = replace(after, due=max(s.count + 2, math.ceil(self.ratio * after.count)))
            elif after.singles >= WINDOW:
                after = self._compacted(after)
        except (EstimationError, np.linalg.LinAlgError) as error:
            raise EstimationError(f"t = {epoch.t} s: {error}") from error
        self.state = after
        return self.x, self.P

    def _extended(self, s: SmootherState, done: FilterSweep) -> SmootherState:
        """The state with one more epoch; the epoch before is linearised at its latest estimate,
        but for a map without depths."""
        layout, assembly, x = self.problem.layout, done.assembly, done.end.x[None]
        n = layout.moving.dim
        whiten = np.zeros((0, n, n))
        if s.last is None:
            c = linearize(assembly, anchor_of(self.problem.prior), x, whiten, done.weights)
        else:
            begin = s.x
            if self.no_depth:
                # The size of the whole is so weak that it must stay as it is where epochs are
                # linearised: otherwise they seem to tell it.
                begin = s.last.x[-1]
                x = assembly.transition(begin[None])[0]
                x = layout.retract(x, first_sights(assembly, begin, s.P)[None])
            x = layout.held(np.stack([begin, x[0]]))
            whiten = assembly.whitening_of(done.x_predicted, done.Q)
            c = linearize(assembly.preceded(), s.last.anchor, x, whiten, done.weights)
        last = _Part(s.last, assembly, done.weights, x, c.conditionals)
        after = self._moved(s, last, last.conditionals.solution()[-1])
        return replace(after, t=done.end.t, count=s.count + 1, singles=s.singles + 1, done=done)

    def _moved(self, s: SmootherState, last: _Part, d: Array) -> SmootherState:
        """The state that ends with a part; d (n,): the step of its last epoch, where that is to
        be taken."""
        layout, x = self.problem.layout, last.x[-1]
        x, J = layout.retract(x, d), layout.right_jacobian(d)
        P = J @ last.conditionals.last_covariance() @ J.T
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            raise EstimationError("the estimate is not finite")
        return replace(s, x=x, P=0.5 * (P + P.T), last=last)

    def _trajectory(self, s: SmootherState, parts: list[_Part]) -> Array:
        """Present estimate (K, size) of the states of the newest parts, by back-substitution."""
        layout, out = parts[-1].assembly.layout, [s.x[None]]
        for part in reversed(parts):
            end = layout.local(part.x[-1], out[-1][0])
            out.append(layout.retract(part.x, part.conditionals.solution(end))[:-1])
        return np.concatenate(out[::-1])

    def _gathered(self, s: SmootherState, parts: list[_Part]) -> tuple[Assembly, Array, Array]:
        """Epochs, weights (observations,) and present estimate (K, size) of the newest parts."""
        assembly = Assembly.join([part.assembly for part in parts])
        weights = np.concatenate([part.weights for part in parts])
        return assembly, weights, self._trajectory(s, parts)

    def _compacted(self, s: SmootherState) -> SmootherState:
        """The state with its newest epochs as one part, relinearised among themselves."""
        parts = s.parts(s.singles)
        before = parts[0].before
        assert before is not None
        assembly, weights, x = self._gathered(s, parts)
        solution = solve(assembly.preceded(), before.anchor, x, weights, tolerance=0.1)
        last = _Part(before, assembly, weights, solution.x, solution.conditionals)
        return replace(self._moved(s, last, np.zeros(self.problem.layout.dim)), singles=0)

    def _relinearized(
        self, s: SmootherState, tolerance: float, newest: FilterSweep | None = None
    ) -> tuple[SmootherState, Assembly, Solution]:
        """Gauss-Newton over the whole history, and one epoch more."""
        layout, parts = self.problem.layout, s.parts()
        assemblies, weights = [p.assembly for p in parts], [p.weights for p in parts]
        x = self._trajectory(s, parts)
        if newest is not None:
            one, ahead = newest.assembly, newest.x_predicted
            step = first_sights(one, s.x, s.P)
            assemblies.append(one)
            weights.append(np.ones(one.observations))
            x = np.concatenate([x, layout.retract(ahead, step[None])])
            s = replace(s, t=newest.end.t, count=s.count + 1, done=newest)
        assembly = Assembly.join(assemblies)
        solution, followed = self._best(s, assembly, x, np.concatenate(weights), tolerance)
        last = _Part(None, assembly, solution.weights, solution.x, solution.conditionals)
        after = self._moved(s, last, np.zeros(layout.dim))
        after = replace(after, singles=0, motions=followed)
        if newest is not None:
            after = replace(after, due=max(after.count + 1, s.due))
        return after, assembly, solution

    def _best(
        self, s: SmootherState, assembly: Assembly, x: Array, weights: Array, tolerance: float
    ) -> tuple[Solution, tuple[Array, ...]]:
        """The best solution, from the trajectory x (N, size) or that of another motion; and the
        motions to follow, which are not much worse."""
        problem, prior, others = self.problem, self.problem.prior, s.motions[1:]
        starts, everything = [(x, weights)], np.ones(assembly.observations)
        if not s.motions:
            if self.no_depth and worth_a_search(assembly, prior):
                with suppress(*UNSOLVED):
                    others = motions(assembly, prior)
            if not others or turned(problem.layout, x)[-1] > QUARTER:
                return solve_gated(assembly, problem, x, weights, tolerance), ()
            starts = []
        starts += [(begun(assembly, prior, other), everything) for other in others]
        found = list[Solution]()
        for start, w in starts:
            with suppress(*UNSOLVED):
                found.append(solve_gated(assembly, problem, start, w, tolerance))
        if not found:
            raise EstimationError("no motion of the target fits what is seen of it")
        # What a motion makes impossible to see counts against it.
        costs = [one.cost + UNLIKELY * float((one.weights == 0).sum()) for one in found]
        order = np.argsort(costs)
        near = [found[i].x[0] for i in order if costs[i] < min(costs) + UNLIKELY]
        best = found[order[0]]
        known = turned(problem.layout, best.x)[-1] > QUARTER
        return best, () if known else tuple(near)

    def finish(self) -> tuple[Assembly, Solution]:
        """Relinearise once more, to convergence: the whole trajectory, smoothed."""
        self.state, assembly, solution = self._relinearized(self.state, CONVERGED)
        return assembly, solution

    # --- as an engine of `relnav_graph.estimators.online.driver`
    # ------------------------------------

    #: Its state is the whole history: only the epochs can make it again.
    compact: ClassVar[bool] = False

    def begin(self) -> SmootherState:
        """At the prior, before the first epoch."""
        return SmootherState(None, self.problem.prior.x, self.problem.prior.P)

    def advance(
        self, state: SmootherState, epoch: Epoch, assembly: Assembly | None = None
    ) -> SmootherState:
        """The state with one more epoch; see `step`."""
        self.state = state
        self.step(epoch, assembly)
        return self.state

    def grown(self, state: SmootherState, before: IncrementalSmoother) -> SmootherState:
        """The state of an engine whose problem has fewer numbered blocks: linearised anew."""
        if state.last is None:
            return self.begin()
        problem, parts = self.problem, state.parts()
        layout, prior = problem.layout, problem.prior
        assembly, weights, x = self._gathered(state, parts)
        assembly, x = assembly.within(layout), lengthened(prior, x)
        system = linearize(assembly, anchor_of(prior), x, assembly.whitening(x[:-1]), weights)
        last = _Part(None, assembly, weights, x, system.conditionals)
        return replace(self._moved(state, last, last.conditionals.solution()[-1]), singles=0)

    def save(self, state: SmootherState) -> dict[str, Array]:
        """An empty mapping: see `compact`."""
        return {}

    def load(self, arrays: Mapping[str, Array]) -> SmootherState:
        """The state before the first epoch; `arrays` is empty."""
        return self.begin()

    def second_look(self, state: SmootherState) -> tuple[Caution, ...]:
        """A second look at the whole, smoothed to convergence first; the state stays."""
        _, assembly, solution = self._relinearized(state, CONVERGED)
        marginals = solution.conditionals.marginals()
        return second_look(assembly, self.problem.prior, solution, marginals)


@dataclass(frozen=True)
class Incremental:
    """A square-root filter over the full history, relinearised whenever that has grown by `ratio`.

    Gives two tracks: the current epoch's estimates as they came, and, as `smoothed`, the
    whole trajectory that it ends with.
    """

    kind: ClassVar[str] = "incremental"
    ratio: float = RATIO

    def engine(self, problem: Problem) -> IncrementalSmoother:
        """For use online."""
        return IncrementalSmoother(problem, self.ratio)

    def run(self, problem: Problem) -> Track:
        """Estimate the pass epoch by epoch."""
        return self.drive(RecordedSource(problem))

    def drive(self, source: Source) -> Track:
        """Estimate epochs as they come."""
        smoother = self.engine(source.problem)
        done, begun = drive(source, smoother), time.perf_counter()
        problem, layout, seconds = done.problem, done.problem.layout, 0.0
        ended = estimates(layout, np.full_like(done.x, np.nan), np.full_like(done.P, np.nan))
        found = gave_up(problem, done.stopped)
        if not done.stopped:
            try:
                assembly, solution = smoother.finish()
                ended, found, seconds = conclude(problem, assembly, solution, begun)
            except UNSOLVED as error:
                found = gave_up(problem, str(error))
        return done.tracks(self.kind, ended, seconds or time.perf_counter() - begun, **found)
