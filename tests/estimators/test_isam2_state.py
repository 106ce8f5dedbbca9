"""The state of iSAM2 is a value, though the tree is none: failures, late data, what is saved."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest
from extras import MINE, at_zero, closure, extra_of, isotropic
from online_passes import assert_same, driven, fresh, snapshot, toy

from relnav_graph.arrays import Array
from relnav_graph.errors import EstimationError, GeometryError, InputError
from relnav_graph.estimators.isam2 import Keys


@pytest.mark.parametrize("place", ["Tree.update", "Tree.newest", "Tree.distance"])
@pytest.mark.parametrize("error", [GeometryError, KeyboardInterrupt, EstimationError])
def test_a_step_that_fails_changes_nothing(
    place: str, error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, reference = toy(), driven("isam2", toy())
    one = driven("isam2", problem, problem.epochs[:20])
    before = snapshot(one)

    def fail(*arguments: Any) -> Any:
        raise error("struck")

    due = one._state.engine.due - 1  # a relinearisation, for the distance
    for k in range(20, due if place == "Tree.distance" else 20):
        one.step(problem.epochs[k])
        before = snapshot(one)
    at = len(before["epochs.times"])
    with monkeypatch.context() as patch:
        patch.setattr(f"relnav_graph.linear.gtsam_tree.{place}", fail)
        with pytest.raises(error, match="struck"):
            one.step(problem.epochs[at])
    assert_same(snapshot(one), before)
    for epoch in problem.epochs[at:]:
        one.step(epoch)
    assert_same(snapshot(one), snapshot(reference))


def test_a_late_measurement_is_as_if_it_had_come_in_order() -> None:
    problem = toy()
    one = fresh("isam2", problem)
    late = problem.epochs[14].measurements[1]
    for k, epoch in enumerate(problem.epochs):
        kept = tuple(m for m in epoch.measurements if m is not late)
        one.step(replace(epoch, measurements=kept))
        if k == 18:
            one.insert([late])
    assert_same(snapshot(one), snapshot(driven("isam2", problem)))


def test_a_new_epoch_before_one_that_is_named_is_refused() -> None:
    problem = toy()
    one = driven("isam2", problem, problem.epochs[:20])
    late = replace(problem.epochs[15].measurements[0], t=15.5)
    one.add(extra_of([closure(Keys(problem.layout), 2, 18, np.array([0.8, -0.8, 0.0]))]))
    before = snapshot(one)
    with pytest.raises(InputError, match=r"late measurement at 15\.5 s: it makes a new epoch"):
        one.insert([late])
    assert_same(snapshot(one), before)
    one.insert([replace(late, t=18.5)])  # after all that are named


@pytest.mark.parametrize("count", [7, 20, 29])
def test_what_is_saved_goes_on_the_same(count: int) -> None:
    problem = toy()
    keys = Keys(problem.layout)
    extras = [
        extra_of([closure(keys, 2, 5, np.array([0.2, -0.2, 0.0]))]),
        extra_of([gtsam.PriorFactorVector(MINE, *at_zero(3))], {MINE: np.ones(3)}),
    ]
    one, other = fresh("isam2", problem), fresh("isam2", problem)
    one.add(extras[0])
    for k, epoch in enumerate(problem.epochs[:count]):
        one.step(epoch)
        if k == 3:
            one.add(extras[1])
    other.restore(one.state())
    for epoch in problem.epochs[count:]:
        one.step(epoch)
        other.step(epoch)
    assert_same(snapshot(one), snapshot(other))
    np.testing.assert_array_equal(one.variables[MINE][1], other.variables[MINE][1])


def test_a_factor_that_cannot_be_saved_is_named() -> None:
    one = driven("isam2", toy(), toy().epochs[:3])
    key = Keys(toy().layout)["relative_position", 1]

    def error(factor: Any, values: Any, jacobians: Any) -> Array:
        if jacobians is not None:
            jacobians[0] = np.eye(3)
        found: Array = values.atVector(key)
        return found

    one.add(extra_of([gtsam.CustomFactor(isotropic(3, 1.0), [key], error)]))
    with pytest.raises(InputError, match="extra: cannot be saved: unregistered class"):
        one.state()
