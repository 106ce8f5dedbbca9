"""iSAM2 (Kaess et al. 2012): GTSAM's Bayes tree over our own factors, for graphs of any shape.

The tree holds the whole history: a `CustomFactor` of each model over one typed variable for each
block and epoch, static blocks once, and whatever native factors a user adds: a loop closure, a
prior, a variable of their own. A step adds the newest epoch, linearised at an iterated filter's
estimate, and eliminates the top of the tree anew. Nothing is relinearised meanwhile: thresholds,
which decide it variable by variable, cannot win where a new measurement moves every past state a
little (`relnav_graph.estimators.incremental`). Instead the whole is relinearised by force on the
same geometric schedule: the tree is built anew at its own estimate until that moves no more.

A tree cannot be copied in the time of a step. So the state is the log of what went into it, and the
tree a cache of the newest state, made again from the log for another one: after a failure, a late
measurement, from a journal. Both ways make the same updates, with the same results to the last bit.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Prior, Problem, padded
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import EstimationError, InputError
from relnav_graph.estimators.considered import considering
from relnav_graph.estimators.ekf import ITERATIONS, FilterState, FilterSweep, filter_step
from relnav_graph.estimators.first_sights import has_map, names_of, unseen
from relnav_graph.estimators.gauss_newton import Solution, is_small, solve_gated
from relnav_graph.estimators.parts import in_order
from relnav_graph.estimators.second_look import second_look
from relnav_graph.estimators.source import UNSOLVED, RecordedSource, Source, drive
from relnav_graph.estimators.trust import examine, gave_up
from relnav_graph.estimators.weights import reweighted
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.gtsam_extra import Extra, Piece, pieces
from relnav_graph.linear.gtsam_factors import prior_factor
from relnav_graph.linear.gtsam_graph import Graph, Keys, PassFactors, to_track
from relnav_graph.linear.gtsam_tree import Part, Tree, check_depth

__all__ = ["Extra", "ISAM2Smoother", "Isam2", "Keys", "TreeState"]

#: Forced updates of a scheduled relinearisation, at most, of each set of weights, and of the last.
FORCED, LAST = 4, 25
#: Length of the last step, in sigmas over all states together, that ends either.
NEAR, CONVERGED = 0.1, 1e-3


@dataclass(frozen=True, eq=False)
class TreeState:
    """The smoother at one epoch: an immutable value.

    t: s, None before the first epoch; x (size,), P (n, n): the newest estimate; count: epochs
    taken in; last: the newest part of the log; due: number of epochs at which the whole is
    relinearised next; done: the filter's part in the newest epoch; waiting: what the user gave for
    epochs that are still to come; own: values of all variables of the user's, as given.
    """

    t: float | None
    x: Array
    P: Array
    count: int = 0
    last: Part | None = None
    due: int = 1
    done: FilterSweep | None = None
    waiting: tuple[Piece, ...] = ()
    own: gtsam.Values = field(default_factory=gtsam.Values)

    def parts(self) -> list[Part]:
        """All parts, in order of time."""
        return in_order(self.last)


class ISAM2Smoother:
    """An engine of `relnav_graph.estimators.online.driver`; `finish` smooths the whole.

    ratio: by which the history grows between relinearisations; extra: of the user's, from the
    beginning.
    """

    #: Its state is the whole history: only the epochs can make it again.
    compact: ClassVar[bool] = False

    def __init__(self, problem: Problem, ratio: float, extra: Extra | None = None) -> None:
        self.problem, self.ratio, self._extra = problem, ratio, extra
        self.keys = Keys(problem.layout)
        self._make = PassFactors(problem, self.keys)
        self._cache: tuple[TreeState, Tree] | None = None

    def begin(self) -> TreeState:
        """At the prior, before the first epoch; what the user gave waits for its epochs."""
        start = TreeState(None, self.problem.prior.x, self.problem.prior.P)
        return start if self._extra is None else self.add(start, self._extra)

    def grown(self, state: TreeState, before: ISAM2Smoother) -> TreeState:
        """The state of an engine whose problem has fewer numbered blocks: with variables of the
        further ones, at their prior."""
        prior = self.problem.prior
        x, P = padded(prior, state.x, state.P)
        if state.last is None:
            return replace(state, x=x, P=P)
        tree, old = before._tree(state), before.problem.layout
        tree.keys, factors, values = self.keys, gtsam.NonlinearFactorGraph(), gtsam.Values()
        new = Layout((), self.problem.layout.statics.blocks[len(old.statics) :])
        more = Prior(prior.x[old.size :], prior.P[old.dim :, old.dim :])
        factors.push_back(prior_factor(new, more, self.keys.at(0, new)))
        self.keys.insert(values, 0, new, more.x)
        tree.update(factors, values, state.count - 1)
        at = np.concatenate([state.last.x, more.x])
        part = Part(state.last, (), None, np.zeros(0), factors, values, at, ())
        self._cache = replace(state, x=x, P=P, last=part), tree
        return self._cache[0]

    def save(self, state: TreeState) -> dict[str, Array]:
        """An empty mapping: see `compact`."""
        return {}

    def load(self, arrays: Mapping[str, Array]) -> TreeState:
        """The state before the first epoch; `arrays` is empty."""
        return self.begin()

    def advance(
        self, state: TreeState, epoch: Epoch, assembly: Assembly | None = None
    ) -> TreeState:
        """The state with one more epoch; assembly: of this, where the caller has it already. Raises
        EstimationError when there is none, or the history is too long for the stack."""
        check_depth(state.count + 1)
        layout = self.problem.layout
        if assembly is None:
            assembly = Assembly.ahead(self.problem, epoch, state.t)
        before = FilterState(state.t, state.x, state.P)
        done = filter_step(self.problem, ITERATIONS, before, epoch, assembly)
        try:
            after, tree = self._extended(state, epoch, done)
            # The tree has linearised what it sees first where the prior is: at once anew.
            new = unseen(assembly, state.P)
            if len(new) or after.count >= state.due:
                start = self.keys.trajectory(tree.best(), after.count)
                for block in names_of(assembly, new):
                    start[:, layout.stored(block)] = done.end.x[layout.stored(block)]
                after, tree = self._relinearized(after, tree, NEAR, FORCED, start)[:2]
                due = max(state.count + 2, math.ceil(self.ratio * after.count))
                after = replace(after, due=due)
        except (EstimationError, np.linalg.LinAlgError) as error:
            raise EstimationError(f"t = {epoch.t} s: {error}") from error
        self._cache = after, tree
        return after

    def _extended(self, s: TreeState, epoch: Epoch, done: FilterSweep) -> tuple[TreeState, Tree]:
        """The state with one more epoch, linearised where the filter has it."""
        k, keys, moving = s.count, self.keys, self.problem.layout.moving
        x, values, graph = np.array(done.end.x), gtsam.Values(), gtsam.NonlinearFactorGraph()
        factors = self._make.measurements(k, epoch, done.weights, {})
        if s.last is None:
            factors = self._make.prior() + factors
            values = keys.values(x[None])
        else:
            assert s.t is not None
            whiten = done.assembly.whitening_of(done.x_predicted, done.Q)[0]
            factors += self._make.interval(k, epoch, s.t, whiten)
            keys.insert(values, k, moving, x[: moving.size])
            x[moving.size :] = s.last.x[moving.size :]  # static blocks are in the tree already
        ready = tuple(piece for piece in s.waiting if piece.last <= k)
        waiting = tuple(piece for piece in s.waiting if piece.last > k)
        for factor in factors:
            graph.push_back(factor)
        part = Part(s.last, (epoch,), done.assembly, done.weights, graph, values, x, ())
        after = replace(s, t=done.end.t, count=k + 1, done=done, waiting=waiting)
        return self._updated(after, s, part, ready)

    def _updated(
        self, after: TreeState, before: TreeState, part: Part, ready: tuple[Piece, ...]
    ) -> tuple[TreeState, Tree]:
        """The state after one more part, with what the user gave for it, and its tree."""
        for piece in ready:
            for factor in piece.factors:
                part.factors.push_back(factor)
            part.values.insert(piece.values)
        part = replace(part, pieces=ready)
        tree = self._tree(before)
        tree.update(part.factors, part.values, after.count - 1)
        for key in (key for piece in ready for key in piece.own):
            tree.variable(key)  # raises where nothing tells it
        x, P = tree.newest(after.count - 1, part.x)
        return replace(after, x=x, P=P, last=part), tree

    def _tree(self, s: TreeState) -> Tree:
        """The tree of a state: the one at hand, which is then the caller's, or one made again."""
        cache, self._cache = self._cache, None
        if cache is not None and cache[0] is s:
            return cache[1]
        tree, count = Tree(self.keys), 0
        for part in s.parts():
            count += len(part.epochs)
            tree.update(part.factors, part.values, count - 1)
        return tree

    def _relinearized(
        self, s: TreeState, tree: Tree, tolerance: float, forced: int, start: Array
    ) -> tuple[TreeState, Tree, Assembly, float]:
        """The state with the whole history linearised anew, from the trajectory start (N, size),
        with new weights; its tree, all epochs, and the last step's length, in sigmas."""
        parts, problem = s.parts(), self.problem
        epochs = tuple(epoch for part in parts for epoch in part.epochs)
        own = [part.assembly for part in parts if part.assembly is not None]
        assembly = Assembly.join(own).within(problem.layout)
        weights = np.concatenate([part.weights for part in parts])
        given = tuple(piece for part in parts for piece in part.pieces)
        best = tree.best()
        found: tuple[Part, Tree, float] = parts[-1], tree, np.inf

        def solve(x: Array, weights: Array) -> Array:
            nonlocal best, found
            whiten = assembly.whitening(x[:-1])
            for _ in range(forced):
                # What is impossible there is left out.
                w = np.where(assembly.measure(x, weights).status == 0, weights, 0.0)
                factors = self._make.whole(epochs, assembly, w, whiten, {})
                values, tree = self.keys.values(x), Tree(self.keys)
                for piece in given:
                    values.insert(best.extract(list(piece.own)))
                    for factor in piece.factors:
                        factors.push_back(factor)
                tree.update(factors, values, s.count - 1)
                whole = Part(None, epochs, assembly, w, factors, values, x[-1], given)
                found = whole, tree, tree.distance()
                best = tree.best()
                if not np.isfinite(found[2]):
                    raise EstimationError("the estimate is not finite")
                x = self.keys.trajectory(best, s.count)
                if found[2] < tolerance:
                    break
            return x

        if has_map(problem.layout) and not given:  # undamped steps may lose a map that is new
            begun = solve_gated(assembly, problem, start, weights, tolerance)
            start, weights = begun.x, begun.weights
        reweighted(problem, assembly, start, weights, solve)
        part, tree, distance = found
        x, P = tree.newest(s.count - 1, part.x)
        return replace(s, x=x, P=P, last=part), tree, assembly, distance

    # --- what a user adds ------------------------------------------------------------------

    def add(self, state: TreeState, extra: Extra) -> TreeState:
        """The state with more factors and variables.

        Those that name epochs to come wait for them, and so do those that share a variable of the
        user's with them. Raises InputError on what does not fit, EstimationError where a variable
        is not determined.
        """
        found = pieces(extra, self.keys, state.x, state.own)
        ready = tuple(piece for piece in found if 0 < state.count > piece.last)
        own = gtsam.Values(state.own)
        own.insert(extra.values)
        waiting = *state.waiting, *(piece for piece in found if piece not in ready)
        after = replace(state, own=own, waiting=waiting)
        if not ready:
            if self._cache is not None and self._cache[0] is state:
                self._cache = after, self._cache[1]
            return after
        assert state.last is not None
        nothing = gtsam.NonlinearFactorGraph(), gtsam.Values()
        part = Part(state.last, (), None, np.zeros(0), *nothing, state.last.x, ())
        self._cache = self._updated(after, state, part, ready)
        return self._cache[0]

    def named(self, state: TreeState) -> int:
        """The largest number of an epoch that a factor of the user's names, -1 for none."""
        given = [piece for part in state.parts() for piece in part.pieces]
        return max((piece.last for piece in (*given, *state.waiting)), default=-1)

    def extra(self, arrays: Mapping[str, Array]) -> Extra:
        """What the user gave, from the arrays (bytes,) that its `save` made."""
        return Extra.load(arrays)

    def variables(self, state: TreeState) -> dict[int, tuple[Any, Array]]:
        """Value and covariance (d, d) of each variable of the user's in the tree, by key."""
        tree = self._tree(state)
        self._cache = state, tree
        own = [key for part in state.parts() for piece in part.pieces for key in piece.own]
        return {key: tree.variable(key) for key in own}

    def finish(self, state: TreeState) -> _End:
        """The whole trajectory, smoothed to convergence.

        Raises InputError where something of the user's still waits for an epoch.
        """
        if state.waiting:
            raise InputError(
                f"extra: {state.waiting[0]} name epoch {state.waiting[0].last}, and there are"
                f" {state.count} epochs, from 0 on"
            )
        tree = self._tree(state)
        begin = self.keys.trajectory(tree.best(), state.count)
        after, tree, assembly, distance = self._relinearized(state, tree, CONVERGED, LAST, begin)
        assert after.last is not None
        whole, values = after.last, tree.best()
        problem = replace(self.problem, epochs=whole.epochs)
        track = to_track(problem, Graph(whole.factors, values, self.keys), values)
        x, cost = self.keys.trajectory(values, state.count), whole.factors.error(values)
        return _End(track, assembly, x, whole.weights, cost, distance)

    def second_look(self, state: TreeState) -> tuple[Caution, ...]:
        """A second look at the whole, smoothed to convergence first; none with what a user has
        added, of which the chain knows nothing."""
        if state.waiting or any(part.pieces for part in state.parts()):
            return ()
        return _second_look(self.problem, self.finish(state))


