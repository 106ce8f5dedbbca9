"""Noise that comes with the data, in place of the sensor's."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from passes import FIX, PRIOR, PROCESSES, RANGER, SENSORS, toy_measurements, toy_problem

from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.packing import pack, unpack
from relnav_graph.core.problem import Problem
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.online.driver import online
from relnav_graph.streaming.lines import LineError, parse_line
from relnav_graph.streaming.writing import measurement_object

#: Of a fix whose axes are correlated, larger with time.
WORSE = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, -0.02], [0.0, -0.02, 0.05]])


def with_noise(R: Callable[[Measurement], np.ndarray | None]) -> list[Measurement]:
    return [replace(m, covariance=R(m)) for m in toy_measurements()]


@pytest.mark.parametrize("kind", ["ekf", "ukf", "batch", "incremental", "isam2", "fixed_lag"])
def test_it_counts_as_that_of_a_sensor_that_says_so(kind: str) -> None:
    """Half of the fixes bear another covariance: as if a second sensor had made them."""
    late = {m.t for m in toy_measurements() if m.t >= 15}

    def own(m: Measurement) -> np.ndarray | None:
        return WORSE[None] if m.sensor == "fix" and m.t in late else None

    other = replace(FIX, covariance=WORSE)
    apart = [
        replace(m, sensor="other") if m.sensor == "fix" and m.t in late else m
        for m in toy_measurements()
    ]
    found = run_estimator(kind, toy_problem(with_noise(own)))
    expected = run_estimator(
        kind,
        Problem(
            PROCESSES,
            {**SENSORS, "other": other},
            PRIOR,
            make_epochs(PROCESSES, apart, {}, np.arange(30.0)),
        ),
    )
    plain = run_estimator(kind, toy_problem(toy_measurements()))
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.P, expected.P, rtol=1e-9, atol=1e-15)
    assert np.abs(found.x - plain.x).max() > 1e-3


def test_online_state_and_lines_keep_it() -> None:
    problem = toy_problem(with_noise(lambda m: WORSE[None] if m.sensor == "fix" else None))
    again = unpack(pack(problem.epochs))
    for one, other in zip(problem.epochs, again, strict=True):
        for m, n in zip(one.measurements, other.measurements, strict=True):
            assert (m.covariance is None) == (n.covariance is None)
            np.testing.assert_array_equal(m.covariance, n.covariance)
    line = json.dumps(measurement_object(problem.epochs[0].measurements[0])).encode()
    _, found = parse_line(line, SENSORS, {})
    assert isinstance(found, Measurement)
    np.testing.assert_array_equal(found.covariance, WORSE[None])


def test_of_several_observations_each_has_its_own() -> None:
    m = next(m for m in toy_measurements() if m.sensor == "ranger")
    R = np.arange(1.0, 4.0)[:, None, None]
    kept = replace(m, covariance=R).only(np.array([True, False, True]))
    assert kept.covariance is not None
    assert kept.covariance[:, 0, 0].tolist() == [1.0, 3.0]
    assert kept.ids.tolist() == m.ids[[0, 2]].tolist()


@pytest.mark.parametrize(
    ("R", "words"),
    [
        (np.eye(2)[None], r"the covariance of the residual is \(1, 2, 2\), expected \(1, 3, 3\)"),
        (np.array([[[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]]), "not symmetric"),
        (-np.eye(3)[None], "not positive definite"),
    ],
)
def test_row_42_a_covariance_that_is_none_is_refused(R: np.ndarray, words: str) -> None:
    first = replace(toy_measurements()[0], covariance=R)
    with pytest.raises(InputError, match=words):
        run_estimator("ekf", toy_problem([first, *toy_measurements()[1:]]))
    with pytest.raises(InputError, match=words):
        online("ekf", toy_problem([])).admit("fix", 0.0, first.z, first.ids, R=R)
    line = json.dumps(measurement_object(first)).encode()
    with pytest.raises(LineError, match=words):
        parse_line(line, SENSORS, {})


def test_what_is_not_finite_or_of_another_count_is_refused() -> None:
    m = toy_measurements()[0]
    for R in (np.full((1, 3, 3), np.nan), np.eye(3), np.tile(np.eye(3), (2, 1, 1))):
        with pytest.raises(InputError, match=r"expected finite \(1, rows, rows\)"):
            replace(m, covariance=R)
    assert len(RANGER.observables()) == 3
