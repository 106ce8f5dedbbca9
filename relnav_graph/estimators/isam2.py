"""Incremental smoother: iSAM2 over the full history, one variable per epoch.

Between relinearisations the graph is linear in each epoch's tangent at a fixed reference
state, and iSAM2's Bayes tree takes a new epoch at constant cost. Thresholds that decide
variable by variable what to relinearise cannot win here: a line of sight leaves the
heading of the orbital frame weakly observable, so that every new measurement moves every
past state a little. Instead the whole past is relinearised on a geometric schedule (at
epochs 1, 2, 3, 4, 6, 8, ... growing by a fixed ratio), which costs a constant amount per
epoch, amortised; the tree is then built anew at the new references.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import ITERATIONS, FilterState, FilterSweep, filter_step
from relnav_graph.estimators.gauss_newton import Solution, solve, solve_gated
from relnav_graph.estimators.second_look import second_look
from relnav_graph.estimators.source import UNSOLVED, RecordedSource, Source, drive
from relnav_graph.estimators.trust import judge
from relnav_graph.estimators.weights import count_downweighted, count_rejected, lost
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.elimination import Anchor, Conditionals
from relnav_graph.linear.gtsam_chain import epoch_factor, interval_factor
from relnav_graph.linear.intervals import process_rows

__all__ = ["IncrementalSmoother", "Isam2"]

#: Epochs in the Bayes tree, at most: GTSAM's bookkeeping after each update grows with them.
WINDOW = 100


def _new_tree() -> gtsam.ISAM2:
    params = gtsam.ISAM2Params()
    # The default Cholesky throws on ordinary ratios of process to state noise.
    params.setFactorization("QR")
    params.enableRelinearization = False
    params.findUnusedFactorSlots = True
    # An ordinary step solves the top of the tree only, where the newest epoch lives; the
    # past is brought up to date when somebody asks for it.
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(1e10))
    return gtsam.ISAM2(params)


def _insert(tree: gtsam.ISAM2, factors: list[gtsam.JacobianFactor], key: int, n: int) -> None:
    """Add the factors of a new key to the tree."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for factor in factors:
        graph.push_back(gtsam.LinearContainerFactor(factor))
    values.insert(key, np.zeros(n))
    tree.update(graph, values)


@dataclass(frozen=True, eq=False)
class _Settled:
    """Epochs that have left the tree: where they are linearised, x (N, size), and their
    conditionals."""

    x: Array
    conditionals: Conditionals


#: What went into a tree, key by key.
_Log = tuple[tuple[int, list[gtsam.JacobianFactor]], ...]
_SPOILT: _Log = ((-1, []),)


@dataclass(frozen=True, eq=False)
class SmootherState:
    """The smoother at one epoch, without its tree, which can be rebuilt from the log.

    t: s, None before the first epoch; x (size,), P (n, n): the newest estimate;
    count: epochs taken in; assemblies, weights: adjoining parts, the past, then by epoch;
    references: of the tree's epochs, the newest ones; due: number of epochs at which the
    whole is relinearised next; done: the filter's part in the newest epoch.
    """

    t: float | None
    x: Array
    P: Array
    count: int = 0
    assemblies: tuple[Assembly, ...] = ()
    weights: tuple[Array, ...] = ()
    settled: tuple[_Settled, ...] = ()
    references: tuple[Array, ...] = ()
    log: _Log = ()
    due: int = 1
    done: FilterSweep | None = None


