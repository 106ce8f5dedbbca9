"""Static blocks: the elimination with a border against GTSAM's and a dense one, and each
estimator with such blocks against batch."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from passes import PRIOR, PROCESSES, SENSORS, ZHANG, sigmas, toy_measurements

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.window import Chain
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import System, linearize
from relnav_graph.linear.gtsam_chain import STATICS, Rows, chain_factors, chain_rows, eliminate
from relnav_graph.linear.segments import Segmented
from relnav_graph.scenario.build import load_scenario

sys.path.insert(0, str(Path(__file__).parents[2] / "experiments"))
from benchmarks.mapped import mapped


def _mapped(epochs: int, points: int) -> Problem:
    scenario = load_scenario(ZHANG.with_name("zhang2015_close.toml"), [f"time.epochs={epochs}"])
    recording = scenario.simulate(3)
    assert recording.truth is not None
    return mapped(scenario.problem(recording, 3), recording.truth, points)


@pytest.fixture(scope="module")
def mapping() -> Problem:
    return _mapped(60, 15)


def _system(problem: Problem, keep: bool = False) -> tuple[System, Rows]:
    """Linearised where the filter's smoother is, which is not the optimum."""
    start = run_estimator("rts", problem)
    assert start.statics is not None
    x = problem.layout.held(np.hstack([start.x, start.statics.x]))
    assembly, anchor = Assembly.of(problem), anchor_of(problem.prior)
    whiten, weight = assembly.whitening(x[:-1]), np.ones(assembly.observations)
    weight[7] = 0.0
    system = linearize(assembly, anchor, x, whiten, weight, keep=keep)
    return system, chain_rows(assembly, anchor, x, whiten, weight)


def _dense(rows: Rows) -> tuple[Array, Array]:
    """The step and its covariance by long doubles: all epochs, then the static blocks."""
    n, count = rows.states, len(rows.offsets) - 1
    m = rows.A.shape[1] - n
    parts: list[tuple[dict[int, Array], Array]] = [
        ({0: rows.A[:, :n], count: rows.A[:, n:]}, rows.e)
    ]
    for k in range(count):
        own = slice(rows.offsets[k], rows.offsets[k + 1])
        H = rows.measurements.H[own]
        parts.append(({k: H[:, :n], count: H[:, n:]}, rows.measurements.r[own]))
        if k < count - 1:
            A = rows.process.A[k]
            both = {k: A[:, :n], k + 1: rows.process.B[k], count: A[:, n:]}
            parts.append((both, rows.process.e[k]))
    J = np.zeros((sum(len(e) for _, e in parts), count * n + m), dtype=np.longdouble)
    begin = 0
    for blocks, e in parts:
        for k, block in blocks.items():
            J[begin : begin + len(e), k * n : k * n + block.shape[1]] = block
        begin += len(e)
    return _solved(J, np.concatenate([e for _, e in parts]))


def _solved(J: Array, r: Array) -> tuple[Array, Array]:
    """argmin ``|r + J y|^2`` and ``(J^T J)^-1``, by reflections of J in long doubles."""
    n = J.shape[1]
    a = np.hstack([J, -r[:, None]])
    for j in range(n):
        v = a[j:, j].copy()
        v[0] += np.copysign(np.sqrt(v @ v), v[0])
        if v @ v > 0:
            a[j:, j:] -= np.outer(v, (2 / (v @ v)) * (v @ a[j:, j:]))
    R, inverse = a[:n, :n], np.eye(n, dtype=np.longdouble)
    for i in range(n - 1, -1, -1):
        inverse[i] = (inverse[i] - R[i, i + 1 :] @ inverse[i + 1 :]) / R[i, i]
    y, P = inverse @ a[:n, n], inverse @ inverse.T
    return y.astype(np.float64), P.astype(np.float64)


