"""Input that is wrong is refused, with where it stands, what was found and expected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from passes import PRIOR, PROCESSES, SENSORS, toy_problem
from relnav_factors.dynamics.gyro_bias import GyroBias

from relnav_graph.core.epochs import Epoch, make_epochs
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError, ModelError
from relnav_graph.estimators import run_estimator


def _m(z: Any = ((1.0, 2.0, 3.0),), ids: Any = (4,), t: float = 1.0, name: str = "fix") -> Any:
    return Measurement(name, t, np.asanyarray(z), np.asarray(ids))


def _series(start: Any, end: Any, values: Any = None) -> InputSeries:
    values = np.zeros((len(start), 3)) if values is None else np.array(values)
    return InputSeries("gyro", np.array(start, dtype=float), np.array(end, dtype=float), values)


def _epochs(*epochs: Epoch, **changes: Any) -> Problem:
    return replace(toy_problem([]), epochs=epochs, **changes)


def _prior(P: Any) -> Prior:
    return Prior(np.zeros(2), np.array(P, dtype=float))


def _with_inputs(**inputs: Any) -> Track:
    """The second epoch's inputs, by process."""
    epochs = Epoch(0.0), Epoch(1.0, (), {"motion": np.ones((1, 1)), **inputs})
    return run_estimator("ekf", replace(toy_problem([]), epochs=epochs))


GYRO = GyroBias(angle_random_walk_density=np.array(1e-3), bias_random_walk_density=np.array(1e-6))
ANY_GYRO: Any = GYRO
ONE = np.ones((1, 1))
WRONG_INPUT: list[tuple[str, Callable[[], Any], str]] = [
    ("nan", lambda: _m([[0, np.nan, 0]]), r"sensor 'fix' at t = 1\.0 s: z of id 4 is not finite"),
    ("inf", lambda: _m([[0, np.inf, 0]]), r"z of id 4 is not finite: \[ ?0\. inf"),
    ("flat", lambda: _m([1.0, 2.0, 3.0]), r"z is float64 \(3,\), expected real numbers \(k, nz\)"),
    ("complex", lambda: _m([[1j, 0, 0]]), r"z is complex128 .*, expected real numbers"),
    ("text", lambda: _m([["a", "b", "c"]]), r"z is <U1 .*, expected real numbers"),
    ("masked", lambda: _m(np.ma.masked_less([[1.0, -1, 0]], 0)), "expected real numbers"),
    ("ids", lambda: _m(ids=(1, 2)), r"fix.* 1 rows of z, but ids of shape \(2,\)"),
    ("ids not whole", lambda: _m(ids=(1.5,)), r"fix.* t = 1\.0 s: .*1\.5"),
    ("time", lambda: _m(t=np.nan), "sensor 'fix'.*the time is not finite"),
    (
        "input nan",
        lambda: _series([0], [1], [[np.nan, 0, 0]]),
        "input 'gyro': values holds.*not finite",
    ),
    ("input overlap", lambda: _series([0, 1], [1.5, 2]), r"input 'gyro'.* 1\.0 s"),
    ("input backwards", lambda: _series([0, 3], [1, 2]), r"input 'gyro'.* 3\.0 s"),
    (
        "input lengths",
        lambda: _series([0, 1], [1]),
        "input 'gyro': t_start, t_end and values differ",
    ),
    ("input gap", lambda: _series([0, 2], [1, 3]).over(0.0, 3.0), r"'gyro' has a gap after 1\.0 s"),
    (
        "input short",
        lambda: _series([0], [2]).over(1.0, 3.0),
        r"'gyro' does not cover 1\.0 s to 3\.0",
    ),
    (
        "prior nan",
        lambda: _prior([[np.nan, 0], [0, 1]]),
        r"the prior: found \(2, 2\), expected finite",
    ),
    ("prior flat", lambda: _prior([1, 2]), r"the prior: found \(2,\), expected finite and square"),
    (
        "prior zero",
        lambda: _prior([[0, 0], [0, 1]]),
        r"the prior: found variance 0\.0, expected > 0",
    ),
    ("prior lopsided", lambda: _prior([[1, 0.5], [0, 1]]), "the prior is not symmetric"),
    ("prior singular", lambda: _prior([[1, 2], [2, 1]]), "prior is not positive definite: .* -1"),
    (
        "prior mean",
        lambda: toy_problem([], prior=Prior(np.full(7, np.nan), PRIOR.P)),
        "prior.*finite",
    ),
    (
        "prior size",
        lambda: toy_problem([], prior=_prior(np.eye(2))),
        r"found x \(2,\) and P \(2, 2\), exp",
    ),
    ("no epoch", lambda: run_estimator("ekf", _epochs()), "epochs: .*expected one or more"),
    ("epochs back", lambda: _epochs(Epoch(1.0), Epoch(0.5)), r"epoch 1: found t = 0\.5 s.*increas"),
    ("epoch twice", lambda: _epochs(Epoch(1.0), Epoch(1.0)), r"epoch 1: found t = 1\.0 s.*increas"),
    ("epoch nan", lambda: _epochs(Epoch(np.nan)), "epoch 0: found t = nan"),
    (
        "sensor",
        lambda: _epochs(Epoch(1.0, (_m(name="radar"),))),
        r"t = 1\.0 s: unknown sensor 'radar'",
    ),
    ("other time", lambda: _epochs(Epoch(0.0, (_m(t=5.0),))), r"fix.* 5\.0 s"),
    (
        "between",
        lambda: make_epochs({}, [_m()], {}, np.array([0.0, 2.0])),
        r"'fix': .* 1\.0 s lies bet",
    ),
    (
        "width",
        lambda: run_estimator("ekf", toy_problem([_m([[1.0, 2.0]])])),
        r"'fix'.*found .*\(1, 2\), expected .*x_m",
    ),
    (
        "id",
        lambda: run_estimator("ekf", toy_problem([_m([[1.0]], (9,), name="ranger")])),
        "found id 9, exp",
    ),
    (
        "no input",
        lambda: make_epochs({"a": ANY_GYRO}, [], {}, np.arange(2.0)),
        "needs the input 'gyro'",
    ),
    ("epoch without", _with_inputs, r"electronics"),
    ("epoch shape", lambda: _with_inputs(electronics=np.ones(1)), r"drift.*found u of \(1,\), exp"),
    ("epoch length", lambda: _with_inputs(electronics=3 * ONE), "electronics"),
    ("epoch nan input", lambda: _with_inputs(electronics=np.nan * ONE), r"drift.*found u.*nan"),
]


