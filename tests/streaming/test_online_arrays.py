"""`Online`: arrays in, from any thread, in any order; the same estimate as of a stream."""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from online_passes import driven, zhang
from passes import sigmas
from relnav_factors.sensors.pose_measurement import PoseMeasurement

import relnav_graph as rg
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError, ModelError
from relnav_graph.scoring.deviations import estimates

#: No thread is to wait for another for so long that a gap is bridged.
PATIENT: dict[str, Any] = {"patience": 1e4}
COUNT = 12


def pushes(recording: Recording, shift: Callable[[float], Any] = float) -> dict[str, list[Any]]:
    """What there is to push, by sensor and input, in order of time."""
    found: dict[str, list[Any]] = {}
    for m in recording.measurements:
        found.setdefault(m.sensor, []).append(("push", m.sensor, shift(m.t), m.z, m.ids))
    for name, s in recording.inputs.items():
        rows = zip(s.t_start, s.t_end, s.values, strict=True)
        found[name] = [("push_input", name, shift(a), shift(b), v) for a, b, v in rows]
    return found


def fed(online: rg.Online, items: list[Any]) -> None:
    for method, *arguments in items:
        getattr(online, method)(*arguments)


def assert_same(online: rg.Online, kind: str) -> None:
    """As the estimator that is driven epoch by epoch."""
    problem, _ = zhang(COUNT)
    reference = driven(kind, problem)
    found = online.estimate()
    assert found is not None
    assert found.t == problem.times[-1]
    apart = found.layout.local(reference.x, found.x) / sigmas(reference.P[None])[0]
    assert np.abs(apart).max() < 1e-6
    np.testing.assert_allclose(found.P, reference.P, rtol=1e-6, atol=1e-6 * reference.P.max())
    assert online.used == {name: n["used"] for name, n in reference.totals.items()}
    assert not online.rejected


@pytest.mark.parametrize("kind", ["ekf", "fixed_lag"])
def test_several_threads_give_the_estimate_of_one(kind: str) -> None:
    """Each feeds an input, or a third of what a sensor saw, while another asks for estimates."""
    problem, recording = zhang(COUNT)
    for parallel in (False, True):
        online = rg.Online(problem, kind, t=0.0, **PATIENT)
        items, done = pushes(recording), threading.Event()
        shares = [items["gyro"], *(items["beacons"][k::3] for k in range(3))]
        if not parallel:
            for own in shares:
                fed(online, own)
            assert_same(online, kind)
            continue
        errors: list[BaseException] = []

        def run(work: Callable[[], None], errors: list[BaseException] = errors) -> None:
            try:
                work()
            except BaseException as error:
                errors.append(error)

        def ask(online: rg.Online = online, done: threading.Event = done) -> None:
            while not done.wait(0.001):
                online.estimate()

        feeders = [
            threading.Thread(target=run, args=(lambda own=own, online=online: fed(online, own),))
            for own in shares
        ]
        asker = threading.Thread(target=run, args=(ask,))
        for thread in (*feeders, asker):
            thread.start()
        for thread in feeders:
            thread.join()
        done.set()
        asker.join()
        assert not errors
        assert_same(online, kind)


def test_stamps_of_a_clock_that_counts_nanoseconds() -> None:
    """Of the year 2023: the origin is subtracted in whole numbers."""
    problem, recording = zhang(COUNT)
    start = 1_700_000_000_000_000_001
    online = rg.Online(problem, "ekf", t=start, **PATIENT)
    for own in pushes(recording, lambda t: start + round(t * 1e9)).values():
        fed(online, own)
    assert_same(online, "ekf")


def test_what_is_derived_and_what_is_predicted() -> None:
    problem, recording = zhang(COUNT)
    online = rg.Online(problem, "ekf", t=0.0, **PATIENT)
    assert online.estimate() is None or online.estimate().t == 0.0  # type: ignore[union-attr]
    for own in pushes(recording).values():
        fed(online, own)
    found = online.estimate()
    assert found is not None
    track = rg.run_estimator("ekf", problem)
    states = estimates(track, derived_quantities(track.layout))
    for name in ("position_in_target", "relative_attitude"):
        np.testing.assert_allclose(found.value(name), states[name].value[-1], atol=1e-8)
        expected = np.sqrt(np.diag(states[name].P[-1]))
        np.testing.assert_allclose(found.sigma(name), expected, rtol=1e-6)
    with pytest.raises(InputError, match="found 'position', expected one of: relative_position"):
        found.value("position")
    assert repr(found).startswith("Estimate at 110 s, OK")
    later = online.predict(115.0)
    assert later.t == 115.0
    assert (later.sigma("relative_position") > found.sigma("relative_position")).all()
    again = online.estimate()
    assert again is not None
    assert again.t == found.t


def test_late_and_twice_are_told_and_counted() -> None:
    problem, recording = zhang(COUNT)
    online, items = rg.Online(problem, "ekf", t=0.0, **PATIENT), pushes(recording)
    fed(online, items["gyro"])
    beacons = items["beacons"]
    made = [e for item in beacons[:3] for e in online.push(*item[1:])]
    assert [e.t for e in made] == [0.0, 10.0, 20.0]
    used = online.used
    online.push(*beacons[1][1:])
    assert online.used == used
    assert online.rejected["beacons"] == {"duplicate": 6}
    found = online.push("beacons", -50.0, *beacons[1][3:])
    assert online.rejected["beacons"] == {"duplicate": 6, "late": 6}
    assert [note["reason"][:4] for e in found for note in e.rejected] == ["late"] * 6