@dataclass(frozen=True, eq=False)
class _End:
    """What a pass ends with: its smoothed track and all epochs; x (N, size), of all blocks;
    weights (observations,), square roots; the cost; the last step's length, in sigmas."""

    track: Track
    assembly: Assembly
    x: Array
    weights: Array
    cost: float
    distance: float


@dataclass(frozen=True)
class Isam2:
    """GTSAM's iSAM2 over our factors, relinearised whenever the history has grown by `ratio`.

    Gives two tracks: the current epoch's estimates as they came, and, as `smoothed`, the whole
    trajectory that it ends with.
    """

    kind: ClassVar[str] = "isam2"
    ratio: float = 1.3

    def engine(self, problem: Problem) -> ISAM2Smoother:
        """For use online."""
        return ISAM2Smoother(problem, self.ratio)

    def run(self, problem: Problem, extra: Extra | None = None) -> Track:
        """Estimate the pass epoch by epoch.

        extra: factors and variables of the user's. Raises InputError when they do not fit.
        """
        if extra is not None:
            keys, count = Keys(problem.layout), len(problem.epochs)
            for piece in pieces(extra, keys, problem.prior.x, gtsam.Values()):
                if piece.last >= count:
                    raise InputError(
                        f"extra: {piece} name epoch {piece.last}, and there are {count} epochs,"
                        " from 0 on"
                    )
        return considering(problem, lambda p: self.drive(RecordedSource(p), extra), self.kind)

    def drive(self, source: Source, extra: Extra | None = None) -> Track:
        """Estimate epochs as they come; extra: as of `run`."""
        smoother = ISAM2Smoother(source.problem, self.ratio, extra)
        ended = [smoother.begin()]

        def notice(state: TreeState) -> None:
            ended[0] = state

        done, begun = drive(source, smoother, notice), time.perf_counter()
        problem, layout, seconds = done.problem, done.problem.layout, 0.0
        last = estimates(layout, np.full_like(done.x, np.nan), np.full_like(done.P, np.nan))
        found = gave_up(problem, done.stopped)
        if not done.stopped:
            try:
                end = smoother.finish(ended[0])
                last = {name: getattr(end.track, name) for name in ("x", "P", "statics")}
                near = is_small(end.distance, end.x.shape[0] * layout.dim)
                unconverged = None if near else end.distance
                found = examine(problem, end.assembly, end.weights, end.cost, unconverged)
                found["extra"] = dict(end.track.extra)
                seconds = time.perf_counter() - begun
                if found["status"] == "ok" and extra is None:
                    found["cautions"] = _second_look(problem, end)
            except UNSOLVED as error:
                found = gave_up(problem, str(error))
        return done.tracks(self.kind, last, seconds or time.perf_counter() - begun, **found)


def _second_look(problem: Problem, end: _End) -> tuple[Caution, ...]:
    """A second look at the chain that a problem is without anything of a user's."""
    whiten = end.assembly.whitening(end.x[:-1])
    found = linearize(end.assembly, anchor_of(problem.prior), end.x, whiten, end.weights)
    solution = Solution(
        *(end.x, found.conditionals, found.cost, found.status, end.weights, end.distance, 0)
    )
    return second_look(end.assembly, problem.prior, solution, found.conditionals.marginals())
