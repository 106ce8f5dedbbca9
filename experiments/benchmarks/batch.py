"""Smoothing a whole pass: against LAPACK's floor, our own filter, and GTSAM's optimiser."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from scipy.linalg import cholesky_banded

from relnav_graph.arrays import Array
from relnav_graph.estimators.batch import Batch
from relnav_graph.estimators.ekf import run_filter
from relnav_graph.estimators.gauss_newton import solve
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.gtsam_chain import chain_factors, chain_rows, eliminate
from relnav_graph.linear.gtsam_graph import graph_of

from .passes import SAME, Pass, ratio, seconds


def floor_of(epochs: int, n: int) -> Callable[[], object]:
    """LAPACK's banded Cholesky of a system of that many blocks, each tied to the next."""
    band = np.random.default_rng(0).uniform(-1, 1, (2 * n, n * epochs))
    band[0] = 100.0  # diagonally dominant
    return lambda: cholesky_banded(band, lower=True, check_finite=False)


def iteration_of(p: Pass) -> Callable[[], object]:
    """One full Gauss-Newton iteration: back-substitute, retract, error, linearise, eliminate."""
    whiten = p.assembly.whitening(p.start[:-1])
    anchor = anchor_of(p.problem.prior)
    system, after = (linearize(p.assembly, anchor, p.start, whiten, p.weights) for _ in range(2))

    def iterate() -> float:  # fills the last one's memory, as `solve` does
        x = p.assembly.layout.retract(system.x, system.conditionals.solution())
        into = after.conditionals
        return linearize(p.assembly, anchor, x, whiten, p.weights, into=into).cost

    return iterate


def over_floor(passes: Sequence[Pass], rounds: int = 5) -> tuple[Array, Array]:
    """Of full iterations over passes, in turns (rounds, passes): units of the floor, and time
    per epoch, s."""
    pairs = [(iteration_of(p), floor_of(len(p.start), p.assembly.layout.dim)) for p in passes]
    took = np.empty((2, rounds, len(passes)))
    for one in range(rounds):
        for i, (p, pair) in enumerate(zip(passes, pairs, strict=True)):
            count = max(1, 10_000 // len(p.start))  # short passes many times
            for j, run in enumerate(pair):
                took[j, one, i] = sum(seconds(run) for _ in range(count)) / count / len(p.start)
    return took[0] / took[1], took[0]


def over_ekf(p: Pass) -> float:
    """Smoothing with all covariances, in units of the filter's pass; both from a problem."""
    smoother = Batch()

    def filtered() -> object:
        return run_filter(p.problem, 1, Assembly.of(p.problem), keep=False)

    return ratio(filtered, lambda: smoother.run(p.problem))


def start_of(p: Pass) -> Array:
    """A few hundredths of a sigma from the optimum, everywhere, where both start: near enough
    for two iterations."""
    signs = np.random.default_rng(1).choice([-1.0, 1.0], p.sigma.shape)
    return p.assembly.layout.retract(p.solution.x, 0.03 * signs * p.sigma)


def solve_ours(p: Pass, x: Array) -> Array:
    """To the same accuracy as the others, covariances included."""
    found = solve(p.assembly, p.problem.prior, x, p.weights, tolerance=1e-4)
    found.conditionals.covariances()
    return found.x


def over_own_rows(p: Pass) -> float:
    """GTSAM's elimination of our rows, one variable per epoch, by QR in order of time, in units of
    ours. GTSAM's time is that of its factors and of the elimination; ours has the models too."""
    anchor, n = anchor_of(p.problem.prior), p.assembly.layout.dim
    whiten, count = p.assembly.whitening(p.start[:-1]), len(p.start)
    rows = chain_rows(p.assembly, anchor, p.start, whiten, p.weights)
    into = linearize(p.assembly, anchor, p.start, whiten, p.weights).conditionals

    def ours() -> object:
        return linearize(p.assembly, anchor, p.start, whiten, p.weights, into=into)

    return ratio(ours, lambda: eliminate(chain_factors(rows), count, n))


def faster_than_gtsam(p: Pass) -> float | None:
    """GTSAM's LevenbergMarquardtOptimizer on the same factors; None when it does not come
    to the same optimum. GTSAM's time is for the state alone, ours for the covariances too."""
    graph = graph_of(p.problem, p.start)
    x, took, far = start_of(p), 0.0, np.inf
    values = graph.keys.values(x)
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("SEQUENTIAL_QR")
    params.setOrdering(graph.keys.in_time(values))
    params.setlambdaInitial(0.0)  # we start in the quadratic region: so may GTSAM
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph.factors, values, params)
    for _ in range(3):
        took += seconds(optimizer.iterate)
        far = p.distance(graph.keys.trajectory(optimizer.values(), len(x)))
        if far < SAME:
            break
    ours = min(seconds(lambda: solve_ours(p, x)) for _ in range(5))
    same = far < SAME and p.distance(solve_ours(p, x)) < SAME
    return took / ours if same else None
