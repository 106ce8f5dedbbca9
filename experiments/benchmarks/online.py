"""iSAM2 epoch by epoch: growth, accuracy, and the graph as most people write it."""

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
from relnav_graph.estimators.incremental import IncrementalSmoother
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
