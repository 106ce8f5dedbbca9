"""How likely a trajectory is: what a smoother minimises, with all that it takes for constant."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.estimators.weights import losses_of, thresholds
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.maths.losses import loss_costs

__all__ = ["posterior_cost"]


def posterior_cost(problem: Problem, x: Array) -> float:
    """Minus the logarithm of the posterior density at the trajectory x (N, size), but for a
    constant that is the same for all inputs and data.

        sum of losses of the measurements + (|W e|^2 / 2 - ln det W) of intervals + prior

    W: whitening of the process noise, at x. A gate counts what it leaves out as at its edge; an
    observation that is impossible at x does not count.
    Raises EstimationError, or ModelError, where the models cannot be evaluated.
    """
    assembly = Assembly.of(problem)
    whiten, none = assembly.whitening(x[:-1]), np.zeros(assembly.observations)
    system = linearize(assembly, anchor_of(problem.prior), x, whiten, none)
    rows = assembly.measure(x, np.ones(assembly.observations))
    squares = np.add.reduceat(rows.r**2, np.cumsum(assembly.heights) - assembly.heights)
    squares = np.minimum(squares, thresholds(assembly, problem.gates))
    losses = loss_costs(losses_of(assembly, problem.losses), squares / assembly.heights)
    counted = (losses * assembly.heights)[rows.status == 0]
    return float(system.cost + counted.sum() - np.log(np.einsum("kii->ki", whiten)).sum())
