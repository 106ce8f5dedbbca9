"""The published filter of yang2016 beside one that models what drifts about constant biases."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from passes import EXPERIMENTS, toy_measurements, toy_problem

from relnav_graph.core.catalogue import DRIFTS
from relnav_graph.core.contracts import Drifts
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import ModelError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.published.ekf_without_drift import drifts_of
from relnav_graph.runs.closed_loop import Flown, fly
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

#: Which processes are drifts alone.
GONE = ("relative_drift", "absolute_drift", "earth_sensor_drift")


def scenario(epochs: int) -> Scenario:
    slow = [f'inputs.{name}.period="0.25 s"' for name in ("gyro", "accelerometer")]
    return load_scenario(EXPERIMENTS / "yang2016.toml", [f"time.epochs={epochs}", *slow])


@cache
def problem() -> Problem:
    one = scenario(120)
    return one.problem(one.simulate(0), 0)


@cache
def published() -> Track:
    return run_estimator("ekf_without_drift", problem())


def test_drifts_are_held_at_zero_and_believed_there() -> None:
    track = published()
    assert track.status == "ok"
    assert track.blocks == problem().layout.blocks
    for name in drifts_of(problem(), ""):
        assert not track.value(name).any()
        assert not track.covariance(name).any()
    assert track.statics is not None
    assert np.ptp(track.value("accelerometer_bias"), axis=0).max() > 0  # estimated


def test_it_is_the_filter_of_models_that_have_no_drift() -> None:
    """Built by hand from the same measurements and prior: the same numbers, of 28 states."""
    whole = problem()
    models = {n: p for n, p in whole.processes.items() if n not in GONE}
    plain = {n: p.without_drift() if isinstance(p, Drifts) else p for n, p in models.items()}
    sensors = dict(whole.sensors)
    earth = sensors["earth_sensor"]
    assert isinstance(earth, Drifts)
    sensors["earth_sensor"] = earth.without_drift()
    one = scenario(120)
    kept = [b for b in whole.layout if b.name not in DRIFTS]
    assert sum(b.dim for b in kept) == 28
    prior = one.prior(one.simulate(0).truth, 0.0, 0)
    stored, tangent = whole.layout.gather(kept)
    epochs = tuple(
        replace(e, inputs={n: u for n, u in e.inputs.items() if n not in GONE})
        for e in whole.epochs
    )
    built = Problem(
        plain, sensors, Prior(prior.x[stored], prior.P[np.ix_(tangent, tangent)]), epochs
    )
    assert {b.name for b in built.layout} == {b.name for b in kept}
    expected = run_estimator("ekf", built)
    for block in kept:
        np.testing.assert_allclose(
            published().value(block.name), expected.value(block.name), rtol=1e-9, atol=1e-15
        )
        np.testing.assert_allclose(
            published().covariance(block.name), expected.covariance(block.name), rtol=1e-9
        )


@cache
def flown(kind: str) -> Flown:
    return fly(scenario(90), kind, 0)


def test_it_flies_a_pass_of_its_own() -> None:
    """The source is told states with drifts; the pass flown has all epochs, at 1.5 s too."""
    one, proper = flown("ekf_without_drift"), flown("ekf")
    assert one.track.status == "ok"
    assert len(one.track.t) == len(proper.track.t) == 90 + 30
    again = run_estimator("ekf_without_drift", one.problem)
    np.testing.assert_allclose(one.track.x, again.x, rtol=1e-12, atol=1e-12)


def test_a_problem_without_drifts_is_refused_by_name() -> None:
    with pytest.raises(ModelError, match="ekf_without_drift: found no drift"):
        run_estimator("ekf_without_drift", toy_problem(toy_measurements()))
