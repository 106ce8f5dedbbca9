"""Bad values: refused by name, counted, and nothing changed by them."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from online_passes import KINDS, assert_same, driven, fresh, in_sigmas, snapshot, toy, zhang
from passes import ONE_ID, PRIOR, RANGER, toy_measurements, toy_problem
from relnav_factors.sensors.beacon_los import BeaconLineOfSight
from toy_model import PositionFix

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import CHASER_ATTITUDE
from relnav_graph.core.problem import Prior
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.io.tabular import component_columns, from_components, to_components


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_row_01_not_finite_is_refused_and_counted(kind: str, value: float) -> None:
    problem = toy()
    one = driven(kind, problem, problem.epochs[:10])
    before = snapshot(one)
    with pytest.raises(InputError, match=r"sensor 'fix' at t = 10.0 s: .*not finite"):
        one.admit("fix", 10.0, np.array([[1.0, value, 2.0]]), ONE_ID)
    assert one.counts["fix"] == {"invalid": 1}
    assert_same(snapshot(one), before)
    good = one.admit("fix", 10.0, problem.epochs[10].measurements[0].z, ONE_ID)
    assert one.step(problem.epochs[10]).t == good.t == 10.0


@pytest.mark.parametrize("sigma", [np.nan, np.inf, 0.0, -1e-3])
def test_row_02_a_sigma_that_is_none(sigma: float) -> None:
    with pytest.raises(InputError, match=rf"sigma: found {sigma} rad"):
        BeaconLineOfSight(points=np.eye(3), sigma=sigma)


BAD_COVARIANCES: dict[str, Any] = {
    "not positive definite": np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]]),
    "not symmetric": np.array([[1.0, 0.1, 0], [0, 1, 0], [0, 0, 1]]),
    "singular": np.ones((3, 3)),
    "nan": np.diag([1.0, np.nan, 1.0]),
    "inf": np.diag([1.0, np.inf, 1.0]),
    "zero": np.zeros((3, 3)),
    "negative": -np.eye(3),
}


def _filter_with(covariance: Array) -> Track:
    sensors = {"fix": PositionFix(covariance=covariance), "ranger": RANGER}
    return run_estimator("ekf", toy_problem(toy_measurements(), sensors=sensors))


@pytest.mark.parametrize("name", BAD_COVARIANCES)
def test_row_02_a_covariance_that_is_none(name: str) -> None:
    P = np.diag(np.full(7, 0.1))
    P[:3, :3] = BAD_COVARIANCES[name]
    with pytest.raises(InputError, match="covariance of the prior"):
        Prior(PRIOR.x, P)
    with pytest.raises(InputError, match=r"'fix'.*covariance|covariance: found (nan|inf)"):
        _filter_with(BAD_COVARIANCES[name])


def test_row_03_a_sigma_below_the_floor_is_raised_and_said(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """1e-17 m on a value of 10 m is below its last bit, 2e-15 m."""
    tiny = {"fix": PositionFix(covariance=1e-34 * np.eye(3)), "ranger": RANGER}
    with caplog.at_level(logging.WARNING, "relnav_graph"):
        found = run_estimator("batch", toy_problem(toy_measurements(), sensors=tiny))
    assert "sensor 'fix': sigma 1e-17 is lost in the rounding of values" in caplog.text
    sigma = np.sqrt(found.P[:, 0, 0])
    assert (sigma > 1e-17).all()
    assert np.isfinite(found.x).all()
    caplog.clear()
    run_estimator("batch", toy())
    assert caplog.text == ""


BAD_VALUES: dict[str, tuple[Any, Any]] = {
    "too short": (np.zeros((1, 2)), ONE_ID),
    "too long": (np.zeros((1, 4)), ONE_ID),
    "flat": (np.zeros(3), ONE_ID),
    "more ids": (np.zeros((1, 3)), np.zeros(2, dtype=np.int64)),
    "text": (np.array([["a", "b", "c"]]), ONE_ID),
    "complex": (np.zeros((1, 3), dtype=complex), ONE_ID),
    "bool": (np.zeros((1, 3), dtype=bool), ONE_ID),
    "object": (np.array([[None, 1.0, 2.0]], dtype=object), ONE_ID),
    "masked": (np.ma.masked_array(np.zeros((1, 3)), mask=[[False, True, False]]), ONE_ID),
    "ids are no whole numbers": (np.zeros((1, 3)), np.array([0.5])),
    "nothing": (None, ONE_ID),
}


@pytest.mark.parametrize("name", BAD_VALUES)
def test_row_04_values_of_another_form(name: str) -> None:
    problem = toy()
    one = driven("fixed_lag", problem, problem.epochs[:3])
    before = snapshot(one)
    with pytest.raises(InputError, match=r"'fix' at t = 3\.0 s"):
        one.admit("fix", 3.0, *BAD_VALUES[name])
    assert one.counts["fix"] == {"invalid": 1}
    assert_same(snapshot(one), before)


def test_row_04_an_unknown_id() -> None:
    one = fresh("ekf", toy())
    with pytest.raises(InputError, match="id 7, expected 0 to 2"):
        one.admit("ranger", 0.0, np.ones((1, 1)), np.array([7]))


def test_row_05_a_matrix_that_is_no_rotation() -> None:
    good = np.eye(3)
    for bad in (-good, good + 1e-3, np.diag([1.0, 1.0, -1.0]), 2 * good):
        with pytest.raises(InputError, match="not a rotation"):
            CHASER_ATTITUDE.pack(bad)
    np.testing.assert_array_equal(CHASER_ATTITUDE.pack(good).reshape(3, 3), good)


def test_row_05_quaternions_q_and_minus_q() -> None:
    rng = np.random.default_rng(1)
    q = rng.normal(size=(20, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    assert component_columns(CHASER_ATTITUDE)[0] == "q_w"
    R = from_components(CHASER_ATTITUDE, q)
    np.testing.assert_array_equal(R, from_components(CHASER_ATTITUDE, -q))
    np.testing.assert_allclose(R, from_components(CHASER_ATTITUDE, q * (1 + 1e-7)), atol=1e-15)
    again = from_components(CHASER_ATTITUDE, to_components(CHASER_ATTITUDE, R))
    np.testing.assert_allclose(again, R, atol=1e-15)


@pytest.mark.parametrize("kind", KINDS)
def test_row_05_lines_of_sight_are_normalised_within_tolerance(kind: str) -> None:
    problem, _ = zhang(6)
    one, other = (driven(kind, problem, problem.epochs[:5]) for _ in range(2))
    m = problem.epochs[5].measurements[0]
    scaled = one.admit(m.sensor, m.t, m.z * (1 + 1e-5), m.ids)
    with pytest.raises(InputError, match="expected a unit vector"):
        one.admit(m.sensor, m.t, 1.01 * m.z, m.ids)
    a = one.step(replace(problem.epochs[5], measurements=(scaled,)))
    assert in_sigmas(problem.layout, a, other.step(problem.epochs[5])) < 1e-6
