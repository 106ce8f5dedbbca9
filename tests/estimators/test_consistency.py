"""Accuracy, and normalised errors against their chi-square bounds, over seeded runs."""

from __future__ import annotations

import numpy as np
import pytest
from passes import ZHANG, differences, stored
from scipy.special import chdtri

from relnav_graph.arrays import Array
from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

RUNS = 16


def _run(scenario: Scenario, kinds: tuple[str, ...], runs: int) -> dict[str, list[Array]]:
    """Errors (N, dim) of each run and their NEES (N, 1) beside them, by estimator."""
    found: dict[str, list[Array]] = {kind: [] for kind in kinds}
    for run in range(runs):
        recording = scenario.simulate(7, run)
        assert recording.truth is not None
        problem = scenario.problem(recording, 7, run)
        for kind in kinds:
            track = run_estimator(kind, problem)
            e = differences(track.layout, track.x, stored(track.layout, recording.truth))
            nees = np.einsum("ki,ki->k", e, np.linalg.solve(track.P, e[..., None])[..., 0])
            found[kind].append(np.column_stack([e, nees]))
    return found


@pytest.fixture(scope="module")
def consistent() -> dict[str, list[Array]]:
    """A pass whose first update is near to linear, with every state drawn by its prior:
    there the filter, too, must be consistent."""
    settings = (
        "time.epochs=40",
        'prior.target_rate={sigma="0.1 deg/s", mean="drawn"}',
        'prior.inertia_parameters={sigma=0.05, mean="drawn"}',
    )
    return _run(load_scenario(ZHANG, settings), ("iekf", "batch"), RUNS)


@pytest.mark.parametrize("kind", ["iekf", "batch"])
@pytest.mark.parametrize("epoch", [0, 20, 39])
def test_nees_is_chi_square(consistent: dict[str, list[Array]], kind: str, epoch: int) -> None:
    """Runs are independent, epochs of one run are not: one epoch of each run is judged."""
    total = sum(rows[epoch, -1] for rows in consistent[kind])
    n = RUNS * (consistent[kind][0].shape[1] - 1)
    assert chdtri(n, 0.995) < total < chdtri(n, 0.005)


def test_iterating_the_update_pays() -> None:
    """From no knowledge of rate and inertia: the plain filter linearises its first, large,
    updates once, and stays sure of what is wrong."""
    scenario = load_scenario(ZHANG, ("time.epochs=40",))
    found = _run(scenario, ("ekf", "iekf", "batch"), 6)
    rows = scenario.layout.tangent("relative_position")
    rmse = {k: np.sqrt(np.mean([np.sum(e[:, rows] ** 2) for e in v])) for k, v in found.items()}
    nees = {k: np.median([e[-1, -1] for e in v]) for k, v in found.items()}
    assert rmse["iekf"] < 0.8 * rmse["ekf"]
    assert rmse["batch"] < rmse["iekf"]
    n = scenario.layout.dim
    assert max(nees["iekf"], nees["batch"]) < 2 * n < nees["ekf"]
