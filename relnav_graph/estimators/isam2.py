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
from dataclasses import dataclass
from typing import ClassVar

import gtsam
import numpy as np
from numpy.typing import NDArray

from relnav_graph.assembly import Assembly
from relnav_graph.chain import chain_factors, epoch_factor, interval_factor
from relnav_graph.errors import EstimationError, GeometryError
from relnav_graph.estimators.batch import UNSOLVED, Solution, solve_gated
from relnav_graph.estimators.ekf import ITERATIONS, judge, nan_tail, predict, symmetric, update
from relnav_graph.estimators.gating import count_rejected, innovation_weights
from relnav_graph.problem import Epoch, Problem
from relnav_graph.track import Status, Track

__all__ = ["IncrementalSmoother", "Isam2"]

Array = NDArray[np.float64]


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


def _insert(tree: gtsam.ISAM2, factors: list[gtsam.JacobianFactor], keys: range, n: int) -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for factor in factors:
        graph.push_back(gtsam.LinearContainerFactor(factor))
    for key in keys:
        values.insert(key, np.zeros(n))
    tree.update(graph, values)


class IncrementalSmoother:
    """One `step` per epoch; `finish` gives the whole smoothed trajectory.

    x (size,) and P (n, n): the estimate at the newest epoch.
    """

    def __init__(self, problem: Problem, ratio: float) -> None:
        self.problem, self.ratio = problem, ratio
        self.epochs: list[Epoch] = []
        self.x, self.P = problem.prior.x, problem.prior.P
        self._references: list[Array] = []
        self._weights: list[Array] = []
        self._tree = _new_tree()
        self._relinearize_at = 1

    def _assemble(self, epochs: list[Epoch], t_before: float | None = None) -> Assembly:
        p = self.problem
        return Assembly(p.layout, p.processes, p.sensors, epochs, t_before)

    def step(self, epoch: Epoch, assembly: Assembly | None = None) -> tuple[Array, Array]:
        """Take in one epoch; the estimate there, x (size,) and P (n, n).

        assembly: of this epoch, where the caller has it already.
        Raises EstimationError when the state cannot be propagated or updated, or is not
        determined or not finite; the epoch then counts as not taken in.
        """
        count, x, P = len(self.epochs), self.x, self.P
        try:
            self._step(epoch, assembly)
        except Exception as error:
            # An update that failed leaves the tree unusable: the next step builds it anew.
            for history in (self.epochs, self._weights, self._references):
                del history[count:]
            self.x, self.P, self._tree, self._relinearize_at = x, P, _new_tree(), 0
            if isinstance(error, (GeometryError, np.linalg.LinAlgError)):
                raise EstimationError(f"t = {epoch.t} s: {error}") from error
            raise
        return self.x, self.P

    def _step(self, epoch: Epoch, assembly: Assembly | None) -> None:
        t_before = self.epochs[-1].t if self.epochs else None
        if assembly is None:
            assembly = self._assemble([epoch], t_before)
        x, P, whiten = self.x, self.P, np.zeros((0, 0, 0))
        if t_before is not None:
            x, P, _, Q = predict(assembly, x, P)
            whiten = assembly.whitening(Q[None])
        everything = np.ones(assembly.observations)
        rows = assembly.measure(x[None], everything)
        weights = innovation_weights(assembly, rows, P, self.problem.gates)
        if weights.any():  # the reference: where an iterated filter would go
            x, _ = update(assembly, x, P, weights, ITERATIONS)
        self.epochs.append(epoch)
        self._weights.append(weights)
        self._references.append(x)
        if len(self.epochs) >= self._relinearize_at:
            self._relinearize_at = max(
                len(self.epochs) + 1, math.ceil(self.ratio * len(self.epochs))
            )
            self._relinearize(self._trajectory(), 0.1)
        else:
            self._extend(assembly, whiten, weights)
        if not (np.isfinite(self.x).all() and np.isfinite(self.P).all()):
            raise EstimationError(f"t = {epoch.t} s: the estimate is not finite")

    def _extend(self, assembly: Assembly, whiten: Array, weights: Array) -> None:
        """Add the newest epoch to the tree, linearised at its reference."""
        layout, key = self.problem.layout, len(self.epochs) - 1
        x = self._references[-1]
        process = assembly.process(np.array([self.x, x]), whiten)
        # The older end is linearised at today's estimate, reference (+) d; the tree's
        # variable is a perturbation of the reference: the chain rule of the retraction.
        d = layout.local(self._references[-2], self.x)
        A = process.A[0] @ layout.right_jacobian(d)
        factors = [interval_factor(key - 1, A, process.B[0], process.e[0] - A @ d)]
        if weights.any():
            rows = assembly.measure(x[None], weights)
            factors.append(epoch_factor(key, rows.H, rows.r))
        try:
            _insert(self._tree, factors, range(key, key + 1), layout.dim)
            d = self._tree.calculateEstimateVector(key)
            P = self._tree.marginalCovariance(key)
        except RuntimeError as error:
            raise EstimationError(f"iSAM2 at epoch {key}: {str(error)[:200]}") from error
        J = layout.right_jacobian(d)
        self.x, self.P = layout.retract(x, d), symmetric(J @ P @ J.T)

    def _trajectory(self) -> Array:
        """Today's estimate of all epochs (N, size): references moved by the tree."""
        out = np.array(self._references)
        known = len(out) - 1  # the newest is not in the tree yet
        if known and not self._tree.empty():
            best = self._tree.calculateBestEstimate()
            for k in range(known):
                out[k] = self.problem.layout.retract(out[k], best.atVector(k))
        return out

    def _relinearize(self, x: Array, tolerance: float) -> tuple[Assembly, Solution]:
        """Gauss-Newton over the whole history from x, and a new tree at its result."""
        layout = self.problem.layout
        assembly = self._assemble(self.epochs)
        weights = assembly.in_order(self._weights)
        solution = solve_gated(assembly, self.problem, x, weights, tolerance)
        self._references = list(solution.x)
        self._weights = assembly.by_epoch(solution.weights)
        self._tree = _new_tree()
        _insert(self._tree, chain_factors(solution.chain), range(len(x)), layout.dim)
        self.x = solution.x[-1]
        inverse = np.linalg.inv(solution.conditionals.R[-1])
        self.P = symmetric(inverse @ inverse.T)
        return assembly, solution

    def finish(self) -> tuple[Assembly, Solution]:
        """Relinearise once more, to convergence: the whole trajectory, smoothed."""
        x = self._trajectory()
        x[-1] = self.x
        return self._relinearize(x, 1e-3)


