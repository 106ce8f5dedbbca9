"""Online estimators epoch by epoch: growth, accuracy, and the graph as most people write it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.estimators.ekf import filter_problem
from relnav_graph.estimators.incremental import IncrementalSmoother
from relnav_graph.estimators.isam2 import Isam2
from relnav_graph.estimators.online.driver import online
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.gtsam_graph import Keys, PassFactors

from .passes import Pass, seconds

#: One step of an estimator, which gives the newest estimate (size,); k: the epoch.
Step = Callable[[int], Array]


def incremental(problem: Problem) -> Step:
    """`incremental` over the epochs of a problem."""
    smoother, assembly = IncrementalSmoother(problem, 1.3), Assembly.of(problem)
    return lambda k: smoother.step(problem.epochs[k], assembly.at(k))[0]


def fixed_lag(problem: Problem) -> Step:
    """`fixed_lag`, with its window of 30 epochs, over the epochs of a problem."""
    one = online("fixed_lag", replace(problem, epochs=()))

    def step(k: int) -> Array:
        one.step(problem.epochs[k])
        return one.x

    return step


def isam2(problem: Problem) -> Step:
    """`isam2` over the epochs of a problem."""
    engine, assembly = Isam2().engine(problem), Assembly.of(problem)
    state = [engine.begin()]

    def step(k: int) -> Array:
        state[0] = engine.advance(state[0], problem.epochs[k], assembly.at(k))
        return state[0].x

    return step


def thresholds(problem: Problem) -> Step:
    """GTSAM's iSAM2 over the same factors as its examples have it: its own thresholds, relinearised
    every tenth step, no reference held; QR, since the default factorisation throws. New values are
    the iterated filter's, as for `isam2`."""
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    isam, keys = gtsam.ISAM2(params), Keys(problem.layout)
    make, layout, done = PassFactors(problem, keys), problem.layout, filter_problem(problem, 20)
    whiten = done.assembly.whitening(done.x[:-1])

    def step(k: int) -> Array:
        factors, values, epoch = gtsam.NonlinearFactorGraph(), gtsam.Values(), problem.epochs[k]
        new = make.measurements(k, epoch, np.ones(sum(len(m.z) for m in epoch.measurements)), {})
        new += (
            make.interval(k, epoch, problem.epochs[k - 1].t, whiten[k - 1]) if k else make.prior()
        )
        for factor in new:
            factors.push_back(factor)
        keys.insert(values, k, layout, done.x[k])
        isam.update(factors, values)
        return keys.read(isam.calculateEstimate(), k)

    return step


#: The estimators of `side_by_side`.
ONLINE: dict[str, Callable[[Problem], Step]] = {
    "iSAM2, thresholds": thresholds,
    "isam2": isam2,
    "incremental": incremental,
    "fixed_lag": fixed_lag,
}


def side_by_side(p: Pass) -> dict[str, dict[str, float]]:
    """By estimator: median step of the first and of the last tenth, and the longest, ms; the whole,
    s; the last epoch's estimate from batch's, largest component in sigmas."""
    out, count = {}, len(p.problem.epochs)
    for name, estimator in ONLINE.items():
        step, took = estimator(p.problem), list[float]()
        for k in range(count):
            begun = time.perf_counter()
            x = step(k)
            took.append(time.perf_counter() - begun)
        tenth = max(count // 10, 1)
        out[name] = {
            "first_ms": 1e3 * float(np.median(took[:tenth])),
            "last_ms": 1e3 * float(np.median(took[-tenth:])),
            "longest_ms": 1e3 * max(took),
            "whole_s": sum(took),
            "sigma_from_batch": sigma_from_batch(p, x),
        }
    return out


def run(estimator: Callable[[Problem], Step], problem: Problem) -> tuple[Array, float, Array]:
    """Time of each step, s; the growth; and the last epoch's estimate (size,).

    Growth: a step at the end in units of one at epoch 500, or at half a shorter pass, medians
    of steps that two estimators make in turns.
    """
    count = len(problem.epochs)
    early = min(500, count // 2)
    late, again = estimator(problem), estimator(problem)
    turns = min(200, early // 2)
    took, pairs = np.empty(count), np.empty(turns)
    for k in range(early - turns):
        again(k)
    for k in range(count - turns):
        took[k] = seconds(partial(late, k))
    for i in range(turns):
        k = count - turns + i
        begun = time.perf_counter()
        x = late(k)
        took[k] = time.perf_counter() - begun
        pairs[i] = seconds(partial(again, early - turns + i))
    return took, float(np.median(took[-turns:]) / np.median(pairs)), x


def tail(took: Array) -> float:
    """The slowest hundredth of the last half's steps, in units of their median."""
    late = took[len(took) // 2 :]
    return float(np.percentile(late, 99) / np.median(late))


def around(took: Array, epoch: int) -> float:
    """Median step of the 200 epochs before one."""
    return float(np.median(took[max(epoch - 200, 0) : epoch]))


def sigma_from_batch(p: Pass, last: Array) -> float:
    """The newest epoch's estimate minus batch's, largest component in sigmas."""
    d = p.assembly.layout.local(p.solution.x[-1], last)
    return float(np.abs(d / p.sigma[-1]).max())


def naive_factors(p: Pass, make: PassFactors, k: int, whiten: Array) -> list[gtsam.CustomFactor]:
    """Our factors of epoch k, one for each beacon, and of the interval that leads to it."""
    q = p.problem
    epoch = q.epochs[k]
    apart = [
        replace(m, ids=m.ids[[i]], z=m.z[[i]]) for m in epoch.measurements for i in range(len(m.z))
    ]
    split = replace(epoch, measurements=tuple(apart))
    out = make.measurements(k, split, np.ones(len(apart)), {})
    return out + (make.interval(k, epoch, q.epochs[k - 1].t, whiten[k - 1]) if k else make.prior())


def faster_than_naive(p: Pass, epoch: int, steps: int = 20) -> float:
    """Step of GTSAM's iSAM2 from an epoch on, as its examples are written, in units of ours,
    medians: one variable per block, one factor per beacon, default parameters but QR (the
    default factorisation throws), and no reference held.

    Its factors are ours, compiled: written in NumPy they would take longer still. The
    past goes in by hundreds, which only its own bookkeeping could tell from one by one.
    """
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    isam, ours, keys = gtsam.ISAM2(params), incremental(p.problem), Keys(p.problem.layout)
    make, layout = PassFactors(p.problem, keys), p.problem.layout
    whiten = p.assembly.whitening(p.start[:-1])
    edges, took = [*range(0, epoch, 100), *range(epoch, epoch + steps + 1)], list[float]()
    for begin, end in pairwise(edges):
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for k in range(begin, end):
            for factor in naive_factors(p, make, k, whiten):
                factors.push_back(factor)
            keys.insert(values, k, layout, p.start[k])
        begun = time.perf_counter()
        isam.update(factors, values)
        for block in layout:
            key = keys[block.name, end - 1]
            if block.manifold == "SO3":
                isam.calculateEstimateRot3(key)
            else:
                isam.calculateEstimateVector(key)
        took.append(time.perf_counter() - begun)
    own = [seconds(partial(ours, k)) for k in range(epoch + steps)]
    return float(np.median(took[-steps:]) / np.median(own[-steps:]))
