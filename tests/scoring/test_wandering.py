"""The caution of a filter that gives up constants of which it was sure, without truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from passes import ZHANG

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import INERTIA, POINT, RELATIVE_POSITION
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Statics, Track
from relnav_graph.estimators import try_estimator
from relnav_graph.runs.passes import open_pass
from relnav_graph.scoring.agreement import distances, row_cautions
from relnav_graph.scoring.metrics import with_smoothed
from relnav_graph.scoring.wandering import WANDERING, wandering_cautions, wanderings

EPOCHS, POINTS = 200, 20


def filtered(seed: int, sure: float = 1.0) -> Track:
    """A filter that averages what it measures of each constant; sure: how many times too small its
    noise is declared."""
    rng = np.random.default_rng(seed)
    statics = Layout((), [INERTIA, *(POINT.numbered(i) for i in range(POINTS))])
    z = 0.1 * rng.standard_normal((EPOCHS, statics.dim))
    n = np.arange(1, EPOCHS + 1)[:, None]
    x = np.cumsum(z, axis=0) / n
    P: Array = np.eye(statics.dim) * (0.1 / sure) ** 2 / n[:, :, None]
    moving, t = Layout([RELATIVE_POSITION]), np.arange(float(EPOCHS))
    cross = np.zeros((EPOCHS, 3, statics.dim))
    own = np.tile(np.eye(3), (EPOCHS, 1, 1))
    return Track(
        "ekf", "filtered", moving, t, np.zeros((EPOCHS, 3)), own,
        statics=Statics(statics, x, P, cross),
    )  # fmt: skip


def test_what_a_consistent_filter_learns_is_what_it_allowed() -> None:
    means = [np.mean(list(wanderings(filtered(seed)).values())) for seed in range(40)]
    assert np.mean(means) == pytest.approx(1, abs=0.05)
    assert not any(wandering_cautions(filtered(seed)) for seed in range(40))


def test_a_filter_that_is_too_sure_of_its_constants_is_told() -> None:
    (found,) = wandering_cautions(filtered(0, 5.0))
    assert found.name == WANDERING
    assert f"of {POINTS + 1} constants" in found.text
    smoothed = replace(filtered(0, 5.0), kind="smoothed")
    assert not wandering_cautions(smoothed)
    assert not wandering_cautions(replace(filtered(0, 5.0), statics=None))


@pytest.mark.parametrize("name", ["inspection", "zhang2015_static"])
def test_beside_a_map_the_filter_is_told_and_the_graph_is_not(name: str) -> None:
    path, epochs = ZHANG.with_name(f"{name}.toml"), 150
    problem = open_pass(path, 0, assignments=[f"time.epochs={epochs}"]).problem
    rows = with_smoothed([try_estimator(kind, problem) for kind in ("iekf", "incremental")])
    found = {n: [c.name for c in own] for n, own in row_cautions(rows, *distances(rows)).items()}
    assert (WANDERING in found["iekf"]) == (name == "inspection")
    assert WANDERING not in found["incremental"]
    assert WANDERING not in found["incremental_smoothed"]