def test_border_equals_a_dense_solution() -> None:
    system, rows = _system(_mapped(12, 5))
    y, P = _dense(rows)
    n, count = rows.states, len(system.x)
    step, found = system.conditionals.solution(), system.conditionals.marginals()
    sigma = np.sqrt(np.diag(P))
    moving, static = slice(count * n), slice(count * n, None)
    assert np.abs(y / sigma).max() > 0.1
    assert np.abs((step[:, :n].ravel() - y[moving]) / sigma[moving]).max() < 1e-5
    assert np.abs((step[:, n:] - y[static]) / sigma[static]).max() < 1e-5
    scale = np.outer(sigma, sigma)
    correlation = P / scale
    for k in (0, 1, count // 2, count - 1):
        own = np.r_[k * n : k * n + n, count * n : len(y)]
        whole = found.whole(slice(k, k + 1))[0] / scale[np.ix_(own, own)]
        np.testing.assert_allclose(whole, correlation[np.ix_(own, own)], atol=1e-5)


def test_border_equals_gtsams_elimination(mapping: Problem) -> None:
    """In order of time with the static blocks last, and by COLAMD's ordering."""
    system, rows = _system(mapping)
    n, m, count = rows.states, mapping.layout.statics.dim, len(system.x)
    factors = chain_factors(rows)
    theirs = eliminate(factors, count, n, m)
    P = theirs.marginals()
    fixed = np.sqrt(np.diag(P.statics))
    sigma = np.hstack([sigmas(P.P), np.tile(fixed, (count, 1))])
    step = system.conditionals.solution()
    assert np.abs((step - theirs.solution()) / sigma).max() < 1e-6
    assert system.conditionals.decrease() == pytest.approx(theirs.decrease(), rel=1e-6)
    graph = gtsam.GaussianFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    found = graph.eliminateMultifrontal(
        gtsam.Ordering.ColamdGaussianFactorGraph(graph), gtsam.EliminateQR
    ).optimize()
    other = np.array([np.concatenate([found.at(k), found.at(STATICS)]) for k in range(count)])
    assert np.abs((step - other) / sigma).max() < 1e-5


@pytest.mark.parametrize("damped", [False, True])
def test_two_levels_equal_one(damped: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Segments with the static blocks that they read, then their first epochs: the same step and
    covariances, with a part of a segment at the end, and where data beyond the pass tell more."""
    problem = _mapped(57, 40)
    found, _ = _system(problem)
    assert isinstance(found.conditionals, Segmented)
    assembly, anchor, weight = Assembly.of(problem), anchor_of(problem.prior), found.status == 0
    models = assembly, anchor, found.x, assembly.whitening(found.x[:-1])
    n, count = problem.layout.dim, len(found.x)
    damping = np.full((count, n), 3.0) if damped else None
    two = linearize(*models, weight.astype(float), damping)
    monkeypatch.setattr("relnav_graph.linear.elimination.MANY", n)
    one = linearize(*models, weight.astype(float), damping)
    assert not isinstance(one.conditionals, Segmented)
    a, b = one.conditionals, two.conditionals
    assert two.cost == pytest.approx(one.cost, rel=1e-12)
    assert b.decrease() == pytest.approx(a.decrease(), rel=1e-9)
    half = 0.25 * a.last_covariance()
    for end, P_end in ((None, None), (np.full(n, 1e-3), half)):
        P, Q = a.marginals(P_end), b.marginals(P_end)
        sigma, fixed = sigmas(P.P), np.sqrt(np.diag(P.statics))
        apart = a.solution(end) - b.solution(end)
        assert np.abs(apart / np.hstack([sigma, np.tile(fixed, (count, 1))])).max() < 1e-8
        assert np.abs((P.P - Q.P) / (sigma[:, :, None] * sigma[:, None, :])).max() < 1e-8
        assert np.abs((P.cross - Q.cross) / (sigma[:, :, None] * fixed)).max() < 1e-8
        assert np.abs((P.statics - Q.statics) / np.outer(fixed, fixed)).max() < 1e-8


def test_what_is_known_at_an_epoch_is_what_a_shorter_pass_tells(mapping: Problem) -> None:
    system, _ = _system(mapping, keep=True)
    k, c = 20, system.conditionals
    known = Chain(system.x, system.known, system.statics, c, c.solution()).summary(k)
    assembly = Assembly.of(replace(mapping, epochs=mapping.epochs[: k + 1]))
    x, weight = system.x[: k + 1], np.ones(assembly.observations)
    weight[7] = 0.0
    shorter = linearize(assembly, anchor_of(mapping.prior), x, assembly.whitening(x[:-1]), weight)
    inverse, P = np.linalg.inv(known.W), shorter.conditionals.last_covariance()
    sigma = np.sqrt(np.diag(P))
    assert np.abs((inverse @ inverse.T - P) / np.outer(sigma, sigma)).max() < 1e-6
    step = shorter.conditionals.solution()[-1]
    np.testing.assert_allclose(inverse @ known.d / sigma, step / sigma, atol=1e-6)


def _apart(problem: Problem, found: Track, reference: Track, k: int = -1) -> float:
    """Largest difference at one epoch, static blocks included, in sigmas of the reference."""
    a, b = found.statics, reference.statics
    assert a is not None
    assert b is not None
    moving, static = problem.layout.moving, problem.layout.statics
    own = moving.local(reference.x[k], found.x[k]) / sigmas(reference.P)[k]
    fixed = static.local(b.x[k], a.x[k]) / sigmas(b.P)[k]
    return float(np.abs(np.concatenate([own, fixed])).max())


def test_estimators_end_where_batch_does(mapping: Problem) -> None:
    """The linear-enough mapping of points seen at known poses."""
    batch = run_estimator("batch", mapping)
    assert batch.status == "ok", batch.message
    limits = {"iekf": 0.6, "rts": 0.6, "incremental": 0.1, "fixed_lag": 0.1}
    for kind, limit in limits.items():
        track = run_estimator(kind, mapping)
        assert track.status == "ok", (kind, track.message)
        assert _apart(mapping, track, batch) < limit, kind
    incremental = run_estimator("incremental", mapping).smoothed
    assert incremental is not None
    for k in range(len(batch.t)):
        assert _apart(mapping, incremental, batch, k) < 2e-3


def test_a_constant_that_is_static_is_one_that_hardly_walks() -> None:
    """The drift of a ranger: read and not advanced, or advanced with next to no noise."""
    moving = {"motion": PROCESSES["motion"]}
    measurements = toy_measurements()
    epochs = make_epochs(moving, measurements, {}, np.arange(30.0))
    static = Problem(moving, SENSORS, PRIOR, epochs)
    assert [b.name for b in static.layout.statics] == ["range_drift"]
    slow: dict[str, Any] = {
        **moving,
        "electronics": replace(PROCESSES["electronics"], time_constant=1e12, density=1e-9),
    }
    walking = Problem(slow, SENSORS, PRIOR, make_epochs(slow, measurements, {}, np.arange(30.0)))
    for kind in ("ekf", "iekf", "rts", "batch", "incremental", "fixed_lag"):
        one, other = run_estimator(kind, static), run_estimator(kind, walking)
        pairs = [(one, other)]
        if one.smoothed is not None and other.smoothed is not None:
            pairs.append((one.smoothed, other.smoothed))
        for a, b in pairs:
            for name in ("relative_position", "range_drift"):
                sigma = np.sqrt(np.diagonal(b.covariance(name), axis1=1, axis2=2))
                assert np.abs((a.value(name) - b.value(name)) / sigma).max() < 0.02, (kind, name)
                np.testing.assert_allclose(a.covariance(name), b.covariance(name), rtol=0.02)
            both = a.covariance("range_drift", "relative_position")
            other_both = b.covariance("range_drift", "relative_position")
            scale = np.sqrt(np.einsum("kii->ki", other_both))
            np.testing.assert_allclose(
                both / scale[:, :, None] / scale[:, None, :],
                other_both / scale[:, :, None] / scale[:, None, :],
                atol=0.02,
            )
