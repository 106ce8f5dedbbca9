"""Smoothing a whole pass: against LAPACK's floor, our own filter, and GTSAM's optimiser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from scipy.linalg import cholesky_banded

from relnav_graph.arrays import Array
from relnav_graph.estimators.batch import Batch
from relnav_graph.estimators.ekf import run_filter
from relnav_graph.estimators.gauss_newton import solve
from relnav_graph.linear import gtsam_factors
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize

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


def key_of(p: Pass, k: int, i: int) -> int:
    """GTSAM's key of block i at epoch k."""
    return int(gtsam.symbol("abcdefghijkl"[i], k))


def typed_factors(p: Pass, k: int, apart: bool = False) -> gtsam.NonlinearFactorGraph:
    """Our factors of epoch k, and of the interval that leads to it, over GTSAM's own
    variables, one for each block. apart: one factor for each beacon."""
    q, out = p.problem, gtsam.NonlinearFactorGraph()
    place = {b.name: i for i, b in enumerate(q.layout)}
    seen = list(q.epochs[k].measurements)
    if apart:
        seen = [replace(m, ids=m.ids[[i]], z=m.z[[i]]) for m in seen for i in range(len(m.z))]
    for m in seen:
        sensor = q.sensors[m.sensor]
        keys = [key_of(p, k, place[b.name]) for b in sensor.reads]
        out.add(gtsam_factors.measurement_factor(sensor, m, keys))
    if k == 0:
        for i, block in enumerate(q.layout):
            rows, value = q.layout.tangent(block.name), q.layout.value(q.prior.x, block.name)
            model = gtsam.noiseModel.Gaussian.Covariance(q.prior.P[rows, rows])
            key = key_of(p, 0, i)
            if block.manifold == "SO3":
                out.add(gtsam.PriorFactorRot3(key, gtsam.Rot3(value), model))
            else:
                out.add(gtsam.PriorFactorVector(key, value, model))
        return out
    for name, process in q.processes.items():
        blocks = process.advances + process.reads
        out.add(
            gtsam_factors.process_factor(
                *(process, q.epochs[k - 1].t, q.epochs[k].inputs[name]),
                [key_of(p, k - 1, place[b.name]) for b in blocks],
                [key_of(p, k, place[b.name]) for b in process.advances],
                [q.layout.value(p.start[k - 1], b.name) for b in blocks],
            )
        )
    return out


def typed_values(p: Pass, x: Array, first: int = 0) -> gtsam.Values:
    """The trajectory x (N, size), from epoch `first` on, as GTSAM's values."""
    values = gtsam.Values()
    for k in range(len(x)):
        for i, block in enumerate(p.assembly.layout):
            value = p.assembly.layout.value(x[k], block.name)
            gtsam_factors.insert_block(values, key_of(p, first + k, i), block, value)
    return values


def trajectory(p: Pass, values: gtsam.Values) -> Array:
    """The inverse of :func:`typed_values`."""
    layout = p.assembly.layout
    out = np.empty_like(p.start)
    for k in range(len(out)):
        for i, block in enumerate(layout):
            value = gtsam_factors.read_block(values, key_of(p, k, i), block)
            out[k, layout.stored(block.name)] = value.reshape(-1)
    return out


def faster_than_gtsam(p: Pass) -> float | None:
    """GTSAM's LevenbergMarquardtOptimizer on the same factors; None when it does not come
    to the same optimum. GTSAM's time is for the state alone, ours for the covariances too."""
    factors = gtsam.NonlinearFactorGraph()
    for k in range(len(p.start)):
        factors.push_back(typed_factors(p, k))
    ordering = gtsam.Ordering()
    for k in range(len(p.start)):
        for i in range(len(p.assembly.layout)):
            ordering.push_back(key_of(p, k, i))
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("SEQUENTIAL_QR")
    params.setOrdering(ordering)
    params.setlambdaInitial(0.0)  # we start in the quadratic region: so may GTSAM
    x, took, far = start_of(p), 0.0, np.inf
    optimizer = gtsam.LevenbergMarquardtOptimizer(factors, typed_values(p, x), params)
    for _ in range(3):
        took += seconds(optimizer.iterate)
        far = p.distance(trajectory(p, optimizer.values()))
        if far < SAME:
            break
    ours = min(seconds(lambda: solve_ours(p, x)) for _ in range(5))
    same = far < SAME and p.distance(solve_ours(p, x)) < SAME
    return took / ours if same else None
