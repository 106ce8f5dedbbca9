"""Measurements that come late, twice, from far ahead, or together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from online_passes import (
    KINDS,
    WINDOW,
    assert_same,
    driven,
    in_sigmas,
    snapshot,
    toy,
    without,
    zhang,
)
from passes import ONE_ID, toy_problem

from relnav_graph.core.epochs import Epoch, make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError, LateError


def _ranger(epoch: Epoch) -> Measurement:
    return next(m for m in epoch.measurements if m.sensor == "ranger")


@pytest.mark.parametrize("kind", KINDS)
def test_row_08_late_measurement_inside_the_window(kind: str) -> None:
    problem = toy()
    in_order = driven(kind, problem)
    holes = [without(e, "ranger") if e.t in (20.0, 22.0) else e for e in problem.epochs]
    late = driven(kind, problem, holes)
    assert in_sigmas(problem.layout, late, in_order) > 1e-3
    late.insert([_ranger(problem.epochs[22])])
    found = late.insert([_ranger(problem.epochs[20])])
    np.testing.assert_allclose(found.x, in_order.x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.P, in_order.P, rtol=1e-9, atol=1e-15)
    assert late.totals == in_order.totals


@pytest.mark.parametrize("kind", KINDS)
def test_row_08_late_measurement_between_two_epochs(kind: str) -> None:
    """The interval is cut where it falls, its gyro's samples too."""
    _, recording = zhang(8)
    problem, _ = zhang(8)
    m = next(m for m in recording.measurements if m.t == 50.0)
    shifted = replace(m, t=46.0)
    rest = [other for other in recording.measurements if other is not m]
    times = np.array([0.0, 10, 20, 30, 40, 60, 70])
    models = problem.processes, recording.inputs
    holes = make_epochs(models[0], rest, models[1], times)
    with_it = make_epochs(models[0], [*rest, shifted], models[1], np.sort([*times, 46.0]))
    late, in_order = driven(kind, problem, holes), driven(kind, problem, with_it)
    late.insert([shifted])
    assert [e.t for e in late.epochs] == [e.t for e in in_order.epochs]
    assert in_sigmas(problem.layout, late, in_order) < 1e-9
    np.testing.assert_allclose(late.P, in_order.P, rtol=1e-9, atol=1e-25)


@pytest.mark.parametrize("kind", KINDS)
def test_row_09_late_measurement_beyond_the_window(kind: str) -> None:
    problem = toy()
    one = driven(kind, problem)
    before = snapshot(one)
    with pytest.raises(LateError, match=r"sensor 'ranger' at t = 16.0 s: has left the window"):
        one.insert([_ranger(problem.epochs[16])])
    assert one.counts["ranger"] == {"late": 3}
    assert_same(snapshot(one), before)
    with pytest.raises(LateError, match="before the newest"):
        one.step(problem.epochs[20])
    assert_same(snapshot(one), before)
    one.step(Epoch(30.0, (), problem.epochs[29].inputs))


@pytest.mark.parametrize("kind", KINDS)
def test_row_10_duplicates_are_counted_and_not_used_twice(kind: str) -> None:
    problem = toy()
    twice = [replace(e, measurements=(*e.measurements, *e.measurements)) for e in problem.epochs]
    one, clean = driven(kind, problem, twice), driven(kind, problem)
    assert one.counts == {"fix": {"duplicate": 30}, "ranger": {"duplicate": 90}}
    assert_same(snapshot(one), snapshot(clean))
    for t in (25, 29):  # in the window, and the newest
        found = one.insert(problem.epochs[t].measurements)
        assert {(r.sensor, r.reason) for r in found.refused} == {
            ("fix", "duplicate"),
            ("ranger", "duplicate"),
        }
    assert_same(snapshot(one), snapshot(clean))
    assert one.counts["ranger"]["duplicate"] == 96


@pytest.mark.parametrize("kind", KINDS)
def test_row_11_jump_forward(kind: str) -> None:
    """Nothing expires: what was known is propagated, and the status says how old it is."""
    problem = toy()
    one = driven(kind, problem, problem.epochs[:20])
    x, P = one.predict(5000.0)
    found = one.step(Epoch(5000.0, (), {k: np.array([[4981.0]]) for k in problem.processes}))
    assert in_sigmas(problem.layout, found, replace(found, x=x)) < 1e-6
    np.testing.assert_allclose(found.P, P, rtol=1e-6, atol=1e-15)
    assert found.P[0, 0] > 1e6 * driven(kind, problem, problem.epochs[:20]).P[0, 0]
    assert found.status == "LOST"
    z = found.x[:3] + np.array([30.0, -20.0, 10.0])
    back = one.step(
        Epoch(
            5001.0,
            (Measurement("fix", 5001.0, z[None], ONE_ID),),
            {k: np.array([[1.0]]) for k in problem.processes},
        )
    )
    np.testing.assert_allclose(back.x[:3], z, atol=0.01)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dt", [0.0, 1e-9, -1e-9])
def test_row_12_no_time_between(kind: str, dt: float) -> None:
    problem = toy()
    whole = driven(kind, problem, problem.epochs[:10])
    one = driven(kind, problem, problem.epochs[:9])
    one.step(without(problem.epochs[9], "ranger"))
    m = replace(_ranger(problem.epochs[9]), t=9.0 + dt)
    found = one.step(Epoch(9.0 + dt, (m,), {}))
    assert len(one.epochs) == len(whole.epochs)
    np.testing.assert_allclose(found.x, whole.x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.P, whole.P, rtol=1e-12, atol=1e-20)


def test_row_12_of_a_recorded_pass() -> None:
    problem = toy()
    measurements = [m for e in problem.epochs for m in e.measurements]
    jittered = [replace(m, t=m.t + (5e-7 if m.sensor == "fix" else 0.0)) for m in measurements]
    epochs = make_epochs(problem.processes, jittered, {})
    assert [len(e.measurements) for e in epochs] == 30 * [2]


@pytest.mark.parametrize("kind", KINDS)
def test_row_26_a_state_that_has_left_the_window(kind: str) -> None:
    """Of several late ones, one is too late: none is taken."""
    problem = toy()
    one = driven(kind, problem)
    assert one.epochs[0].t == 29.0 - WINDOW
    before = snapshot(one)
    inside = replace(_ranger(problem.epochs[20]), t=20.5)
    with pytest.raises(LateError, match=r"left the window, which begins at 17\.0 s"):
        one.insert([inside, _ranger(problem.epochs[3])])
    assert_same(snapshot(one), before)
    with pytest.raises(InputError, match="after the newest epoch"):
        one.insert([replace(inside, t=31.0)])
    assert_same(snapshot(one), before)
    assert toy_problem([]).window is None
