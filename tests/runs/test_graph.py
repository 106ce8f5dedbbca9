"""Any problem as GTSAM's own kind of graph, and back: the same optimum, covariances and losses."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from independent import (
    at_the_end,
    dense_covariances_apart,
    far,
    levenberg_marquardt,
    marginals_apart,
)
from passes import EXPERIMENTS, linear_problem, sigmas, spoilt_toy, toy_measurements, toy_problem
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.errors import EstimationError, InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.linear.gtsam_factors import measurement_factor, prior_factor, process_factor
from relnav_graph.maths.losses import Loss
from relnav_graph.runs.graph import gauss_newton, reweigh, to_gtsam, to_track
from relnav_graph.scenario.build import load_scenario


def _close(epochs: int) -> Problem:
    scenario = load_scenario(EXPERIMENTS / "zhang2015_close.toml", [f"time.epochs={epochs}"])
    return scenario.problem(scenario.simulate(0), 0)


def test_gtsams_optimiser_comes_to_the_optimum_of_batch() -> None:
    problem = _close(300)
    batch, graph = run_estimator("batch", problem), to_gtsam(problem)
    track = to_track(problem, graph, levenberg_marquardt(graph))
    assert far(track, batch) < 1e-6
    scale = sigmas(batch.P)
    np.testing.assert_allclose(
        track.P / (scale[:, :, None] * scale[:, None]),
        batch.P / (scale[:, :, None] * scale[:, None]),
        atol=1e-6,
    )


def test_incremental_ends_at_gtsams_optimum_and_covariances_are_gtsams() -> None:
    """Between its relinearisations `incremental` may be a little off: at epoch 100 by 0.006."""
    problem = _close(100)
    graph = to_gtsam(problem)
    there = levenberg_marquardt(graph)
    optimum = to_track(problem, graph, there)
    assert at_the_end(run_estimator("incremental", problem), optimum) < 0.05
    assert dense_covariances_apart(graph, there, run_estimator("batch", problem)) < 1e-6
    assert marginals_apart(toy_problem(toy_measurements())) < 1e-9


@pytest.mark.parametrize("density", [1e-2, 1e-8])
def test_gauss_newton_from_the_prior_and_correlated_priors(density: float) -> None:
    """A linear problem: one step from anywhere; and the prior's correlations count."""
    problem = linear_problem(density)
    L = np.eye(6) + 0.3 * np.tril(np.random.default_rng(0).normal(size=(6, 6)), -1)
    prior = Prior(problem.prior.x, L @ problem.prior.P @ L.T)
    problem = replace(problem, prior=prior)
    x = np.tile(prior.x, (len(problem.epochs), 1))
    graph = to_gtsam(problem, x)
    track = to_track(problem, graph, gauss_newton(graph))
    batch = run_estimator("batch", problem)
    assert far(track, batch) < 1e-6
    np.testing.assert_allclose(track.P, batch.P, rtol=1e-6, atol=1e-9)


def test_uncorrelated_blocks_have_priors_of_their_own() -> None:
    problem = toy_problem(toy_measurements())
    x = np.tile(problem.prior.x, (30, 1))
    blocks = len(problem.layout)
    factors = to_gtsam(problem, x).factors
    assert factors.size() == blocks + 29 * len(problem.processes) + 60
    tied = replace(problem, prior=Prior(problem.prior.x, problem.prior.P + 1e-3))
    assert to_gtsam(tied, x).factors.size() == factors.size() - blocks + 1


@pytest.mark.parametrize("kind", ["huber", "cauchy", "dcs", "tukey", "student_t"])
def test_losses_by_reweighting_are_those_of_batch(kind: str) -> None:
    problem = replace(spoilt_toy(), losses={"fix": Loss(kind)})  # type: ignore[arg-type]
    graph, values, weights = reweigh(problem)
    batch = run_estimator("batch", problem)
    assert (weights < 1).sum() >= 5
    assert far(to_track(problem, graph, values), batch) < 1e-2
    plain = run_estimator("batch", replace(problem, losses={}))
    assert far(plain, batch) > 0.5


def test_gates_by_reweighting_are_those_of_batch() -> None:
    problem = replace(spoilt_toy(), gates={"fix": 0.999})
    graph, values, weights = reweigh(problem)
    batch = run_estimator("batch", problem)
    assert (weights == 0).sum() == batch.rejected["fix"] == 5
    assert far(to_track(problem, graph, values), batch) < 1e-2


