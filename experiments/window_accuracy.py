"""How far the fixed-lag window is from its own minimum, and what a step of it costs.

    python experiments/window_accuracy.py experiments/zhang2015_close.toml --epochs 600

Every tenth epoch the window is iterated to convergence: the difference of the newest estimate, in
sigmas over all its states together, is what keeping linearisations costs. Then the same epochs
go through GTSAM's iSAM2, as a window of the same length (`tests/test_fixed_lag.py` has the two
agree where the problem is linear).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import gtsam
import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.core.problem import Problem
from relnav_graph.estimators.fixed_lag import FixedLag, FixedLagEngine
from relnav_graph.estimators.window import Window
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.gtsam_chain import row_factor
from relnav_graph.scenario.build import load_scenario


def distance(problem: Problem, engine: FixedLagEngine, w: Window) -> float:
    """From the newest estimate to the window's minimum, in sigmas."""
    assert w.chain is not None
    best = engine.solve(w, w.chain.estimates(problem.layout))
    d = problem.layout.local(best.x[-1], w.x)
    return float(np.linalg.norm(best.conditionals.R[-1] @ d))


def of_gtsam(problem: Problem, x: np.ndarray) -> list[float]:
    """Seconds of each step of an ISAM2 that holds the newest epochs, linearised at x (N, size).

    The same rows, made beforehand: what is timed is GTSAM's update, the newest estimate and
    its covariance, and `marginalizeLeaves`. The window's keys are eliminated anew, the
    oldest first, so that they are leaves when they leave.
    """
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    params.enableRelinearization = False
    isam, assembly, n = gtsam.ISAM2(params), Assembly.of(problem), problem.layout.dim
    whiten = assembly.whitening(x[:-1])
    process = assembly.process(x, whiten)
    rows = assembly.measure(x, np.ones(assembly.observations))
    inside, seconds = list[int](), list[float]()
    for k, epoch in enumerate(problem.epochs):
        own = slice(assembly.row_offsets[k], assembly.row_offsets[k + 1])
        factors = [row_factor({k: rows.H[own]}, rows.r[own])]
        if k:
            j = k - 1
            factors.append(row_factor({j: process.A[j], k: process.B[j]}, process.e[j]))
        else:
            e, W = anchor_of(problem.prior).rows(problem.layout, x[0])
            factors.append(row_factor({0: W}, e))
        begun = time.perf_counter()
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in factors:
            graph.push_back(gtsam.LinearContainerFactor(factor))
        values.insert(k, np.zeros(n))
        leaving = [i for i in inside if problem.epochs[i].t < epoch.t - float(problem.window or 0)]
        groups, again, leaves = gtsam.KeyGroupMap(), gtsam.KeyList(), gtsam.KeyList()
        for i in inside:
            groups.insert2(i, 0 if i in leaving else 1)
            again.push_back(i)
        groups.insert2(k, 1)
        isam.update(graph, values, [], groups, gtsam.KeyList(), again, False)
        isam.calculateEstimateVector(k)
        isam.marginalCovariance(k)
        for i in leaving:
            leaves.push_back(i)
        if leaving:
            isam.marginalizeLeaves(leaves)
        inside = [i for i in (*inside, k) if i not in leaving]
        seconds.append(time.perf_counter() - begun)
    return seconds


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--epochs", type=int, default=600)
    parser.add_argument("--window", default="30 s")
    options = parser.parse_args()
    settings = [f"time.epochs={options.epochs}", f'online.window="{options.window}"']
    scenario = load_scenario(options.scenario, settings)
    problem = scenario.problem(scenario.simulate(0), 0)
    engine, assembly, away = FixedLag().engine(problem), Assembly.of(problem), list[float]()
    w, seconds, x = engine.begin(), list[float](), []
    with threadpool_limits(1, "blas"):
        for k, epoch in enumerate(problem.epochs):
            begun = time.perf_counter()
            w = engine.advance(w, epoch, assembly.at(k))
            seconds.append(time.perf_counter() - begun)
            x.append(w.x)
            if k % 10 == 9:
                away.append(distance(problem, engine, w))
        gtsam_s = of_gtsam(problem, np.array(x))
    half = len(seconds) // 2
    own_ms, gtsam_ms = (1e3 * float(np.median(s[half:])) for s in (seconds, gtsam_s))
    mean = 1e3 * float(np.mean(seconds[half:])), 1e3 * float(np.mean(gtsam_s[half:]))
    print(f"from the minimum, sigmas: median {np.median(away):.2g}, largest {max(away):.2g}")
    print(f"a step, ms, median of the second half: {own_ms:.2f}; of ISAM2 {gtsam_ms:.2f}")
    print(f"mean {mean[0]:.2f}; of ISAM2, which relinearises nothing, {mean[1]:.2f}")


if __name__ == "__main__":
    main()
