"""iSAM2 epoch by epoch: growth, accuracy, and the graph as most people write it."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from relnav_graph.assembly import Assembly
from relnav_graph.estimators.isam2 import IncrementalSmoother
from relnav_graph.estimators.online import online
from relnav_graph.problem import Problem

from .batch import key_of, typed_factors, typed_values
from .passes import Pass, first

Array = NDArray[np.float64]


def run_isam2(problem: Problem) -> tuple[Array, Array]:
    """Time of each step, s, and the last epoch's estimate (size,), before any finish."""
    smoother, assembly = IncrementalSmoother(problem, 1.3), Assembly.of(problem)
    took = np.empty(len(problem.epochs))
    for k, epoch in enumerate(problem.epochs):
        begun = time.perf_counter()
        smoother.step(epoch, assembly.at(k))
        took[k] = time.perf_counter() - begun
    return took, smoother.x


def run_fixed_lag(problem: Problem) -> Array:
    """Time of each step of `fixed_lag`, with its window of 30 epochs, s."""
    one = online("fixed_lag", replace(problem, epochs=()))
    took = np.empty(len(problem.epochs))
    for k, epoch in enumerate(problem.epochs):
        begun = time.perf_counter()
        one.step(epoch)
        took[k] = time.perf_counter() - begun
    return took


def tail(took: Array) -> float:
    """The slowest hundredth of the last half's steps, in units of their median."""
    late = took[len(took) // 2 :]
    return float(np.percentile(late, 99) / np.median(late))


def around(took: Array, epoch: int) -> float:
    """Median step of the 200 epochs before one."""
    return float(np.median(took[max(epoch - 200, 0) : epoch]))


def growth(took: Array) -> float:
    """Step at the end in units of the step at epoch 500, or at half a shorter pass."""
    return around(took, len(took)) / around(took, min(500, len(took) // 2))


def sigma_from_batch(p: Pass, last: Array) -> float:
    """The newest epoch's estimate minus batch's, largest component in sigmas."""
    d = p.assembly.layout.local(p.solution.x[-1], last)
    return float(np.abs(d / p.sigma[-1]).max())


def naive_step(p: Pass, epoch: int, steps: int = 10) -> float:
    """Median step, s, of GTSAM's iSAM2 at an epoch, over one variable per block, default
    parameters but QR (the default factorisation throws), and no reference held.

    Its factors are ours, compiled: written in NumPy they would take longer still. The
    past goes in by hundreds, which only its own bookkeeping could tell from one by one.
    """
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    isam = gtsam.ISAM2(params)
    edges = [*range(0, epoch, 100), *range(epoch, epoch + steps + 1)]
    took = []
    for begin, end in pairwise(edges):
        factors = gtsam.NonlinearFactorGraph()
        for k in range(begin, end):
            factors.push_back(typed_factors(p, k))
        values = typed_values(p, p.start[begin:end], begin)
        begun = time.perf_counter()
        isam.update(factors, values)
        for i, block in enumerate(p.assembly.layout):
            key = key_of(p, end - 1, i)
            if block.manifold == "SO3":
                isam.calculateEstimateRot3(key)
            else:
                isam.calculateEstimateVector(key)
        took.append(time.perf_counter() - begun)
    return float(np.median(took[-steps:]))


def our_step(problem: Problem, epoch: int) -> float:
    """Median step, s, of `isam2` at an epoch."""
    return around(run_isam2(first(problem, epoch + 10))[0], epoch + 10)
