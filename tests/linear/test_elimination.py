"""The compiled elimination against GTSAM's, and parts of a pass against the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from passes import ZHANG, sigmas, toy_measurements, toy_problem

from relnav_graph.core.problem import Problem
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.incremental import WINDOW, IncrementalSmoother
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.gtsam_chain import chain_factors, chain_rows, eliminate, row_factor
from relnav_graph.scenario.build import load_scenario


def _zhang(epochs: int = 25) -> Problem:
    scenario = load_scenario(ZHANG, [f"time.epochs={epochs}"])
    return scenario.problem(scenario.simulate(4), 4)


@pytest.mark.parametrize("damped", [False, True])
def test_sweep_equals_gtsams_elimination(damped: bool) -> None:
    """Of the same rows, far from the optimum: step, decrease and covariances, relative to
    sigma. The density of an epoch's conditional does not depend on the signs of its rows."""
    problem = _zhang()
    x = run_estimator("rts", problem).x
    assembly, anchor = Assembly.of(problem), anchor_of(problem.prior)
    whiten = assembly.whitening(x[:-1])
    weight = np.ones(assembly.observations)
    weight[7] = 0.0
    damping = np.full((len(x), problem.layout.dim), 30.0) if damped else None
    ours = linearize(assembly, anchor, x, whiten, weight, damping)
    factors = chain_factors(chain_rows(assembly, anchor, x, whiten, weight))
    if damping is not None:
        factors += [row_factor({k: np.diag(d)}, np.zeros(len(d))) for k, d in enumerate(damping)]
    theirs = eliminate(factors, len(x), problem.layout.dim)
    P = theirs.covariances()
    sigma = sigmas(P)
    scale = sigma[:, :, None] * sigma[:, None, :]
    assert np.abs((ours.conditionals.covariances() - P) / scale).max() < 1e-6
    step = theirs.solution()
    assert np.abs(step / sigma).max() > 0.1
    assert np.abs((ours.conditionals.solution() - step) / sigma).max() < 1e-6
    assert ours.conditionals.decrease() == pytest.approx(theirs.decrease(), rel=1e-6)
    rows = assembly.measure(x, weight)
    e = [anchor.rows(assembly.layout, x[0])[0], assembly.process(x, whiten).e.ravel(), rows.r]
    assert ours.cost == pytest.approx(0.5 * np.sum(np.concatenate(e) ** 2), rel=1e-12)


def test_parts_of_an_assembly_are_what_the_constructor_makes() -> None:
    """Cut out, joined again, or assembled epoch by epoch as they come online."""
    problem = toy_problem(toy_measurements())
    whole = Assembly.of(problem)
    models, epochs = (problem.layout, problem.processes, problem.sensors), problem.epochs
    before = [None, *(e.t for e in epochs[:-1])]
    online = [Assembly(*models, [e], t) for e, t in zip(epochs, before, strict=True)]
    cut = [whole.at(k) for k in range(len(epochs))]
    x = run_estimator("ekf", problem).x
    weight = np.random.default_rng(0).uniform(size=whole.observations)
    expected, F = whole.measure(x, weight), whole.transition(x[:-1])[1]
    for parts in (cut, online, [Assembly.join(cut[:9]), *cut[9:]]):
        joined = Assembly.join(parts)
        found = joined.measure(x, weight)
        np.testing.assert_array_equal(found.r, expected.r)
        np.testing.assert_array_equal(found.H, expected.H)
        np.testing.assert_array_equal(joined.transition(x[:-1])[1], F)
        np.testing.assert_array_equal(joined.row_offsets, whole.row_offsets)
        np.testing.assert_array_equal(joined.times, whole.times)
        assert joined.by_sensor(weight > 0.5) == whole.by_sensor(weight > 0.5)
    tail = Assembly.join(cut[3:]).preceded()
    own = slice(whole.epoch_offsets[3], None)
    found = tail.measure(x[2:], weight[own])
    np.testing.assert_array_equal(found.r, expected.r[whole.row_offsets[3] :])
    np.testing.assert_array_equal(tail.transition(x[2:-1])[1], F[2:])


def test_incremental_stays_with_batch_over_several_windows() -> None:
    """Epochs that are compacted still count: the newest epoch, online, and the whole trajectory
    as it stands between two relinearisations."""
    problem = _zhang(2 * WINDOW + 60)
    smoother = IncrementalSmoother(problem, 1e9)  # the history is never taken up again
    for epoch in problem.epochs:
        smoother.step(epoch)
    assert len(smoother.state.parts()) - smoother.state.singles > 2
    assert smoother.state.singles < WINDOW
    batch = run_estimator("batch", problem)
    layout, sigma = problem.layout, sigmas(batch.P)
    assert np.abs(layout.local(batch.x[-1], smoother.x) / sigma[-1]).max() < 0.1
    now = smoother._trajectory(smoother.state, smoother.state.parts())
    _, solution = smoother.finish()
    assert np.abs(layout.local(batch.x, solution.x) / sigma).max() < 2e-3
    assert np.abs(layout.local(batch.x, now) / sigma).max() < 0.5


def test_a_failed_step_leaves_incremental_where_it_was() -> None:
    """Between two relinearisations: the epoch counts as not taken in, and the next goes on."""
    problem = toy_problem(toy_measurements())
    smoother = IncrementalSmoother(problem, 1e9)
    for epoch in problem.epochs[:12]:
        smoother.step(epoch)
    x, state = smoother.x.copy(), smoother.state
    wrong = replace(problem.epochs[12], t=99.0)
    with pytest.raises(ValueError, match="in the epoch at 99"):
        smoother.step(wrong)
    np.testing.assert_array_equal(smoother.x, x)
    assert smoother.state is state
    for epoch in problem.epochs[12:]:
        smoother.step(epoch)
    batch = run_estimator("batch", problem)
    assert np.abs(problem.layout.local(batch.x[-1], smoother.x) / sigmas(batch.P)[-1]).max() < 0.1
