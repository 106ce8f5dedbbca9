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
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import filter_pass, judge, nan_tail
from relnav_graph.estimators.gating import count_rejected, residual_weights
from relnav_graph.estimators.rts import smooth
from relnav_graph.problem import Prior, Problem
from relnav_graph.track import Status, Track

__all__ = ["Batch", "Solution", "solve"]

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
    """The same system with Levenberg's rows, scaled by the information of each state."""
    count, n = undamped.d.shape
    factors = chain_factors(chain)
    for k in range(count):
        scale = np.sqrt(damping) * np.linalg.norm(undamped.R[k], axis=0)
        factors.append(epoch_factor(k, np.diag(scale), np.zeros(n)))
    return eliminate(factors, count, n)


def solve(
    assembly: Assembly,
    prior: Prior,
    x: Array,
    weights: Array,
    *,
    tolerance: float = 1e-3,
    max_iterations: int = 30,
) -> Solution:
    """Minimise the whole cost from the trajectory x (N, size).

    Steps are Gauss-Newton's; one that does not lower the cost is repeated with damping.
    tolerance: the length of the last step, in sigmas over all states together. Noise
    that depends on the state is taken at the first trajectory, so that the cost stays
    one function. Raises EstimationError on a system without a solution.
    """
    layout, count = assembly.layout, len(x)
    whiten = assembly.whitening(assembly.transition(x[:-1])[2])
    chain = linearize(assembly, prior, x, whiten, weights)
    damping, distance, iteration = 0.0, np.inf, 0
    undamped = conditionals = eliminate(chain_factors(chain), count, layout.dim)
    while iteration < max_iterations:
        iteration += 1
        distance = np.sqrt(2 * undamped.decrease())
        step = conditionals.solution()
        x_next = np.array([layout.retract(a, d) for a, d in zip(x, step, strict=True)])
        chain_next = linearize(assembly, prior, x_next, whiten, weights)
        # The cost is a sum of many squares: its own rounding is no reason to stop.
        if chain_next.cost <= chain.cost * (1 + 1e-12):
            x, chain, damping = x_next, chain_next, damping / 10 if damping > 1e-8 else 0.0
            undamped = conditionals = eliminate(chain_factors(chain), count, layout.dim)
        elif distance < tolerance or damping > 1e8:
            break
        else:
            damping = max(10 * damping, 1e-6)
        if distance < tolerance and damping == 0.0:
            break
        if damping:
            conditionals = _damped(chain, undamped, damping)
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
        steps, _, message = filter_pass(problem, 20)
        if not message:
            try:
                assembly = Assembly(layout, problem.processes, problem.sensors, problem.epochs)
                weights = assembly.in_order([s.weights for s in steps])
                solution = solve_gated(assembly, problem, smooth(layout, steps)[0], weights)
                x, P = solution.x, solution.conditionals.covariances()
                rejected |= count_rejected(assembly, solution.weights)
                status, message = judge(rejected, problem)
                if solution.distance > 0.1:
                    status = "degraded"
                    message = f"not converged: last step {solution.distance:.2g} sigma"
            except EstimationError as error:
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
