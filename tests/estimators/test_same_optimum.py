"""The same models in somebody else's graph: GTSAM's own variables, one per block and epoch,
with our factors between them, solved by GTSAM's own optimisers. Both ways give the same
numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np
import pytest
from passes import ZHANG, differences, sigmas

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.ekf import filter_problem
from relnav_graph.estimators.gauss_newton import Solution, solve
from relnav_graph.estimators.rts import smooth
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.gtsam_graph import Keys, graph_of
from relnav_graph.scenario.build import load_scenario


@dataclass(frozen=True, eq=False)
class Nonlinear:
    """A short pass, the batch smoother's result, and the trajectory that it began with."""

    problem: Problem
    start: Array
    solution: Solution

    @cached_property
    def keys(self) -> Keys:
        return Keys(self.problem.layout)

    def values(self, x: Array) -> gtsam.Values:
        return self.keys.values(x)

    def trajectory(self, values: gtsam.Values) -> Array:
        return self.keys.trajectory(values, len(self.start))

    def graph(self) -> gtsam.NonlinearFactorGraph:
        return graph_of(self.problem, self.start).factors

    def distance(self, x: Array) -> float:
        """Largest component of x minus the batch solution, in posterior sigmas."""
        d = differences(self.problem.layout, self.solution.x, x)
        return float(np.abs(d / sigmas(self.solution.conditionals.covariances())).max())

    def displaced(self, many: float) -> Array:
        """A trajectory some sigmas away from the solution, everywhere."""
        P = self.solution.conditionals.covariances()
        d = np.random.default_rng(5).choice([-1.0, 1.0], P.shape[:2])
        d *= many * sigmas(P)
        layout = self.problem.layout
        return np.array([layout.retract(a, b) for a, b in zip(self.solution.x, d, strict=True)])


@pytest.fixture(scope="module")
def nonlinear() -> Nonlinear:
    scenario = load_scenario(ZHANG, ["time.epochs=40"])
    problem = scenario.problem(scenario.simulate(1), 1)
    done = filter_problem(problem, 20)
    assert not done.stopped
    start = smooth(done)[0]
    assembly = Assembly(problem.layout, problem.processes, problem.sensors, problem.epochs)
    weights = np.ones(assembly.observations)
    solution = solve(assembly, problem.prior, start, weights, tolerance=1e-6)
    return Nonlinear(problem, start, solution)


def test_batch_gives_that_solution(nonlinear: Nonlinear) -> None:
    batch = run_estimator("batch", nonlinear.problem)
    assert batch.status == "ok", batch.message
    assert nonlinear.distance(batch.x) < 1e-3


def test_custom_factors_have_the_same_cost(nonlinear: Nonlinear) -> None:
    built = nonlinear.graph()
    at_best = built.error(nonlinear.values(nonlinear.solution.x))
    assert at_best == pytest.approx(nonlinear.solution.cost, rel=1e-9)
    # Not only there: the prior and both ends of each interval count.
    assert built.error(nonlinear.values(nonlinear.displaced(0.5))) > at_best + 1


def test_gradient_of_the_cost_equals_differences_far_from_the_optimum(
    nonlinear: Nonlinear,
) -> None:
    """With attitudes wrong by 0.3 rad the two ends of an interval do not fit, and the
    Jacobians of the retraction count; at the optimum they are the identity."""
    rng, layout = np.random.default_rng(8), nonlinear.problem.layout
    wrong = np.zeros((len(nonlinear.start), layout.dim))
    for block in layout:
        if block.manifold == "SO3":
            wrong[:, layout.tangent(block.name)] = 0.3 * rng.normal(size=(len(wrong), 3))
    x = np.array([layout.retract(a, d) for a, d in zip(nonlinear.start, wrong, strict=True)])
    built, values = nonlinear.graph(), nonlinear.values(x)
    gradient = built.linearize(values).gradientAtZero()
    for block in layout:
        if block.manifold != "SO3":
            continue
        direction, back = gtsam.VectorValues(), gtsam.VectorValues()
        for k in range(len(x)):
            d = 1e-6 * rng.normal(size=3)
            direction.insert(nonlinear.keys[block.name, k], d)
            back.insert(nonlinear.keys[block.name, k], -d)
        slope = sum(
            float(
                gradient.at(nonlinear.keys[block.name, k])
                @ direction.at(nonlinear.keys[block.name, k])
            )
            for k in range(len(x))
        )
        ahead, behind = values.retract(direction), values.retract(back)
        assert slope == pytest.approx((built.error(ahead) - built.error(behind)) / 2, rel=1e-5)


