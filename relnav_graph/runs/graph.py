"""A problem as a GTSAM graph of our factors, from a good start; and robust losses there."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import ITERATIONS, filter_problem
from relnav_graph.estimators.rts import smooth
from relnav_graph.estimators.weights import reweighted
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.gtsam_graph import Graph, graph_of, to_track

__all__ = ["Graph", "gauss_newton", "reweigh", "to_gtsam", "to_track"]


def to_gtsam(problem: Problem, x: Array | None = None, weights: Array | None = None) -> Graph:
    """The problem as a `gtsam.NonlinearFactorGraph` of our factors over typed variables.

    x (N, size): the trajectory to begin from, of all blocks, the static ones last and the same in
    every row; by default that of the iterated filter and its smoother, from which `batch` begins
    too. weights (observations,), square roots, and what else may be raised: see
    `relnav_graph.linear.gtsam_graph.graph_of`. Gates are no part of a graph: see `reweigh`. Raises
    EstimationError when the filter stops on the way.
    """
    return graph_of(problem, _start(problem) if x is None else x, weights)


def _start(problem: Problem) -> Array:
    """The trajectory (N, size) of the iterated filter and its smoother."""
    done = filter_problem(problem, ITERATIONS)
    if done.stopped:
        raise EstimationError(f"no trajectory to begin from (give one): {done.stopped}")
    return smooth(done, covariances=False)[0]


def gauss_newton(graph: Graph, tolerance: float = 1e-3, iterations: int = 50) -> gtsam.Values:
    """The values of least error, by Gauss-Newton with QR, from those of the graph.

    Driven from here, since GTSAM's own optimisers copy all values for each callback. tolerance:
    length of the last step, in sigmas over all variables together. Raises EstimationError when
    that is not reached, or the graph does not determine all variables.
    """
    values, ordering = graph.values, graph.keys.in_time(graph.values)
    for _ in range(iterations):
        net = graph.factors.linearize(values).eliminateSequential(ordering, gtsam.EliminateQR)
        step = net.optimize()
        distance = float(np.sqrt(2 * net.error(values.zeroVectors())))
        values = values.retract(step)
        if distance < tolerance:
            return values
    raise EstimationError(f"not converged: last step {distance:.2g} sigma")


def reweigh(
    problem: Problem,
    x: Array | None = None,
    optimize: Callable[[Graph], gtsam.Values] = gauss_newton,
) -> tuple[Graph, gtsam.Values, Array]:
    """The gates and robust losses of a problem by iteratively reweighted least squares: our factors
    are built anew with the weights of the last solution until these stay.

    `gtsam.GncLMOptimizer` cannot do it: it clones factors, which a `CustomFactor` does not allow.
    As in `batch`, a loss with many minima is preceded by Huber's, which has one. x: as of
    :func:`to_gtsam`; optimize: gives the values that minimise a graph. Returns the last graph, its
    optimum, and the square roots of the weights there, (observations,). Raises as :func:`to_gtsam`.
    """
    assembly = Assembly.of(problem)
    found = list[tuple[Graph, gtsam.Values]]()

    def solve(x: Array, weights: Array) -> Array:
        graph = graph_of(problem, x, weights)
        found[:] = [(graph, optimize(graph))]
        return graph.keys.trajectory(found[0][1], len(problem.epochs))

    start = _start(problem) if x is None else x
    _, weights = reweighted(problem, assembly, start, np.ones(assembly.observations), solve)
    return *found[0], weights