class IncrementalSmoother:
    """One `step` per epoch; `finish` gives the whole smoothed trajectory.

    state: where it stands, an immutable value: to set it is to go back there.
    """

    def __init__(self, problem: Problem, ratio: float) -> None:
        self.problem, self.ratio = problem, ratio
        self.state = SmootherState(None, problem.prior.x, problem.prior.P)
        self._tree, self._tree_log = _new_tree(), self.state.log

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
        before = self.state
        try:
            self._step(epoch, assembly)
        except BaseException as error:  # Ctrl-C too
            self.state = before
            if isinstance(error, np.linalg.LinAlgError):
                raise EstimationError(f"t = {epoch.t} s: {error}") from error
            raise
        return self.x, self.P

    def _step(self, epoch: Epoch, assembly: Assembly | None) -> None:
        problem, s = self.problem, self.state
        if assembly is None:
            layout, models = problem.layout, (problem.processes, problem.sensors)
            assembly = Assembly(layout, *models, [epoch], s.t)
        # The reference: where an iterated filter goes from here.
        done = filter_step(problem, ITERATIONS, FilterState(s.t, s.x, s.P), epoch, assembly)
        self.state = replace(
            s,
            t=epoch.t,
            x=done.end.x,
            P=done.end.P,
            count=s.count + 1,
            assemblies=(*s.assemblies, assembly),
            weights=(*s.weights, done.weights),
            references=(*s.references, done.end.x),
            done=done,
        )
        if self.state.count >= s.due:
            self._relinearize(self._trajectory(self.x), 0.1)
            count = self.state.count
            due = max(count + 1, math.ceil(self.ratio * count))
            self.state = replace(self.state, due=due)
            return
        self._extend(done, s.x)
        if len(self.state.references) > WINDOW:
            self._compact()

    def _take(self, x: Array, P: Array) -> None:
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            raise EstimationError(f"t = {self.state.t} s: the estimate is not finite")
        self.state = replace(self.state, x=x, P=P)

    def _tree_of(self, log: _Log) -> gtsam.ISAM2:
        """The tree of a log. One that another step has grown or spoilt is built anew, key by
        key, which gives the same numbers."""
        if self._tree_log is not log:
            self._tree, self._tree_log = _new_tree(), log
            for key, factors in log:
                _insert(self._tree, factors, key, self.problem.layout.dim)
        return self._tree

    def _grow(self, key: int, factors: list[gtsam.JacobianFactor]) -> gtsam.ISAM2:
        """The tree with a new key."""
        log = self.state.log
        tree, self._tree_log = self._tree_of(log), _SPOILT
        _insert(tree, factors, key, self.problem.layout.dim)
        self._tree_log = (*log, (key, factors))
        self.state = replace(self.state, log=self._tree_log)
        return tree

    def _extend(self, done: FilterSweep, before: Array) -> None:
        """Add the newest epoch to the tree, linearised where the filter has been in it;
        before (size,): the estimate at the epoch before, where the filter set out."""
        layout, key = self.problem.layout, self.state.count - 1
        x, assembly, weights = self.state.references[-1], done.assembly, done.weights
        whiten = assembly.whitening_of(done.x_predicted, done.Q)
        process = process_rows(layout, done.x_predicted, x[None], done.F, whiten)
        # The older end is linearised at its latest estimate, reference (+) d; the tree's
        # variable is a perturbation of the reference: the chain rule of the retraction.
        d = layout.local(self.state.references[-2], before)
        A = process.A[0] @ layout.right_jacobian(d)
        factors = [interval_factor(key - 1, A, process.B[0], process.e[0] - A @ d)]
        if weights.any():
            rows = assembly.measure(x[None], weights)
            factors.append(epoch_factor(key, rows.H, rows.r))
        try:
            tree = self._grow(key, factors)
            d, P = tree.calculateEstimateVector(key), tree.marginalCovariance(key)
        except RuntimeError as error:
            raise EstimationError(
                f"t = {self.state.t} s: iSAM2 at epoch {key}: {str(error)[:200]}"
            ) from error
        J = layout.right_jacobian(d)
        P = J @ P @ J.T
        self._take(layout.retract(x, d), 0.5 * (P + P.T))

    def _in_tree(self, newest: Array) -> Array:
        """Present estimate (epochs, size) of the tree's epochs: references moved by the tree.

        newest (size,): that of the last one, which may not be in it yet.
        """
        layout, out = self.problem.layout, np.array(self.state.references)
        first = self.state.count - len(out)
        if self.state.log:
            best = self._tree_of(self.state.log).calculateBestEstimate()
            for k in range(len(out) - 1):
                out[k] = layout.retract(out[k], best.atVector(first + k))
        out[-1] = newest
        return out

    def _trajectory(self, newest: Array) -> Array:
        """Present estimate of all epochs (N, size): for those that have left the tree, by
        back-substitution through their conditionals."""
        layout, parts = self.problem.layout, [self._in_tree(newest)]
        for part in reversed(self.state.settled):  # each ends where the next one begins
            end = layout.local(part.x[-1], parts[-1][0])
            parts.append(layout.retract(part.x, part.conditionals.solution(end))[:-1])
        return np.concatenate(parts[::-1])

    def _settle(self, solution: Solution, parts: int, assembly: Assembly) -> None:
        """Replace the last parts of the past, now joined, by their conditionals. The tree begins
        anew with what these say of the newest epoch."""
        R = solution.conditionals.R[-1]
        inverse = np.linalg.inv(R)
        self._take(solution.x[-1], inverse @ inverse.T)
        s, key = self.state, self.state.count - 1
        self.state = replace(
            s,
            settled=(*s.settled, _Settled(solution.x, solution.conditionals)),
            assemblies=(*s.assemblies[:-parts], assembly),
            weights=(*s.weights[:-parts], solution.weights),
            references=(self.x,),
            log=(),
        )
        self._grow(key, [epoch_factor(key, R, -solution.conditionals.d[-1])])

    def _compact(self) -> None:
        """Move the tree's epochs out of it. They are relinearised among themselves now, and not
        again until the whole history is."""
        s = self.state
        parts = len(s.references) - 1  # the first one's measurements are in the summary
        assembly = Assembly.join(s.assemblies[-parts:])
        weights = np.concatenate(s.weights[-parts:])
        settled, x = s.settled[-1], self._in_tree(self.x)
        c = settled.conditionals
        summary = Anchor(settled.x[-1], c.R[-1], c.d[-1])
        solution = solve(assembly.preceded(), summary, x, weights, tolerance=0.1)
        self._settle(solution, parts, assembly)

    def _relinearize(self, x: Array, tolerance: float) -> tuple[Assembly, Solution]:
        """Gauss-Newton over the whole history from x, and a new tree at its result."""
        assembly = Assembly.join(self.state.assemblies)
        weights = np.concatenate(self.state.weights)
        solution = solve_gated(assembly, self.problem, x, weights, tolerance)
        self.state = replace(self.state, settled=())
        self._settle(solution, len(self.state.assemblies), assembly)
        return assembly, solution

    def finish(self) -> tuple[Assembly, Solution]:
        """Relinearise once more, to convergence: the whole trajectory, smoothed."""
        return self._relinearize(self._trajectory(self.x), 1e-3)

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

    def save(self, state: SmootherState) -> dict[str, Array]:
        """An empty mapping: see `compact`."""
        return {}

    def load(self, arrays: Mapping[str, Array]) -> SmootherState:
        """The state before the first epoch; `arrays` is empty."""
        return self.begin()


