"""Batch smoother: Gauss-Newton with Levenberg damping over the whole factor graph."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph.assembly import Assembly
from relnav_graph.chain import (
    Chain,
    Conditionals,
    chain_factors,
    eliminate,
    epoch_factor,
    linearize,
)
from relnav_graph.errors import EstimationError, GeometryError, ModelError
from relnav_graph.estimators.ekf import ITERATIONS, filter_pass, judge, nan_tail
from relnav_graph.estimators.gating import count_rejected, residual_weights
from relnav_graph.estimators.rts import smooth
from relnav_graph.problem import Prior, Problem
from relnav_graph.track import Status, Track

#: What may go wrong on the way to a solution, when the problem is in order.
UNSOLVED = (EstimationError, GeometryError, np.linalg.LinAlgError)

__all__ = ["UNSOLVED", "Batch", "Solution", "solve"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Solution:
    """Trajectory x (N, size), the conditionals there, the final cost and step.

    distance: length of the last Gauss-Newton step, in sigmas over all states; weights:
    of the observations.
    """

    x: Array
    conditionals: Conditionals
    chain: Chain
    weights: Array
    distance: float
    iterations: int


def _damped(chain: Chain, undamped: Conditionals, damping: float) -> Conditionals:
    """The same system with Levenberg's rows, in units of each state's own sigma.

    Scaled by the diagonal of the information, as is usual, damping would freeze the weak
    directions, which many states share: there a state's own sigma is large.
    """
    count, n = undamped.d.shape
    factors = chain_factors(chain)
    sigma = np.sqrt(np.einsum("kii->ki", undamped.covariances()))
    for k in range(count):
        factors.append(epoch_factor(k, np.diag(np.sqrt(damping) / sigma[k]), np.zeros(n)))
    return eliminate(factors, count, n)


def _moved(
    assembly: Assembly, prior: Prior, x: Array, step: Array, whiten: Array, chain: Chain
) -> tuple[Array, Chain | None]:
    """The trajectory after a step, and its system; None where it cannot be.

    An observation that the step makes impossible must not pass for one that fits.
    """
    layout = assembly.layout
    x_next = np.array([layout.retract(a, d) for a, d in zip(x, step, strict=True)])
    try:
        chain_next = linearize(assembly, prior, x_next, whiten, chain.weights)
    except (GeometryError, ModelError):
        return x_next, None
    lost = (chain_next.measurements.status > 0) & (chain.measurements.status == 0)
    return x_next, None if lost.any() or not np.isfinite(chain_next.cost) else chain_next


def solve(
    assembly: Assembly,
    prior: Prior,
    x: Array,
    weights: Array,
    *,
    tolerance: float = 1e-3,
    max_iterations: int = 50,
) -> Solution:
    """Minimise the whole cost from the trajectory x (N, size).

    Steps are Gauss-Newton's. In a narrow, bent valley a good one may raise the cost
    before the next lowers it, so two may (the watchdog of Chamberlain et al. 1982);
    then the best point so far is taken up again, with damping. tolerance: the length of
    the last step, in sigmas over all states together. Noise that depends on the state is
    taken at the first trajectory, so that the cost stays one function. Raises
    EstimationError on a system without a solution.
    """
    count, n = len(x), assembly.layout.dim
    whiten = assembly.whitening(assembly.transition(x[:-1])[2])
    chain = linearize(assembly, prior, x, whiten, weights)
    undamped = conditionals = eliminate(chain_factors(chain), count, n)
    best = x, chain, undamped
    damping, ventured, distance, iteration = 0.0, 0, np.inf, 0
    while iteration < max_iterations:
        iteration += 1
        distance = np.sqrt(2 * undamped.decrease())
        x_next, chain_next = _moved(assembly, prior, x, conditionals.solution(), whiten, chain)
        # The cost is a sum of many squares: its own rounding is no reason to stop.
        better = chain_next is not None and chain_next.cost <= best[1].cost * (1 + 1e-12)
        if chain_next is not None and (better or (damping == 0.0 and ventured < 2)):
            x, chain = x_next, chain_next
            undamped = eliminate(chain_factors(chain), count, n)
            ventured = 0 if better else ventured + 1
            if better:
                best = x, chain, undamped
                converged = distance < tolerance and damping == 0.0
                damping = damping / 10 if damping > 1e-3 else 0.0
                if converged:
                    break
        elif distance < tolerance or damping > 1e8:
            break
        else:
            x, chain, undamped = best
            damping, ventured = max(10 * damping, 1e-2), 0
        conditionals = _damped(chain, undamped, damping) if damping else undamped
    x, chain, undamped = best
    return Solution(x, undamped, chain, weights, float(distance), iteration)


def solve_gated(
    assembly: Assembly, problem: Problem, x: Array, weights: Array, tolerance: float = 1e-3
) -> Solution:
    """`solve`, then decide again which observations pass the gate, until they stay."""
    solution = solve(assembly, problem.prior, x, weights, tolerance=tolerance)
    if not problem.gates and (solution.chain.measurements.status == 0).all():
        return solution
    everything = np.ones(assembly.observations)
    for _ in range(10):
        rows = assembly.measure(solution.x, everything)
        weights = residual_weights(assembly, rows, problem.gates)
        if (weights == solution.weights).all():
            break
        solution = solve(assembly, problem.prior, solution.x, weights, tolerance=tolerance)
    return solution


@dataclass(frozen=True)
class Batch:
    """Maximum a posteriori estimate of the whole pass, all marginal covariances included.

    Starts from the iterated filter and its smoother, not from open-loop propagation,
    which a tumbling target soon leads astray.
    """

    kind: ClassVar[str] = "batch"

    def run(self, problem: Problem) -> Track:
        """Smooth the whole pass."""
        start = time.perf_counter()
        layout, count = problem.layout, len(problem.epochs)
        x, P = nan_tail([], count, (layout.size,)), nan_tail([], count, (layout.dim, layout.dim))
        status: Status = "diverged"
        rejected = dict.fromkeys(problem.sensors, 0)
        done = filter_pass(problem, ITERATIONS)
        assembly, message = done.assembly, done.stopped
        if not message:
            try:
                weights = assembly.in_order([s.weights for s in done.steps])
                solution = solve_gated(assembly, problem, smooth(layout, done.steps)[0], weights)
                x, P = solution.x, solution.conditionals.covariances()
                rejected |= count_rejected(assembly, solution.weights)
                rows = assembly.rows_of(solution.weights > 0)
                status, message = judge(rejected, problem, 2 * solution.chain.cost, int(rows.sum()))
                if solution.distance > 0.1:
                    status = "degraded"
                    message = f"not converged: last step {solution.distance:.2g} sigma"
            except UNSOLVED as error:
                message = str(error)
        return Track(
            name=self.kind,
            kind="smoothed",
            layout=layout,
            t=problem.times,
            x=x,
            P=P,
            status=status,
            message=message,
            runtime_s=time.perf_counter() - start,
            rejected=rejected,
        )