@dataclass(frozen=True)
class Isam2:
    """iSAM2 with QR, relinearised whenever the history has grown by `ratio`.

    Gives two tracks: the current epoch's estimates as they came, and, as `smoothed`, the
    whole trajectory that it ends with.
    """

    kind: ClassVar[str] = "isam2"
    ratio: float = 1.3

    def run(self, problem: Problem) -> Track:
        """Estimate the pass epoch by epoch."""
        start = time.perf_counter()
        smoother = IncrementalSmoother(problem, self.ratio)
        layout, count = problem.layout, len(problem.epochs)
        xs: list[Array] = []
        Ps: list[Array] = []
        seconds: list[float] = []
        smoothed_x = nan_tail([], count, (layout.size,))
        smoothed_P = nan_tail([], count, (layout.dim, layout.dim))
        rejected = dict.fromkeys(problem.sensors, 0)
        status: Status = "diverged"
        assembly = Assembly(layout, problem.processes, problem.sensors, problem.epochs)
        try:
            for k, epoch in enumerate(problem.epochs):
                begun = time.perf_counter()
                x, P = smoother.step(epoch, assembly.at(k))
                seconds.append(time.perf_counter() - begun)
                xs.append(x)
                Ps.append(P)
            assembly, solution = smoother.finish()
            smoothed_x, smoothed_P = solution.x, solution.conditionals.covariances()
            rejected |= count_rejected(assembly, solution.weights)
            rows = assembly.rows_of(solution.weights > 0)
            status, message = judge(rejected, problem, 2 * solution.chain.cost, int(rows.sum()))
        except UNSOLVED as error:
            message = str(error)
        smoothed = Track(
            name=f"{self.kind}_smoothed",
            kind="smoothed",
            layout=layout,
            t=problem.times,
            x=smoothed_x,
            P=smoothed_P,
            status=status,
            message=message,
            runtime_s=time.perf_counter() - start,
            rejected=rejected,
        )
        return Track(
            name=self.kind,
            kind="filtered",
            layout=layout,
            t=problem.times,
            x=nan_tail(xs, count, (layout.size,)),
            P=nan_tail(Ps, count, (layout.dim, layout.dim)),
            status=status,
            message=message,
            runtime_s=sum(seconds),
            step_s=np.array(seconds),
            rejected=rejected,
            smoothed=smoothed,
        )
