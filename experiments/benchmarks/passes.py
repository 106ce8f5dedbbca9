"""The problem of all comparisons: zhang2015_close, of any length; and how times are taken.

The chaser of zhang2015 itself drifts away, 12 km in 20,000 epochs, where six points within a
metre tell nothing any more.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch, make_epochs
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Truth
from relnav_graph.estimators.ekf import ITERATIONS, filter_problem
from relnav_graph.estimators.gauss_newton import Solution, solve
from relnav_graph.estimators.rts import smooth
from relnav_graph.linear.assembly import Assembly
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.sim.sensors import Timing, measure, stream

SCENARIO = Path(__file__).parents[1] / "zhang2015_close.toml"
#: What "the same optimum" means, in sigmas of every state.
SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Pass:
    """A pass, and where every solver starts: the smoothed filter."""

    problem: Problem
    assembly: Assembly
    start: Array
    weights: Array

    @cached_property
    def solution(self) -> Solution:
        """Where every solver should end, to rounding, far below `SAME`."""
        return solve(self.assembly, self.problem.prior, self.start, self.weights, tolerance=0.0)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations of the optimum (N, n)."""
        variances: Array = np.einsum("kii->ki", self.solution.conditionals.covariances())
        return np.sqrt(variances)

    def distance(self, x: Array) -> float:
        """Largest component of x minus the optimum, in sigmas."""
        return float(np.abs(self.assembly.layout.local(self.solution.x, x) / self.sigma).max())


def scenario_of(epochs: int, *settings: str) -> Scenario:
    """The scenario with so many epochs."""
    return load_scenario(SCENARIO, [f"time.epochs={epochs}", *settings])


def problem_of(epochs: int) -> Problem:
    """A simulated pass."""
    scenario = scenario_of(epochs)
    return scenario.problem(scenario.simulate(0), 0)


def pass_of(problem: Problem) -> Pass:
    """With the smoothed filter to start from."""
    done = filter_problem(problem, ITERATIONS)
    return Pass(problem, done.assembly, smooth(done, covariances=False)[0], done.weights)


def first(problem: Problem, epochs: int) -> Problem:
    """The first epochs of a pass."""
    return replace(problem, epochs=problem.epochs[:epochs])


def lazy_pass(epochs: int, chunk: int = 1000) -> tuple[Problem, Iterator[Epoch]]:
    """A pass of any length whose epochs are made when they are asked for: the problem with
    the first chunk, and the rest."""
    scenario, bare = scenario_of(epochs), scenario_of(2)
    everything: Any = replace(scenario, sensors={})
    recording = everything.simulate(0)
    truth = recording.truth
    problem = bare.problem(bare.simulate(0), 0)
    rng = stream(0, 0, "sensor beacons")

    def parts() -> Iterator[Epoch]:
        for begin in range(0, epochs, chunk):
            own = slice(begin, min(begin + chunk, epochs))
            times = recording.times[max(begin - 1, 0) : own.stop]
            values = {name: v[own] for name, v in truth.values.items()}
            part = Truth(truth.t[own], values)
            seen = [
                m
                for name, sensor in scenario.sensors.items()
                for m in measure(name, sensor, Timing(), part, rng, rng)
            ]
            made = make_epochs(scenario.processes, seen, recording.inputs, times)
            yield from made[1:] if begin else made

    rest = parts()
    return replace(problem, epochs=(next(rest),)), rest


def seconds(run: Callable[[], object]) -> float:
    """Time of one call."""
    begun = time.perf_counter()
    run()
    return time.perf_counter() - begun


def ratio(ours: Callable[[], object], other: Callable[[], object], pairs: int = 5) -> float:
    """Median over pairs, taken in turn, of the time of `other` over that of `ours`."""
    return float(np.median([seconds(other) / seconds(ours) for _ in range(pairs)]))
