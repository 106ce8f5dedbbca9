#!/usr/bin/env python3
"""How often `incremental` finds the best fit to a target of which nothing is known.

    random_tumbles.py SEED COUNT [--epochs N]

Each problem is `inspection.toml` with a tumble of its own, N(0, 3 deg/s) about each axis, a body of
any shape, 19 to 30 points on a box of 0.6 to 1.6 m, seen from 11 to 18 m for 400 s. `incremental`
begins with the prior, and ends with a smoothed trajectory and map; the optimum is what
Gauss-Newton finds from the truth. Reached: a cost no more than a millionth above. A line for each
problem tells both costs, how far apart the newest states are, in sigmas over all of them together,
static ones included, and the optimum's mean normalised squared error there, which is about 1.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.estimators.gauss_newton import solve_gated
from relnav_graph.estimators.incremental import RATIO, IncrementalSmoother
from relnav_graph.estimators.source import UNSOLVED, RecordedSource, drive
from relnav_graph.linear.assembly import Assembly
from relnav_graph.runs.passes import open_pass
from relnav_graph.scoring.bounds import true_trajectory

INSPECTION = Path(__file__).with_name("inspection.toml")
REACHED = 1e-6


def _quantities(values: Array, unit: str) -> str:
    return json.dumps([f"{v} {unit}" for v in values])


def variant(rng: np.random.Generator, epochs: int) -> list[str]:
    """Settings of one problem, as "key=value" assignments."""
    masses = rng.normal(size=(4, 3))  # of four equal ones any body's inertia can be
    J = 10 * ((masses**2).sum() * np.eye(3) - masses.T @ masses)
    inertia = json.dumps([[f"{v} kg*m^2" for v in row] for row in J])
    return [
        f"time.epochs={epochs}",
        f"truth.target_inertia={inertia}",
        "truth.target_rate=" + _quantities(rng.normal(0, 3, 3), "deg/s"),
        "truth.target_attitude=" + _quantities(rng.uniform(-90, 90, 3), "deg"),
        "truth.relative_position=" + _quantities(np.array([0, -rng.uniform(11, 18), 2]), "m"),
        f"truth.map.count={rng.integers(19, 31)}",
        "truth.map.box=" + _quantities(rng.uniform(0.6, 1.6, 3), "m"),
        f"truth.map.seed={rng.integers(2**31)}",
    ]


def attempt(settings: list[str], seed: int) -> tuple[bool, str]:
    """Whether the optimum of one problem is reached, and a line about it."""
    opened = open_pass(INSPECTION, seed, assignments=settings)
    problem, assembly = opened.problem, Assembly.of(opened.problem)
    layout, truth = problem.layout, true_trajectory(problem, opened.recording.truth)
    best = solve_gated(assembly, problem, truth, np.ones(assembly.observations))
    smoother = IncrementalSmoother(problem, RATIO)
    try:
        driven = drive(RecordedSource(problem), smoother)
        if driven.stopped:
            return False, f"stopped: {driven.stopped}"
        found = smoother.finish()[1]
    except UNSOLVED as error:
        return False, f"no trajectory: {error}"
    P = best.conditionals.last_covariance()
    d, e = (layout.local(best.x[-1], x[-1]) for x in (found.x, truth))
    apart, off = (float(v @ np.linalg.solve(P, v)) for v in (d, e))
    line = (
        f"{len(layout.statics.blocks)} constants, cost {found.cost:.3f}, optimum {best.cost:.3f},"
        f" {np.sqrt(apart):.2g} sigma apart, NEES {off / layout.dim:.2f}"
    )
    return found.cost <= best.cost * (1 + REACHED), line


def main() -> None:
    """Draw, estimate, count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seed", type=int)
    parser.add_argument("count", type=int)
    parser.add_argument("--epochs", type=int, default=401)
    options = parser.parse_args()
    rng, reached = np.random.default_rng(options.seed), 0
    for number in range(options.count):
        there, line = attempt(variant(rng, options.epochs), number)
        reached += there
        print(f"{number}: {'reached' if there else 'NOT reached'}: {line}", flush=True)
    print(f"{reached} of {options.count} reached the optimum")


if __name__ == "__main__":
    main()
