"""The fixed-lag window against the full batch, and against GTSAM's own."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from passes import PROCESSES, ZHANG, differences, sigmas, toy_measurements, toy_problem

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch, make_epochs
from relnav_graph.core.problem import Problem
from relnav_graph.errors import RelnavError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.fixed_lag import FixedLag
from relnav_graph.estimators.online.driver import online
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.gtsam_chain import row_factor
from relnav_graph.scenario.build import load_scenario

WINDOW = 6.0


def _linear() -> Problem:
    """Position fixes of a body under white acceleration."""
    fixes = [m for m in toy_measurements() if m.sensor == "fix"]
    return replace(toy_problem([]), epochs=make_epochs(PROCESSES, fixes, {}), window=WINDOW)


def _window_of_gtsam(problem: Problem) -> tuple[Array, Array]:
    """x and P at each epoch from an ISAM2 that holds the newest `WINDOW` seconds.

    The oldest keys come first in the ordering, and the window's are eliminated anew, so that
    they are leaves when they leave.
    """
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    params.enableRelinearization = False
    isam = gtsam.ISAM2(params)
    layout, n = problem.layout, problem.layout.dim
    assembly = Assembly.of(problem)
    reference = np.tile(problem.prior.x, (len(problem.epochs), 1))
    whiten = assembly.whitening(reference[:-1])
    process = assembly.process(reference, whiten)
    rows = assembly.measure(reference, np.ones(assembly.observations))
    x, P, inside = [], [], list[int]()
    for k, epoch in enumerate(problem.epochs):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        own = slice(assembly.row_offsets[k], assembly.row_offsets[k + 1])
        factors = [row_factor({k: rows.H[own]}, rows.r[own])]
        if k:
            factors.append(
                row_factor({k - 1: process.A[k - 1], k: process.B[k - 1]}, process.e[k - 1])
            )
        else:
            e, W = anchor_of(problem.prior).rows(layout, reference[0])
            factors.append(row_factor({0: W}, e))
        for factor in factors:
            graph.push_back(gtsam.LinearContainerFactor(factor))
        values.insert(k, np.zeros(n))
        inside.append(k)
        groups, again = gtsam.KeyGroupMap(), gtsam.KeyList()
        leaving = [i for i in inside if problem.epochs[i].t < epoch.t - WINDOW]
        for i in inside:
            groups.insert2(i, 0 if i in leaving else 1)
            if i < k:
                again.push_back(i)
        isam.update(graph, values, [], groups, gtsam.KeyList(), again, False)
        x.append(layout.retract(reference[k], isam.calculateEstimateVector(k)))
        P.append(isam.marginalCovariance(k))
        if leaving:
            leaves = gtsam.KeyList()
            for i in leaving:
                leaves.push_back(i)
            isam.marginalizeLeaves(leaves)
            inside = [i for i in inside if i not in leaving]
    return np.array(x), np.array(P)


def test_equal_to_a_window_of_isam2_on_a_linear_problem() -> None:
    problem = _linear()
    x, P = _window_of_gtsam(problem)
    track = run_estimator("fixed_lag", problem)
    np.testing.assert_allclose(track.x, x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(track.P, P, rtol=1e-8, atol=1e-13)


def test_equal_to_the_full_batch_over_what_it_has_seen() -> None:
    """On a linear problem: the current epoch, and each epoch as it left the window."""
    problem = _linear()
    track = run_estimator("fixed_lag", problem)
    assert track.smoothed is not None
    assert (track.kind, track.smoothed.kind) == ("filtered", "fixed-lag")
    lag = int(WINDOW) + 1
    for k in (0, 5, 12, 29):
        seen = run_estimator("batch", replace(problem, epochs=problem.epochs[: k + 1]))
        np.testing.assert_allclose(track.x[k], seen.x[-1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(track.P[k], seen.P[-1], rtol=1e-8, atol=1e-13)
        if k >= lag:
            np.testing.assert_allclose(track.smoothed.x[k - lag], seen.x[k - lag], atol=1e-9)
            np.testing.assert_allclose(
                track.smoothed.P[k - lag], seen.P[k - lag], rtol=1e-8, atol=1e-13
            )


@pytest.mark.parametrize("window", ["30 s", "100 s", "1000 s"])
def test_close_to_the_batch_on_a_tumbling_target(window: str) -> None:
    """What is relinearised no more costs little, and with a window over all, nothing."""
    scenario = load_scenario(ZHANG, ["time.epochs=40", f'online.window="{window}"'])
    problem = scenario.problem(scenario.simulate(0), 0)
    batch, track = run_estimator("batch", problem), run_estimator("fixed_lag", problem)
    assert track.smoothed is not None
    last = np.abs(differences(problem.layout, batch.x[-1:], track.x[-1:]) / sigmas(batch.P)[-1])
    assert last.max() < (1e-3 if window == "1000 s" else 0.5)
    if window == "1000 s":
        d = differences(problem.layout, batch.x, track.smoothed.x) / sigmas(batch.P)
        assert np.abs(d).max() < 5e-3
        np.testing.assert_allclose(sigmas(track.smoothed.P), sigmas(batch.P), rtol=1e-3)


def test_a_window_of_its_own_or_of_the_problem() -> None:
    problem = _linear()
    assert FixedLag().engine(problem).begin().parts == ()
    for window, expected in ((None, WINDOW), (3.0, 3.0)):
        engine = FixedLag(window).engine(problem)
        state = engine.begin()
        for epoch in problem.epochs:
            state = engine.advance(state, epoch)
        assert len(state.parts) == expected + 1
    engine = FixedLag().engine(replace(problem, window=None))
    state = engine.begin()
    for k in range(40):
        inputs = {name: np.ones((1, 1)) for name in problem.processes}
        state = engine.advance(state, Epoch(float(k), (), inputs))
    assert len(state.parts) == 30


@pytest.mark.parametrize("kind", ["ekf", "iekf", "fixed_lag", "incremental"])
def test_a_state_saved_and_restored_goes_on_with_the_same_numbers(kind: str) -> None:
    problem = toy_problem(toy_measurements(), window=WINDOW)
    one = online(kind, replace(problem, epochs=()))
    for epoch in problem.epochs[:20]:
        one.step(epoch)
    again = online(kind, replace(problem, epochs=()))
    state = one.state()
    assert all(isinstance(array, np.ndarray) for array in state.values())
    again.restore(state)
    late = next(m for m in problem.epochs[17].measurements if m.sensor == "fix")
    for each in (one, again):
        each.insert([replace(late, t=16.5)])
        for epoch in problem.epochs[20:]:
            each.step(epoch)
    np.testing.assert_array_equal(one.x, again.x)
    np.testing.assert_array_equal(one.P, again.P)
    assert one.totals == again.totals
    assert one.health() == again.health()


def test_a_step_that_cannot_be_names_the_sensor() -> None:
    problem = toy_problem(toy_measurements(), window=WINDOW)
    one = online("fixed_lag", replace(problem, epochs=()))
    for epoch in problem.epochs[:8]:
        one.step(epoch)
    x, far = one.x.copy(), replace(problem.epochs[8].measurements[0], z=np.full((1, 3), 1e200))
    with pytest.raises(RelnavError, match="'fix'"):
        one.step(replace(problem.epochs[8], measurements=(far,)))
    np.testing.assert_array_equal(one.x, x)