@pytest.mark.parametrize(("make", "says"), [pytest.param(f, s, id=n) for n, f, s in WRONG_INPUT])
def test_wrong_input_is_refused_with_where_and_what(make: Callable[[], Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        make()


def test_input_of_too_few_channels_is_refused() -> None:
    """Two numbers where a gyro has three: not whatever stands in memory behind them."""
    processes: dict[str, Any] = {"attitude": GYRO}
    series = InputSeries("gyro", np.array([0.0]), np.array([1.0]), np.zeros((1, 2)))
    x = np.concatenate([np.eye(3).ravel(), np.zeros(3)])

    def run() -> None:
        epochs = make_epochs(processes, [], {"gyro": series}, np.arange(2.0))
        run_estimator("ekf", Problem(processes, {}, Prior(x, np.eye(6)), epochs))

    with pytest.raises((InputError, ModelError), match="gyro"):
        run()


@pytest.mark.parametrize(
    ("processes", "says"),
    [
        (
            {**PROCESSES, "again": PROCESSES["motion"]},
            "'relative_position' is advanced by both 'mot",
        ),
        ({}, "no process advances any block"),
    ],
)
def test_state_that_does_not_hang_together_is_refused(processes: dict[str, Any], says: str) -> None:
    with pytest.raises(ModelError, match=says):
        Problem(processes, SENSORS, PRIOR, (Epoch(0.0),))


def test_a_block_that_no_process_advances_is_static_and_needs_a_prior() -> None:
    with pytest.raises(InputError, match=r"prior.*static: range_drift\) \(a static block is read"):
        Problem(
            {"motion": PROCESSES["motion"]},
            SENSORS,
            replace(PRIOR, x=PRIOR.x[:6], P=PRIOR.P[:6, :6]),
            (Epoch(0.0),),
        )


def test_unknown_estimator_names_the_known() -> None:
    with pytest.raises(ModelError, match=r"found kind 'kalman', expected one of: batch, ekf"):
        run_estimator("kalman", toy_problem([]))
