"""Bounds, variance components and observability of passes with a static block."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from passes import EXPERIMENTS
from static_tracks import drifting_pass

from relnav_graph.arrays import Array
from relnav_graph.cli.main import main
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.runs.passes import open_pass
from relnav_graph.scoring.bounds import bounds, true_trajectory
from relnav_graph.scoring.metrics import score
from relnav_graph.scoring.observability import explain
from relnav_graph.scoring.text import explain_table
from relnav_graph.scoring.variance_components import noise_residuals


def dense_rows(problem: Problem, x: Array, epochs: int) -> Array:
    """Whitened rows A of the first epochs of a pass, over all their states and, last, the static
    block: prior, intervals, measurements; without any code of the estimators."""
    assembly = Assembly.of(problem)
    m = assembly.measure(x, np.ones(assembly.observations))
    _, F, Q = assembly.transition(x[:-1])
    n, w = 6, 7
    out = []

    def put(k: int, A: Array, then: Array | None = None) -> None:
        full = np.zeros((len(A), n * epochs + 1))
        full[:, n * k : n * k + n], full[:, -1:] = A[:, :n], A[:, n:]
        if then is not None:
            full[:, n * k + n : n * k + 2 * n] = then
        out.append(full)

    put(0, np.linalg.inv(np.linalg.cholesky(problem.prior.P)))
    for k in range(epochs):
        put(k, m.H[assembly.row_offsets[k] : assembly.row_offsets[k + 1]])
        if k + 1 < epochs:
            W = np.linalg.inv(np.linalg.cholesky(Q[k]))
            assert F[k].shape == (n, w)
            put(k, -W @ F[k], W)
    return np.vstack(out)


def joint(P: Array, k: int) -> Array:
    """Of epoch k and the static block, from the covariance of all."""
    chosen = [*range(6 * k, 6 * k + 6), len(P) - 1]
    return P[np.ix_(chosen, chosen)]


def whole(track: Track) -> Array:
    return track.covariance(*(b.name for b in track.blocks))


def test_bounds_are_those_of_the_dense_information() -> None:
    problem, truth = drifting_pass(epochs=12)
    x = true_trajectory(problem, truth)
    found = bounds(problem, x)
    assert [b.name for b in found.smoothed.blocks][-1] == "range_drift"
    A = dense_rows(problem, x, 12)
    P = np.asarray(np.linalg.inv(A.T @ A))
    for k in range(12):
        np.testing.assert_allclose(whole(found.smoothed)[k], joint(P, k), rtol=1e-6, atol=1e-12)
        A = dense_rows(problem, x, k + 1)
        want = joint(np.asarray(np.linalg.inv(A.T @ A)), k)
        np.testing.assert_allclose(whole(found.filtered)[k], want, rtol=1e-6, atol=1e-12)
    static = found.smoothed.covariance("range_drift")[:, 0, 0]
    assert np.ptp(static) == 0
    assert np.isclose(found.filtered.covariance("range_drift")[-1, 0, 0], static[0], rtol=1e-9)


def test_variance_components_are_those_of_the_dense_projector() -> None:
    problem, _ = drifting_pass(3, epochs=8)
    track = run_estimator("batch", problem)
    found = noise_residuals(problem, track.states, np.random.default_rng(0))
    assert set(found.squares) == {
        *("sensors.fix", "sensors.ranger", "prior"),
        "processes.motion.acceleration_density",
    }
    A = dense_rows(problem, track.states, 8)
    # All rows together leave as many freedoms as there are rows beyond states.
    probes = [noise_residuals(problem, track.states, np.random.default_rng(k)) for k in range(200)]
    T = np.mean([p.coupling for p in probes if p.coupling is not None], axis=0)
    assert T.sum() == pytest.approx(A.shape[0] - A.shape[1], rel=0.05)
    assert sum(found.squares.values()) == pytest.approx(2 * found.cost, rel=1e-6)


def test_explain_names_a_static_block() -> None:
    problem, truth = drifting_pass()
    found = explain("toy", problem, true_trajectory(problem, truth), [], None)
    one = found["statics"]["range_drift"]
    assert one["prior"] == pytest.approx(0.2)
    assert one["smoother"] == pytest.approx(one["filter"])
    assert one["smoother"] < 0.1
    text = explain_table(found)
    assert "Predicted 1-sigma of constants" in text
    assert text.count("range_drift [m]") == 1
    # Fixes alone say nothing of the drift: it stays as it was, by name.
    epochs = [
        type(e)(e.t, tuple(m for m in e.measurements if m.sensor == "fix"), e.inputs)
        for e in problem.epochs
    ]
    blind = type(problem)(problem.processes, problem.sensors, problem.prior, tuple(epochs))
    weak = explain("toy", blind, true_trajectory(blind, truth), [], None)["weak"]
    assert weak[0]["direction"] == "range drift, in s"
    assert weak[0]["verdict"] == "not observable"
    assert weak[0]["kept"] == pytest.approx(1)


def test_a_trajectory_without_its_static_blocks_is_refused() -> None:
    """Its rows are shorter than those that compiled loops read."""
    problem, _ = drifting_pass()
    track = run_estimator("batch", problem)
    assembly = Assembly.of(problem)
    weights = np.ones(assembly.observations)
    for refused in (
        lambda: explain("toy", problem, track.x, [], None),
        lambda: bounds(problem, track.x),
        lambda: assembly.measure(track.x, weights),
        lambda: assembly.measure(track.states[1:], weights),
        lambda: assembly.transition(track.x[:-1]),
        lambda: noise_residuals(problem, track.x),
        lambda: linearize(
            *(assembly, anchor_of(problem.prior), track.x),
            *(assembly.whitening(track.states[:-1]), weights),
        ),
    ):
        with pytest.raises(InputError, match=r"states: found an array .* expected \(\d+, 7\)"):
            refused()


def test_explain_without_truth_says_what_the_estimate_says(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Linearised at the batch estimate, constants included, the bounds are its covariances."""
    path = EXPERIMENTS / "zhang2015_static.toml"
    opened = open_pass(path, 1, None, ("time.epochs=60",))
    assert {"gyro_bias", "inertia_parameters"} <= {b.name for b in opened.scenario.layout.statics}
    track = run_estimator("batch", opened.problem)  # with the prior that the truth has given
    object.__setattr__(opened, "recording", replace(opened.recording, truth=None))
    monkeypatch.setattr("relnav_graph.cli.explain.open_pass", lambda *_: opened)
    capsys.readouterr()
    with pytest.raises(SystemExit, match="0"):
        main(["explain", str(path), "--json"])
    found = json.loads(capsys.readouterr().out)
    own = score(track, None, opened.scenario.derived, opened.scenario.window(track.t))
    for said, scores in ((found["states"], own.states), (found["statics"], own.statics)):
        assert said
        for name, state in said.items():
            assert state["smoother"] == pytest.approx(scores[name].sigma, rel=0.03), name
