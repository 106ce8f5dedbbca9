"""How likely a trajectory is: what a smoother minimises, with all that it takes for constant."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.estimators.weights import losses_of, thresholds
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.tables import WHITEN
from relnav_graph.maths.losses import loss_costs

__all__ = ["posterior_cost"]


def posterior_cost(problem: Problem, x: Array) -> float:
    """Minus the logarithm of the posterior density at the trajectory x (N, size), but for a
    constant: of measurements, rho the loss of each, of intervals, and of the prior,

        rho(W r) - ln det W,  |W e|^2 / 2 - ln det W,  |W_0 e_0|^2 / 2

    W: whitening of the noise, of intervals at x. A gate counts what it leaves out as at its edge;
    an observation that is impossible at x does not count.
    Raises EstimationError, or ModelError, where the models cannot be evaluated.
    """
    assembly = Assembly.of(problem)
    whiten, none = assembly.whitening(x[:-1]), np.zeros(assembly.observations)
    system = linearize(assembly, anchor_of(problem.prior), x, whiten, none)
    rows = assembly.measure(x, np.ones(assembly.observations))
    squares = np.add.reduceat(rows.r**2, np.cumsum(assembly.heights) - assembly.heights)
    squares = np.minimum(squares, thresholds(assembly, problem.gates))
    losses = loss_costs(losses_of(assembly, problem.losses), squares / assembly.heights)
    counted = (losses * assembly.heights - _log_weights(assembly))[rows.status == 0]
    return float(system.cost + counted.sum() - np.log(np.einsum("kii->ki", whiten)).sum())


def _log_weights(assembly: Assembly) -> Array:
    """Logarithm of the determinant of each observation's whitening matrix, (observations,)."""
    tables, out = assembly.tables, np.zeros(assembly.observations)
    begin = tables.observations[:, WHITEN]
    for height in np.unique(assembly.heights):
        own = assembly.heights == height
        places = begin[own][:, None] + np.arange(height) * (height + 1)
        out[own] = np.log(tables.numbers[places]).sum(axis=1)
    return out
