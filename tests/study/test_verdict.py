"""Variance components and the verdict: what is wrong is named, and nothing else is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from passes import ZHANG, linear_problem, toy_measurements, toy_problem

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.estimators import run_estimator
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.gtsam_chain import chain_factors, chain_rows
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.variance_components import estimate_factors, noise_residuals
from relnav_graph.study.collect import collect
from relnav_graph.study.record import RunRecord
from relnav_graph.study.runs import StudySpec, run_record
from relnav_graph.study.summary import summarize
from relnav_graph.study.verdict import verdict

GYRO = "processes.chaser.angle_random_walk_density"


def _dense(problem: Problem, x: Array) -> tuple[Array, Array, list[str]]:
    """Whitened rows A d + e of a pass, from its factors, and the group of each row."""
    assembly = Assembly(problem.layout, problem.processes, problem.sensors, problem.epochs)
    whiten = assembly.whitening(x[:-1])
    ones = np.ones(assembly.observations)
    chain = chain_factors(chain_rows(assembly, anchor_of(problem.prior), x, whiten, ones))
    n, rows, errors, groups = problem.layout.dim, [], [], []
    sensors = np.repeat(assembly.sensor_of, assembly.heights)
    of_row = [f"sensors.{assembly.sensor_names[i]}" for i in sensors]
    of_state = {
        i: f"processes.{name}.{(p.noises or tuple(b.name for b in p.advances))[j]}"
        for name, p in problem.processes.items()
        for j, b in enumerate(p.advances)
        for i in range(problem.layout.tangent(b.name).start, problem.layout.tangent(b.name).stop)
    }
    for count, factor in enumerate(chain):
        A, b = factor.jacobian()
        full = np.zeros((len(b), n * len(x)))
        keys = list(factor.keys())
        for i, key in enumerate(keys):
            full[:, n * key : n * key + n] = A[:, n * i : n * i + n]
        rows.append(full)
        errors.append(-b)
        if count == 0:
            groups += ["prior"] * n
        elif len(keys) == 2:
            groups += [of_state[i] for i in range(n)]
        else:
            groups += list(
                of_row[assembly.row_offsets[keys[0]] : assembly.row_offsets[keys[0] + 1]]
            )
    return np.vstack(rows), np.concatenate(errors), groups


@pytest.mark.parametrize("problem", [linear_problem(0.02), toy_problem(toy_measurements())])
def test_squares_and_coupling_are_those_of_the_projector(problem: Problem) -> None:
    x = run_estimator("batch", problem).x
    A, e, groups = _dense(problem, x)
    Q = np.eye(len(e)) - A @ np.linalg.pinv(A)
    rng = np.random.default_rng(1)
    probes = [noise_residuals(problem, x, rng) for _ in range(60)]
    names = list(probes[0].squares)
    masks = [np.array([g == name for g in groups]) for name in names]
    squares = [((Q @ e)[m] ** 2).sum() for m in masks]
    np.testing.assert_allclose(list(probes[0].squares.values()), squares, rtol=1e-6)
    T = np.array([[(Q[np.ix_(a, b)] ** 2).sum() for b in masks] for a in masks])
    found = np.array([p.coupling for p in probes])
    spread = found.std(axis=0) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - T) < 5 * spread + 1e-6).all()


def test_factors_solve_the_normal_equations() -> None:
    T = np.array([[100.0, 5.0, 0.0], [5.0, 60.0, 0.0], [0.0, 0.0, 2.0]])
    factors, sigma = estimate_factors(T @ np.array([4.0, 1.0, 1.0]), T)
    np.testing.assert_allclose(factors, [4.0, 1.0, 1.0])
    np.testing.assert_allclose(sigma[:2], np.sqrt(2 * np.diag(np.linalg.inv(T[:2, :2]))))
    assert np.isinf(sigma[2])  # hardly tested


def test_factors_are_as_uncertain_as_a_few_probes_leave_them() -> None:
    """A random walk under noise 30 times as large: residuals hardly show its steps. Of many runs,
    with the coupling of eight probes, the factors scatter as their sigmas say, which the number of
    runs alone would put far lower."""
    count, runs, probes, rng = 150, 200, 8, np.random.default_rng(5)
    steps = 30.0 * (np.eye(count)[1:] - np.eye(count)[:-1])
    A = np.vstack([np.eye(count), steps])
    Q = np.eye(len(A)) - A @ np.linalg.pinv(A)
    groups = [slice(0, count), slice(count, len(A))]
    T = np.array([[(Q[a, b] ** 2).sum() for b in groups] for a in groups])
    scores, alone = [], []
    for _ in range(150):
        e = Q @ rng.standard_normal((len(A), runs))
        squares = np.array([(e[g] ** 2).sum() for g in groups])
        found = np.zeros((probes, 2, 2))
        for one in found:
            z = rng.choice((-1.0, 1.0), len(A))
            one[:] = [[((Q[a, b] @ z[b]) ** 2).sum() for b in groups] for a in groups]
        factor, sigma = estimate_factors(squares, runs * found)
        scores.append((factor - 1) / sigma)
        alone.append((factor - 1) / np.sqrt(2 * np.diag(np.linalg.inv(runs * T))))
    spread, naive = np.sqrt(np.mean(np.square(scores), axis=0)), np.std(alone, axis=0)
    assert naive[1] > 2
    assert (spread < 1.4).all()
    assert (spread > 0.7).all()


def _verdict(settings: tuple[str, ...], seed: int, runs: int, kinds: tuple[str, ...]) -> Any:
    scenario = load_scenario(ZHANG, ("time.epochs=40", *settings))
    spec = StudySpec.of(scenario, seed, kinds)
    records = [RunRecord.from_bytes(run_record(spec.to_json(), run), "") for run in range(runs)]
    found = collect(records)
    return verdict(summarize(spec, found, 40, ""), found, scenario)


def test_a_gyro_noise_declared_too_small_is_named() -> None:
    found = _verdict((f'{GYRO}="1.0540926e-5 rad/sqrt(s)"',), 0, 3, ("iekf", "batch"))
    assert found["causes"] == [GYRO]
    (noise,) = [n for n in found["noises"] if n["noise"] == GYRO]
    assert noise["factor"] == pytest.approx(3.0, rel=0.15)
    (line,) = [t for t in found["text"] if t.startswith("Likely cause")]
    assert "times too small" in line
    assert "gyro" in line.split(":")[-1]
    assert not any("constant" in t for t in found["text"])  # for the noise explains it all
    assert found["sensors"]["iekf"]["beacons"]["verdict"] == "optimistic"


def test_a_gyro_noise_declared_too_large_is_named_as_such() -> None:
    found = _verdict((f'{GYRO}="1e-4 rad/sqrt(s)"',), 0, 3, ("iekf", "batch"))
    assert found["causes"] == [GYRO]
    assert any("times too large" in t for t in found["text"])


@pytest.mark.parametrize("seed", range(20))
def test_with_nothing_wrong_nothing_is_named(seed: int) -> None:
    found = _verdict((), seed, 2, ("batch",))
    assert found["causes"] == []
    assert found["text"] == ["batch (smoothed): consistent in all 10 states."]


def test_without_a_smoother_the_verdict_says_what_would_tell() -> None:
    found = _verdict((f'{GYRO}="1.0540926e-5 rad/sqrt(s)"',), 0, 2, ("iekf",))
    assert found["causes"] == []
    assert "A smoother in the study" in found["text"][-1]


def test_what_a_filter_linearises_badly_is_not_blamed_on_a_noise() -> None:
    found = _verdict((), 1, 3, ("ekf", "batch"))
    assert found["causes"] == []
    assert found["states"]["ekf"]["relative_position"]["verdict"] == "optimistic"
    assert found["text"][-1].endswith(
        "What is wrong is the linearisation of ekf, or what it leaves out of the model."
    )