def _gauss_newton(
    built: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Keys
) -> gtsam.Values:
    ordering = keys.in_time(values)
    linear = built.linearize(values)
    return values.retract(linear.eliminateSequential(ordering, gtsam.EliminateQR).optimize())


def _levenberg_marquardt(
    built: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: Keys
) -> gtsam.Values:
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(0.0)
    params.setAbsoluteErrorTol(1e-12)
    return gtsam.LevenbergMarquardtOptimizer(built, values, params).optimize()


Step = Callable[[gtsam.NonlinearFactorGraph, gtsam.Values, Keys], gtsam.Values]


@pytest.mark.parametrize("method", [_gauss_newton, _levenberg_marquardt])
def test_batch_solution_is_where_gtsam_stays(nonlinear: Nonlinear, method: Step) -> None:
    """A stationary point of the cost that GTSAM builds from the custom factors."""
    after = method(nonlinear.graph(), nonlinear.values(nonlinear.solution.x), nonlinear.keys)
    assert nonlinear.distance(nonlinear.trajectory(after)) < 1e-3


def test_gtsam_comes_to_the_batch_solution_from_elsewhere(nonlinear: Nonlinear) -> None:
    start = nonlinear.displaced(0.5)
    assert nonlinear.distance(start) > 0.4
    built, values = nonlinear.graph(), nonlinear.values(start)
    for _ in range(8):
        values = _gauss_newton(built, values, nonlinear.keys)
    assert nonlinear.distance(nonlinear.trajectory(values)) < 1e-3


@pytest.mark.parametrize("last", [17, 35, 53])
def test_incremental_is_close_to_batch_over_what_it_has_seen(last: int) -> None:
    """Online, between relinearisations, where the filter is more than a sigma away."""
    scenario = load_scenario(ZHANG, ["time.epochs=54"])
    problem = scenario.problem(scenario.simulate(3), 3)
    seen = replace(problem, epochs=problem.epochs[: last + 1])
    batch = run_estimator("batch", seen)
    sigma = sigmas(batch.P)[last]

    def away(kind: str) -> float:
        x = run_estimator(kind, seen).x[last]
        return float(np.abs(problem.layout.local(batch.x[last], x) / sigma).max())

    assert away("iekf") > 1
    assert away("incremental") < 0.05
    track = run_estimator("incremental", problem)  # later epochs do not change what it said then
    assert np.abs(problem.layout.local(batch.x[last], track.x[last]) / sigma).max() < 0.05
    np.testing.assert_allclose(sigmas(track.P)[last], sigma, rtol=0.02)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_optimum_is_where_rounding_is(seed: int) -> None:
    """Not where the rounded cost is least by chance, 3e-6 sigma away; and no step is made
    after it."""
    scenario = load_scenario(ZHANG.with_name("zhang2015_close.toml"), ["time.epochs=300"])
    problem = scenario.problem(scenario.simulate(seed), seed)
    done = filter_problem(problem, 20)
    x = smooth(done, covariances=False)[0]
    found = solve(done.assembly, problem.prior, x, done.weights, tolerance=0.0)
    assert found.iterations < 10
    sigma = sigmas(found.conditionals.covariances())
    assert np.abs(found.conditionals.solution() / sigma).max() < 5e-7
