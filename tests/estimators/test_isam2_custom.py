"""Factors of a user's that are made of Python: what GTSAM would take for numbers is refused."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from extras import MINE, extra_of, isotropic
from online_passes import assert_same, driven, snapshot, toy

from relnav_graph.arrays import Array
from relnav_graph.errors import EstimationError, GeometryError, InputError, ModelError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.isam2 import Extra, Keys

Error = Callable[[Any, Any, Any], Any]


def position(epoch: int) -> int:
    return int(Keys(toy().layout)["relative_position", epoch])


def custom(error: Error, epoch: int = 3, noise: Any = None) -> Extra:
    noise = isotropic(3, 0.1) if noise is None else noise
    return extra_of([gtsam.CustomFactor(noise, [position(epoch)], error)])


def good(this: Any, values: Any, jacobians: Any) -> Array:
    if jacobians is not None:
        jacobians[0] = np.eye(3)
    found: Array = values.atVector(this.keys()[0]) - np.array([9.0, -6.0, 4.0])
    return found


def _filled(H: Any, r: Any = None) -> Error:
    def error(this: Any, values: Any, jacobians: Any) -> Any:
        if jacobians is not None and H is not None:
            jacobians[0] = H
        return np.zeros(3) if r is None else r

    return error


def _raises(this: Any, values: Any, jacobians: Any) -> Array:
    raise KeyError("nowhere")


def _nothing(this: Any, values: Any, jacobians: Any) -> None:
    return None


BAD: dict[str, tuple[Error, str]] = {
    "unfilled": (_filled(None), r"found jacobians\[0\] of \(0, 0\), expected \(3, 3\)"),
    "rows": (_filled(np.eye(2, 3)), r"found jacobians\[0\] of \(2, 3\), expected \(3, 3\)"),
    "columns": (_filled(np.eye(3, 5)), r"found jacobians\[0\] of \(3, 5\), expected \(3, 3\)"),
    "nan jacobian": (
        _filled(np.full((3, 3), np.nan)),
        r"found nan in jacobians\[0\], expected finite",
    ),
    "nan": (_filled(np.eye(3), np.full(3, np.nan)), "found nan in residuals, expected finite"),
    "length": (_filled(np.eye(3), np.zeros(2)), r"found residuals of \(2,\), expected \(3,\)"),
    "raises": (_raises, "it raised KeyError: 'nowhere'"),
    "nothing": (_nothing, "it raised"),
}


@pytest.mark.parametrize("name", BAD)
def test_row_25_a_factor_of_python_that_breaks_its_contract(name: str) -> None:
    error, says = BAD[name]
    problem, says = toy(), r"extra: factor 0 \(CustomFactor\): " + says
    one, reference = driven("isam2", problem, problem.epochs[:12]), driven("isam2", problem)
    before = snapshot(one)
    with pytest.raises(InputError, match=says):
        one.add(custom(error))
    assert_same(snapshot(one), before)
    for epoch in problem.epochs[12:]:
        one.step(epoch)
    assert_same(snapshot(one), snapshot(reference))
    with pytest.raises(InputError, match=says):
        run_estimator("isam2", problem, custom(error))


def test_a_good_one_counts_like_the_native_one() -> None:
    problem = toy()
    prior = gtsam.PriorFactorVector(position(3), np.array([9.0, -6.0, 4.0]), isotropic(3, 0.1))
    native = run_estimator("isam2", problem, extra_of([prior]))
    found = run_estimator("isam2", problem, custom(good))
    np.testing.assert_allclose(found.x, native.x, rtol=1e-12)
    np.testing.assert_allclose(found.P, native.P, rtol=1e-9, atol=1e-15)


def _later(what: Any, count: int = 3) -> Error:
    """Good, until it has been evaluated so many times."""
    calls = [0]

    def error(this: Any, values: Any, jacobians: Any) -> Any:
        calls[0] += 1
        return good(this, values, jacobians) if calls[0] <= count else what(this, values, jacobians)

    return error


@pytest.mark.parametrize(
    ("what", "kind", "says"),
    [
        (_filled(None), ModelError, r"found jacobians\[0\] of \(0, 0\)"),
        (_raises, ModelError, "it raised KeyError"),
        (_filled(np.eye(3), np.full(3, np.inf)), EstimationError, "found inf in residuals"),
    ],
)
def test_row_25_one_that_breaks_it_later(what: Error, kind: type[Exception], says: str) -> None:
    """Where the estimate has gone: named then, and the state stays."""
    problem = toy()
    one = driven("isam2", problem, problem.epochs[:6])
    one.add(custom(_later(what, 2)))
    t, x, P = one.t, one.x, one.P

    def go_on() -> None:
        nonlocal t, x, P
        for epoch in problem.epochs[6:]:
            t, x, P = one.t, one.x, one.P
            one.step(epoch)

    with pytest.raises(kind, match=says):
        go_on()
    assert one.t == t
    np.testing.assert_array_equal(one.x, x)
    np.testing.assert_array_equal(one.P, P)


def test_one_that_is_impossible_where_it_is_tried_is_taken() -> None:
    """As a point behind a camera is: it may be possible where it counts."""

    def error(this: Any, values: Any, jacobians: Any) -> Array:
        raise GeometryError("behind the camera")

    problem = toy()
    one = driven("isam2", problem, problem.epochs[:3])
    one.add(custom(error, 5))
    one.step(problem.epochs[3])
    one.step(problem.epochs[4])
    with pytest.raises(GeometryError, match="behind the camera"):
        one.step(problem.epochs[5])


def test_a_variable_without_numbers_is_refused() -> None:
    prior = gtsam.PriorFactorVector(MINE, np.zeros(0), gtsam.noiseModel.Unit.Create(0))
    with pytest.raises(InputError, match="extra: found no number in the value of L0"):
        run_estimator("isam2", toy(), extra_of([prior], {MINE: np.zeros(0)}))


def test_row_25_no_segmentation_fault() -> None:
    """In a process of its own: with a full noise model it would be garbage of the heap."""
    here = Path(__file__).parents[1]
    code = """
import gtsam, numpy as np
from extras import extra_of
from online_passes import toy
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.isam2 import Keys
full = gtsam.noiseModel.Gaussian.Covariance(np.eye(3) + 0.1)
key = Keys(toy().layout)["relative_position", 3]
for noise in (full, gtsam.noiseModel.Unit.Create(3)):
    factor = gtsam.CustomFactor(noise, [key], lambda this, values, jacobians: np.zeros(3))
    try:
        run_estimator("isam2", toy(), extra_of([factor]))
    except InputError as error:
        print(error)
"""
    paths = [str(here / "support"), str(here / "manual")]
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {paths}\n{code}"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("found jacobians[0] of (0, 0), expected (3, 3)") == 2