POSE: dict[str, Any] = {
    "processes": {
        "turn": {"kind": "white_noise_acceleration", "pose": "target", "acceleration_density": 0.01}
    },
    "sensors": {"fix": {"kind": "position_fix", "pose": "target", "sigma": 0.1}},
    "prior": {
        "relative_position": ([5.0, 0, 0], 10.0),
        "relative_velocity": ([0.0, 0, 0], 1.0),
    },
}


def test_a_problem_of_arrays_without_measurements_is_driven() -> None:
    """As the same problem with all of them."""
    rng, t = np.random.default_rng(0), np.arange(8.0)
    z = np.array([5.0, 0, 0]) + np.outer(t, [0, 0.1, 0]) + 0.1 * rng.normal(size=(8, 3))
    whole = rg.Problem.from_arrays(**POSE, measurements={"fix": (t, z)})
    online = rg.Online(rg.Problem.from_arrays(**POSE), "ekf")
    for a, b in zip(t, z, strict=True):
        online.push("fix", a, b)
    found, track = online.estimate(), rg.run_estimator("ekf", whole)
    assert found is not None
    np.testing.assert_allclose(found.x, track.x[-1], rtol=1e-9)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda o: o.push("camera", 0.0, np.zeros(3)), "unknown sensor 'camera', .*: fix"),
        (
            lambda o: o.push("fix", 0.0, np.zeros(2)),
            r"'fix': found z of \(2,\), expected columns x_",
        ),
        (lambda o: o.push("fix", 0.0, np.zeros((2, 3))), "found no ids for 2 rows"),
        (lambda o: o.push("fix", 0.0, np.zeros(3), 7), "found id 7, expected 0"),
        (lambda o: o.push("fix", np.nan, np.zeros(3)), "t: found nan, expected a finite time"),
        (lambda o: o.push("fix", 0.0, [np.nan, 0, 0]), "not finite"),
        (lambda o: o.push_input("gyro", 0, 1, np.zeros(3)), "unknown input 'gyro', .*: none"),
        (lambda o: o.predict(3.0), "no estimate yet"),
    ],
)
def test_what_cannot_be_is_refused_at_once(call: Callable[[Any], Any], says: str) -> None:
    online = rg.Online(rg.Problem.from_arrays(**POSE), "ekf")
    with pytest.raises(InputError, match=says):
        call(online)
    online.push("fix", 0.0, np.array([5.0, 0, 0]))
    with pytest.raises(InputError, match="t: found 1, expected seconds as floats, as before"):
        online.push("fix", 1, np.array([5.0, 0, 0]))
    found = online.estimate()
    assert found is not None
    assert found.status == "OK"


def test_inputs_come_one_by_one_or_many_at_once() -> None:
    problem, recording = zhang(COUNT)
    gyro = recording.inputs["gyro"]
    online = rg.Online(problem, "ekf", t=0.0, **PATIENT)
    online.push_input("gyro", gyro.t_start, gyro.t_end, gyro.values)
    for own in {k: v for k, v in pushes(recording).items() if k != "gyro"}.values():
        fed(online, own)
    assert_same(online, "ekf")
    with pytest.raises(InputError, match="'gyro': found <U1, expected real numbers"):
        online.push_input("gyro", 9, 10, ["a", "b", "c"])
    with pytest.raises(InputError, match=r"found values \(2, 3\) over \(1,\)"):
        online.push_input("gyro", 0.0, 1.0, np.zeros((2, 3)))
    with pytest.raises(InputError, match="expected times that run on"):
        online.push_input("gyro", 1.0, 1.0, np.zeros(3))
    with pytest.raises(ModelError, match="cannot be driven online"):
        rg.Online(problem, "rts")


def test_a_first_estimate_may_be_measured() -> None:
    sensor = PoseMeasurement(
        pose="target", position_sigma=np.full(3, 0.1), attitude_sigma=np.full(3, 0.01)
    )
    turn: dict[str, Any] = {"kind": "gyro_bias", "attitude": "relative_attitude"}
    turn |= {"angle_random_walk_density": 1e-3, "bias_random_walk_density": 1e-6}
    problem = rg.Problem.from_arrays(
        processes={**POSE["processes"], "attitude": turn},
        sensors={"pose": sensor},
        prior={
            **POSE["prior"],
            "relative_attitude": ([0, 0, 0], 1.0),
            "gyro_bias": ([0, 0, 0], 1e-3),
        },
    )
    online = rg.Online(problem, "ekf", measured=["relative_attitude", "relative_position"])
    for a, b in pairwise(np.arange(5.0)):
        online.push_input("gyro", a, b, np.zeros(3))
        online.push("pose", a, [40.0, 0, 0, 0, 1, 0, 0])
    found = online.estimate()
    assert found is not None
    np.testing.assert_allclose(found.value("relative_position"), [40, 0, 0], atol=0.1)
    np.testing.assert_allclose(found.value("relative_attitude"), np.diag([1, -1, -1.0]), atol=0.05)
