"""The filter that considers the drifts of biases: that is, `ekf` with them considered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from passes import EXPERIMENTS

from relnav_graph.core.catalogue import DRIFTS
from relnav_graph.errors import ModelError
from relnav_graph.estimators import run_estimator
from relnav_graph.runs.comparison import compare
from relnav_graph.runs.passes import open_pass
from relnav_graph.scenario.build import load_scenario

SHORT = ["time.epochs=60"]


def test_it_is_the_filter_with_drifts_considered() -> None:
    problem = open_pass(EXPERIMENTS / "yang2016.toml", 0, assignments=SHORT).problem
    own = [name for name in DRIFTS if name in problem.layout]
    assert len(own) == 4
    track = run_estimator("ekf_considering_drift", problem)
    asked = run_estimator("ekf", replace(problem, considered=tuple(own)))
    assert (track.x == asked.x).all()
    assert (track.P == asked.P).all()
    assert [c.name for c in track.cautions] == ["consider-covariance"]
    for name in own:  # not estimated, and not forgotten
        assert np.abs(track.value(name)).max() == 0.0
        assert (np.einsum("kii->ki", track.covariance(name)) > 0).all()


def test_it_flies_a_pass_of_its_own() -> None:
    scenario = load_scenario(EXPERIMENTS / "yang2016.toml", SHORT)
    found = compare(scenario, ["ekf_considering_drift"])
    track, truth = found.tracks[0], found.truths[0]
    assert track.status == "ok"
    assert truth is not None
    assert np.ptp(truth.values["relative_position"], axis=0).max() > 1.0


def test_without_drifts_there_is_nothing_to_consider() -> None:
    problem = open_pass(EXPERIMENTS / "hu2019.toml", 0, assignments=["time.epochs=3"]).problem
    with pytest.raises(ModelError, match="found no drift"):
        run_estimator("ekf_considering_drift", problem)