@pytest.mark.parametrize("kind", ["huber", "cauchy", "student_t"])
def test_losses_are_gtsams_robust_noise_of_each_observation(kind: str) -> None:
    """The plain graph of a problem with losses is minimised by GTSAM itself."""
    problem = replace(spoilt_toy(), losses={"fix": Loss(kind), "ranger": Loss(kind)})  # type: ignore[arg-type]
    graph = to_gtsam(problem)
    assert graph.factors.size() == len(problem.layout) + 29 * 2 + 30 * (1 + 3)
    track = to_track(problem, graph, levenberg_marquardt(graph))
    assert far(track, run_estimator("batch", problem)) < 1e-2


def _fix(count: int) -> Measurement:
    return Measurement("fix", 0.0, np.arange(3.0 * count).reshape(-1, 3), np.arange(count))


def test_factors_take_losses_and_noise_models() -> None:
    sensor = linear_problem(1e-3).sensors["fix"]
    values = gtsam.Values()
    values.insert(1, np.array([30.0, 20.0, -10.0]))
    plain = measurement_factor(sensor, _fix(1), [1])
    s2 = 2 * plain.error(values) / 3
    robust = measurement_factor(sensor, _fix(1), [1], Loss("cauchy", 2.0))
    assert robust.error(values) == pytest.approx(0.5 * 3 * 4 * np.log1p(s2 / 4))
    twice = measurement_factor(sensor, _fix(2), [1], gtsam.noiseModel.Isotropic.Sigma(6, 2.0))
    assert twice.error(values) == pytest.approx(
        measurement_factor(sensor, _fix(2), [1]).error(values) / 4
    )
    for count, model in ((2, Loss("huber")), (1, gtsam.noiseModel.Unit.Create(2)), (1, "huber")):
        with pytest.raises(InputError, match=r"position_fix: found (a loss for 2|noise model)"):
            measurement_factor(sensor, _fix(count), [1], model)  # type: ignore[arg-type]
    process, still = WhiteNoiseAcceleration(acceleration_density=1e-3), (np.zeros(3), np.zeros(3))
    args = process, 0.0, np.array([[1.0]]), (1, 2), (3, 4), still
    for key in (2, 3, 4):
        values.insert(key, np.ones(3))
    s2 = 2 * process_factor(*args).error(values) / 6
    loss = process_factor(*args, Loss("cauchy", 3.0))
    assert loss.error(values) == pytest.approx(0.5 * 6 * 9 * np.log1p(s2 / 9))
    with pytest.raises(InputError, match="found x"):
        prior_factor(linear_problem(1.0).layout, Prior(np.zeros(3), np.eye(3)), [1, 2])


def test_keys_have_names_and_back() -> None:
    graph = to_gtsam(linear_problem(1e-3))
    keys = graph.keys
    key = keys["relative_velocity", 7]
    assert keys.back(key) == ("relative_velocity", 7)
    assert key in keys
    assert graph.values.exists(key)
    assert gtsam.symbol("X", 3) not in keys
    for wrong in (("attitude", 3), ("relative_velocity", -1), ("relative_velocity", None)):
        with pytest.raises(InputError, match="keys: found"):
            keys[wrong]
    with pytest.raises(InputError, match="keys: found X3"):
        keys.back(gtsam.symbol("X", 3))


def test_a_variable_of_your_own_is_in_the_track() -> None:
    problem = linear_problem(1e-3)
    graph, mine = to_gtsam(problem), gtsam.symbol("L", 0)
    place: Array = np.array([1.0, 2.0, 3.0])
    graph.values.insert(mine, place)
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
    graph.factors.add(gtsam.PriorFactorVector(mine, place, noise))
    track = to_track(problem, graph, graph.values)
    mean, P = track.extra[mine]
    np.testing.assert_array_equal(mean, place)
    np.testing.assert_allclose(P, 0.25 * np.eye(3), rtol=1e-9)


def test_what_does_not_fit_is_named() -> None:
    problem = linear_problem(1e-3)
    with pytest.raises(InputError, match=r"trajectory: found \(3, 6\), expected \(30, 6\)"):
        to_gtsam(problem, np.zeros((3, 6)))
    with pytest.raises(InputError, match=r"weights: found \(1,\)"):
        to_gtsam(problem, np.zeros((30, 6)), np.ones(1))
    graph, mine = to_gtsam(problem), gtsam.symbol("L", 0)
    graph.values.insert(mine, np.zeros(3))
    position = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
    # A variable in no factor; then one of which a direction is in none.
    with pytest.raises(EstimationError, match="does not determine variable L0"):
        to_track(problem, graph, graph.values)
    weak = gtsam.JacobianFactor(mine, np.diag([1.0, 1.0, 0.0]), np.zeros(3), position)
    point = gtsam.Values()
    point.insert(mine, np.zeros(3))
    graph.factors.add(gtsam.LinearContainerFactor(weak, point))
    with pytest.raises(EstimationError, match="does not determine variable L0"):
        to_track(problem, graph, graph.values)
