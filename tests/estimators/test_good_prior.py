"""A target without a model of which all is known well from the beginning: then hardly anything is
bent, and estimators that linearise once must agree with the batch. It separates faults from
nonlinearity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from passes import EXPERIMENTS

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators import fixed_lag, run_estimator
from relnav_graph.runs.passes import open_pass
from relnav_graph.scoring.agreement import distances
from relnav_graph.scoring.bounds import true_trajectory

KINDS = ("ekf", "iekf", "fixed_lag")
SETTINGS = ["time.epochs=150", "truth.map.count=20"]
#: Sigmas by block, SI; of blocks that are not named, as in the scenario.
KNOWN = {
    "relative_position": 1e-3,
    "point": 1e-3,
    "chaser_attitude": 1e-5,
    "target_attitude": 1e-5,
    "target_rate": 1e-5,
    "inertia_matrix_parameters": 1e-3,
}


def known(scale: float) -> Problem:
    """The pass with a prior of so many times these sigmas, its mean drawn about the truth."""
    opened = open_pass(EXPERIMENTS / "inspection.toml", 0, assignments=SETTINGS)
    problem, layout = opened.problem, opened.problem.layout
    truth = true_trajectory(problem, opened.recording.truth)[0]
    sigma = np.sqrt(np.diag(problem.prior.P))
    for block in layout:
        name = block.name if block.number is None else block.family
        if name in KNOWN:
            sigma[layout.tangent(block.name)] = scale * KNOWN[name]
    drawn = sigma * np.random.default_rng(1).standard_normal(layout.dim)
    return replace(problem, prior=Prior(layout.retract(truth, drawn), np.diag(sigma**2)))


def tracks(scale: float, monkeypatch: pytest.MonkeyPatch) -> dict[str, Track]:
    # The window slides from the beginning: it would hold the whole of so short a pass.
    monkeypatch.setattr(fixed_lag, "BEGUN", 0.0)
    problem = known(scale)
    assert sum(b.number is not None for b in problem.layout) == pytest.approx(20, abs=3)
    found = {kind: run_estimator(kind, problem) for kind in ("batch", *KINDS)}
    assert all(track.status == "ok" for track in found.values())
    return found


def test_with_a_good_prior_no_state_ends_far_from_the_batch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """0.002 to 0.02 sigma."""
    found = tracks(1.0, monkeypatch)
    reference, apart = distances(found)
    assert set(reference.values()) == {"batch"}
    for kind in KINDS:
        assert 0 < (apart[kind] or np.inf) < 0.05, kind


def test_with_a_better_prior_nor_do_all_states_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """All states together are known a hundred times better than each, in what a torque of 1e-8
    rad/s^1.5 leaves to chance: there the good prior's errors of second order are half a sigma. Ten
    times smaller sigmas make them a thirtieth of it; a fault would not be smaller."""
    found = tracks(0.1, monkeypatch)
    for kind in KINDS:
        assert together(found["batch"], found[kind]) < 0.05, kind


def together(batch: Track, track: Track) -> float:
    """How far the last epoch, static blocks included, is from the batch's, in its sigmas."""
    blocks, one = batch.blocks, batch.at(slice(-1, None))
    e: Array = np.concatenate(
        [b.local(batch.value(b.name)[-1], track.value(b.name)[-1]) for b in blocks]
    )
    P = one.covariance(*(b.name for b in blocks))[0]
    return float(np.sqrt(e @ np.linalg.solve(P, e)))
