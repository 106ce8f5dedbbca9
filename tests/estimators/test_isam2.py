"""iSAM2 over our factors: batch's optimum, native factors of a user's, and a state that is a
value though the tree is none."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from extras import MINE, OTHER, at_zero, closure, extra_of, isotropic
from online_passes import assert_same, driven, fresh, in_sigmas, snapshot, toy
from passes import EXPERIMENTS, linear_problem, sigmas, spoilt_toy

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import EstimationError, InputError
from relnav_graph.estimators import run_estimator, try_estimator
from relnav_graph.estimators.isam2 import Extra, Isam2, Keys
from relnav_graph.linear import gtsam_tree
from relnav_graph.linear.gtsam_graph import graph_of, to_track
from relnav_graph.maths.losses import Loss
from relnav_graph.runs.graph import Graph, gauss_newton, to_gtsam
from relnav_graph.scenario.build import load_scenario


def _smoothed(track: Track) -> Track:
    assert track.status == "ok", track.message
    assert track.smoothed is not None
    return track.smoothed


def _far(a: Track, b: Track) -> float:
    """Largest difference of two tracks, in sigmas of the second."""
    return float(np.abs(b.layout.local(b.x, a.x) / sigmas(b.P)).max())


# --- the same optimum --------------------------------------------------------------------------


def test_forced_updates_at_the_end_lead_to_batch() -> None:
    scenario = load_scenario(EXPERIMENTS / "zhang2015_close.toml", ["time.epochs=100"])
    problem = scenario.problem(scenario.simulate(0), 0)
    track, batch = run_estimator("isam2", problem), run_estimator("batch", problem)
    end = _smoothed(track)
    assert (track.name, end.name) == ("isam2", "isam2_smoothed")
    assert _far(end, batch) < 1e-3
    scale = sigmas(batch.P)[:, :, None] * sigmas(batch.P)[:, None]
    np.testing.assert_allclose(end.P / scale, batch.P / scale, atol=1e-4)
    last = np.abs(problem.layout.local(batch.x[-1], track.x[-1]) / sigmas(batch.P)[-1])
    assert last.max() < 0.3
    np.testing.assert_allclose(sigmas(track.P)[-1], sigmas(batch.P)[-1], rtol=0.02)


@pytest.mark.parametrize("density", [1e-2, 1e-6])
def test_a_linear_pass_is_filtered_exactly(density: float) -> None:
    problem = linear_problem(density)
    track, ekf = run_estimator("isam2", problem), run_estimator("ekf", problem)
    assert _far(track, ekf) < 1e-6
    np.testing.assert_allclose(sigmas(track.P), sigmas(ekf.P), rtol=1e-6)
    assert _far(_smoothed(track), run_estimator("rts", problem)) < 1e-6


@pytest.mark.parametrize(
    "changes",
    [
        {"gates": {"fix": 0.999}},
        {"losses": {"fix": Loss("huber")}},
        {"losses": {"fix": Loss("tukey")}},
    ],
)
def test_gates_and_losses_are_those_of_batch(changes: dict[str, Any]) -> None:
    problem = replace(spoilt_toy(), **changes)
    track, batch = run_estimator("isam2", problem), run_estimator("batch", problem)
    assert _far(_smoothed(track), batch) < 1e-2
    assert track.rejected == batch.rejected
    assert track.downweighted == batch.downweighted


def _static() -> Problem:
    """The toy with a drift of the ranger that nothing advances: one value for the pass."""
    whole = toy()
    processes = {"motion": whole.processes["motion"]}
    drop = [
        replace(e, inputs={"motion": e.inputs["motion"]} if e.inputs else {}) for e in whole.epochs
    ]
    problem = Problem(processes, whole.sensors, whole.prior, tuple(drop), window=whole.window)
    assert [b.name for b in problem.layout.statics] == ["range_drift"]
    return problem


def test_static_blocks_are_one_variable_and_come_to_batch() -> None:
    problem = _static()
    track, batch = run_estimator("isam2", problem), run_estimator("batch", problem)
    assert track.status == batch.status == "ok"
    ends = (_smoothed(track), to_track(problem, graph := to_gtsam(problem), gauss_newton(graph)))
    names = [b.name for b in problem.layout]
    want = batch.covariance(*names)
    scale = sigmas(want)[:, :, None] * sigmas(want)[:, None]
    for end in ends:
        assert _far(end, batch) < 1e-3
        drift = np.abs(end.value("range_drift") - batch.value("range_drift"))
        assert drift.max() < 1e-3 * sigmas(want)[0, -1]
        np.testing.assert_allclose(end.covariance(*names) / scale, want / scale, atol=1e-4)
    last = want[-1], track.covariance(*names)[-1]
    np.testing.assert_allclose(last[0] / scale[-1], last[1] / scale[-1], atol=1e-2)
    assert graph.values.size() == 2 * len(problem.epochs) + 1


def test_a_static_block_takes_native_factors_and_is_saved() -> None:
    problem = _static()
    key = Keys(problem.layout)["range_drift", None]
    extra = extra_of([gtsam.PriorFactorVector(key, np.array([0.1]), isotropic(1, 1e-4))])
    end, want = _smoothed(run_estimator("isam2", problem, extra)), _reference(problem, extra)
    np.testing.assert_allclose(end.value("range_drift"), want.value("range_drift"), atol=1e-7)
    sigma = np.sqrt(end.covariance("range_drift")[:, 0, 0])
    assert (sigma < 1e-4).all()
    one, other = driven("isam2", problem, problem.epochs[:13]), fresh("isam2", problem)
    one.add(extra)
    other.restore(one.state())
    for epoch in problem.epochs[13:]:
        one.step(epoch)
        other.step(epoch)
    assert_same(snapshot(one), snapshot(other))


# --- native factors ----------------------------------------------------------------------------


def _reference(problem: Problem, extra: Extra) -> Track:
    """Gauss-Newton over the whole graph, with the same factors."""
    batch = run_estimator("batch", problem)
    x = batch.x if batch.statics is None else np.hstack([batch.x, batch.statics.x])
    graph = graph_of(problem, x)
    graph.factors.push_back(extra.factors)
    graph.values.insert(extra.values)
    values = gauss_newton(graph, 1e-6)
    return to_track(problem, Graph(graph.factors, values, graph.keys), values)


@pytest.mark.parametrize("problem", [linear_problem(1e-3), toy()])
def test_a_loop_closure_counts_as_it_should(problem: Problem) -> None:
    keys = Keys(problem.layout)
    extra = extra_of([closure(keys, 4, 23, np.array([0.9, -0.4, 0.1]))])
    end, want = _smoothed(run_estimator("isam2", problem, extra)), _reference(problem, extra)
    assert _far(end, want) < 1e-4
    np.testing.assert_allclose(sigmas(end.P), sigmas(want.P), rtol=1e-4)
    assert _far(end, run_estimator("batch", problem)) > 1
    assert (sigmas(end.P)[4] < sigmas(run_estimator("batch", problem).P)[4]).any()


def test_a_variable_of_your_own_is_told() -> None:
    """A landmark that is seen, as a difference of positions, from two epochs."""
    problem = linear_problem(1e-3)
    keys = Keys(problem.layout)
    seen = [
        gtsam.BetweenFactorVector(
            keys["relative_position", k], MINE, np.array([1.0, 2.0, 3.0]), isotropic(3, 0.1)
        )
        for k in (3, 20)
    ]
    extra = extra_of(seen, {MINE: np.zeros(3)})
    track = run_estimator("isam2", problem, extra)
    (mean, P), want = track.extra[MINE], _reference(problem, extra).extra[MINE]
    np.testing.assert_allclose(mean, want[0], atol=1e-6)
    np.testing.assert_allclose(P, want[1], rtol=1e-6)
    one = driven("isam2", problem, problem.epochs[:10])
    one.add(extra)
    assert not one.variables
    for epoch in problem.epochs[10:]:
        one.step(epoch)
    np.testing.assert_allclose(one.variables[MINE][0], mean, atol=1e-6)
    np.testing.assert_allclose(one.variables[MINE][1], P, rtol=1e-5)


def test_factors_added_online_count_at_once_and_from_the_beginning() -> None:
    problem = toy()
    keys = Keys(problem.layout)
    extra = extra_of([closure(keys, 2, 15, np.array([0.6, -0.7, 0.0]))])
    one = driven("isam2", problem, problem.epochs[:20])
    before = one.P.copy()
    one.add(extra)
    assert np.trace(one.P[:3, :3]) < np.trace(before[:3, :3])
    late = replace(problem.epochs[17].measurements[0], t=17.0, z=np.array([[10.1, -6.2, 4.0]]))
    one.insert([late])  # goes back beyond the closure, which is added again
    for epoch in problem.epochs[20:]:
        one.step(epoch)
    spoilt = replace(problem.epochs[17], measurements=(*problem.epochs[17].measurements, late))
    given = replace(problem, epochs=(*problem.epochs[:17], spoilt, *problem.epochs[18:]))
    track = run_estimator("isam2", given, extra)
    sigma = np.sqrt(np.diag(one.P))
    assert np.abs(problem.layout.local(one.x, track.x[-1]) / sigma).max() < 1e-2


BAD: dict[str, tuple[Callable[[Keys], Extra], str]] = {
    "no such block": (
        lambda keys: extra_of([gtsam.PriorFactorVector(gtsam.symbol("y", 3), *at_zero(3))]),
        "found key y3, expected one of a block",
    ),
    "no such variable": (
        lambda keys: extra_of([gtsam.PriorFactorVector(MINE, *at_zero(3))]),
        "found key L0, expected",
    ),
    "another size": (
        lambda keys: extra_of([gtsam.PriorFactorVector(keys["relative_position", 3], *at_zero(2))]),
        "found prior of 2 numbers for a3, expected 3",
    ),
    "another type": (
        lambda keys: extra_of(
            [gtsam.PriorFactorRot3(keys["relative_position", 3], gtsam.Rot3(), isotropic(3, 1.0))]
        ),
        "does not fit a3",
    ),
    "not a number": (
        lambda keys: extra_of(
            [
                gtsam.PriorFactorVector(
                    keys["relative_position", 3], np.full(3, np.nan), isotropic(3, 1.0)
                )
            ]
        ),
        "expected finite numbers",
    ),
    "a value in no factor": (
        lambda keys: extra_of([], {MINE: np.zeros(3)}),
        "found a value of L0, which is in no factor",
    ),
    "a value of a block": (
        lambda keys: extra_of([], {keys["relative_position", 3]: np.zeros(3)}),
        "found a value of a3, which is relative_position of epoch 3",
    ),
    "undetermined": (
        lambda keys: extra_of(
            [gtsam.BetweenFactorVector(MINE, OTHER, np.zeros(3), isotropic(3, 1.0))],
            {MINE: np.zeros(3), OTHER: np.zeros(3)},
        ),
        "does not determine variable L|does not determine L",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_does_not_fit_is_named_and_nothing_changes(name: str) -> None:
    problem = toy()
    make, says = BAD[name]
    extra = make(Keys(problem.layout))
    one, reference = driven("isam2", problem, problem.epochs[:12]), driven("isam2", problem)
    before = snapshot(one)
    with pytest.raises((InputError, EstimationError), match=says):
        one.add(extra)
    assert_same(snapshot(one), before)
    for epoch in problem.epochs[12:]:
        one.step(epoch)
    assert_same(snapshot(one), snapshot(reference))
    if name != "undetermined":
        with pytest.raises(InputError, match=says):
            run_estimator("isam2", problem, extra)
        return
    track = run_estimator("isam2", problem, extra)
    assert track.status == "diverged"
    assert re.search(says, track.message)


def test_a_factor_on_an_epoch_that_is_not_there() -> None:
    problem = toy()
    extra = extra_of([closure(Keys(problem.layout), 3, 30, np.zeros(3))])
    with pytest.raises(InputError, match="1 extra factors of a3, a30 name epoch 30, and there are"):
        run_estimator("isam2", problem, extra)
    one = driven("isam2", problem, problem.epochs[:10])
    one.add(extra)  # it waits
    assert not np.isnan(one.step(problem.epochs[10]).x).any()


@pytest.mark.parametrize("kind", ["ekf", "batch", "incremental", "fixed_lag", "rts"])
def test_estimators_without_a_graph_refuse_extra_factors(kind: str) -> None:
    with pytest.raises(InputError, match=f"estimator '{kind}' takes no extra factors; isam2 does"):
        run_estimator(kind, toy(), extra_of([]))
    if kind not in ("batch", "rts"):
        with pytest.raises(InputError, match="takes no extra factors"):
            fresh(kind, toy()).add(extra_of([]))


def test_a_history_too_long_for_the_stack_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gtsam_tree, "DEPTH", 2**20)
    track = try_estimator("isam2", toy())
    assert track.status == "diverged"
    assert "expected at most" in track.message
    assert "incremental or fixed_lag" in track.message


def test_only_isam2_knows_gtsam() -> None:
    """As the README says."""
    import relnav_graph.estimators as package

    folder = Path(str(package.__file__)).parent
    named = [path.name for path in folder.glob("*.py") if "gtsam" in path.read_text()]
    assert named == ["isam2.py"]
    assert Isam2.kind == "isam2"
    assert in_sigmas(toy().layout, driven("isam2", toy()), driven("incremental", toy())) < 0.3


def _without_jacobians(this: Any, values: Any, jacobians: Any) -> Array:
    return np.zeros(3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda key: gtsam.NonlinearFactorGraph(), "found NonlinearFactorGraph, expected an Extra"),
        (
            lambda key: extra_of(
                [gtsam.PriorFactorVector(MINE, *at_zero(3))], {MINE: np.full(3, np.nan)}
            ),
            r"found \[nan nan nan\] as the value of L0",
        ),
        (
            lambda key: extra_of([gtsam.PriorFactorVector(key, np.zeros(3), isotropic(3, np.nan))]),
            "found sigmas .nan nan nan., expected positive",
        ),
        (
            lambda key: extra_of([gtsam.PriorFactorVector(key, np.zeros(3), isotropic(3, 0.0))]),
            "found sigmas .0. 0. 0.., expected positive",
        ),
        (
            lambda key: extra_of([gtsam.CustomFactor(isotropic(3, 1.0), [], _without_jacobians)]),
            "found no key",
        ),
    ],
)
def test_what_no_tree_could_take_is_refused_by_name(
    given: Callable[[int], Any], message: str
) -> None:
    problem = _static()
    with pytest.raises(InputError, match=message):
        run_estimator("isam2", problem, given(Keys(problem.layout)["relative_position", 3]))