@dataclass(frozen=True)
class Isam2:
    """iSAM2 with QR, relinearised whenever the history has grown by `ratio`.

    Gives two tracks: the current epoch's estimates as they came, and, as `smoothed`, the
    whole trajectory that it ends with.
    """

    kind: ClassVar[str] = "isam2"
    ratio: float = 1.3

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
        problem, status, message = done.problem, "diverged", done.stopped
        x, P = np.full_like(done.x, np.nan), np.full_like(done.P, np.nan)
        rejected, downweighted = dict.fromkeys(problem.sensors, 0), dict[str, int]()
        cautions, seconds = tuple[Caution, ...](), 0.0
        if not done.stopped:
            try:
                assembly, solution = smoother.finish()
                x, P = solution.x, solution.conditionals.covariances()
                rejected |= count_rejected(assembly, solution.weights)
                downweighted = count_downweighted(assembly, solution.weights)
                away = lost(assembly, solution.weights)
                rows = assembly.rows_of(solution.weights > 0)
                status, message = judge(away, problem, 2 * solution.cost, int(rows.sum()))
                seconds = time.perf_counter() - begun
                if status == "ok":
                    cautions = second_look(assembly, problem.prior, solution, P)
            except UNSOLVED as error:
                message = str(error)
        track = done.track(
            self.kind,
            status=status,
            message=message,
            rejected=rejected,
            downweighted=downweighted,
            cautions=cautions,
        )
        smoothed = replace(
            track,
            name=f"{self.kind}_smoothed",
            kind="smoothed",
            x=x,
            P=P,
            runtime_s=track.runtime_s + (seconds or time.perf_counter() - begun),
            step_s=None,
        )
        return replace(track, smoothed=smoothed)
