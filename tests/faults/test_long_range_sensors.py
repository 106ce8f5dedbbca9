"""Faulted laser, pseudoranges and Earth sensor. Each test bears the row of the table of faults
that it shows: what was injected, and what must happen."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from online_passes import assert_same, driven, snapshot
from passes import EXPERIMENTS, differences, stored
from streams import changed, feed, lines_of, session_of

from relnav_graph.core.epochs import Epoch, make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

Change = Callable[[Measurement], Measurement | None]

#: A sensor, its period in epochs, and the block that it alone tells.
SENSORS = [
    ("laser", 1, "relative_position"),
    ("gps", 1, "chaser_position"),
    ("earth_sensor", 2, "earth_sensor_bias"),
]
each_sensor = pytest.mark.parametrize(("sensor", "period", "block"), SENSORS)
KINDS = ("ekf", "fixed_lag")


def _scenario(epochs: int) -> Scenario:
    slow = [f'inputs.{name}.period="0.25 s"' for name in ("gyro", "accelerometer")]
    settings = [f"time.epochs={epochs}", 'online.window="12 s"', *slow]
    settings.append('sensors.earth_sensor.period="2 s"')  # epochs a second apart
    return load_scenario(EXPERIMENTS / "yang2016.toml", settings)


@cache
def flown() -> tuple[Scenario, Recording]:
    """Fifty kilometres away, without thrust."""
    scenario = _scenario(240)
    return scenario, scenario.simulate(1)


def problem(sensor: str = "", change: Change = lambda m: m) -> Problem:
    """The pass, with the measurements of one sensor changed or, where None, taken away."""
    scenario, recording = flown()
    found = [change(m) if m.sensor == sensor else m for m in recording.measurements]
    kept = tuple(m for m in found if m is not None)
    return scenario.problem(replace(recording, measurements=kept), 1)


@cache
def whole() -> Problem:
    return problem()


@cache
def clean() -> Track:
    return run_estimator("ekf", whole())


def of(epoch: Epoch, sensor: str) -> Measurement:
    return next(m for m in epoch.measurements if m.sensor == sensor)


# --- 6 -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sensor", "columns", "factor", "says"),
    [
        ("laser", [0], 1e-3, "km given for m?"),
        ("laser", [1, 2], 180 / np.pi, "deg given for rad"),
        ("gps", [0], 1e-3, "km given for m?"),
        ("gps", [1, 2, 3], 1e-3, "km given for m?"),
        ("earth_sensor", [0, 1], 180 / np.pi, "deg given for rad"),
    ],
)
def test_row_06_another_unit(sensor: str, columns: list[int], factor: float, says: str) -> None:
    def scaled(m: Measurement) -> Measurement:
        z = m.z.copy()
        z[:, columns] *= factor
        return replace(m, z=z)

    with pytest.raises(InputError, match=sensor) as found:
        run_estimator("ekf", problem(sensor, scaled))
    assert says in str(found.value)


# --- 7 -----------------------------------------------------------------------------------


@each_sensor
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_row_07_no_time(sensor: str, period: int, block: str, bad: float) -> None:
    with pytest.raises(InputError, match=f"sensor '{sensor}' .*the time is not finite"):
        replace(of(whole().epochs[0], sensor), t=bad)


@each_sensor
def test_row_07_another_clock(sensor: str, period: int, block: str) -> None:
    """Offline it falls between the epochs; a stream says so at once, counts it, and goes on."""
    with pytest.raises(InputError, match=f"sensor '{sensor}': .* lies between epochs"):
        problem(sensor, lambda m: replace(m, t=m.t + 1.7e9))
    scenario = _scenario(6)
    lines = lines_of(scenario)
    at = [k for k, line in enumerate(lines) if json.loads(line).get("sensor") == sensor][1]
    foreign = [*lines[:at], changed(lines[at], t=1.7e9), *lines[at:]]
    session = session_of(scenario, lines[0])
    out = feed(session, foreign)
    rejected = [r for line in out for r in line["rejected"]]
    assert rejected
    assert all(r["sensor"] == sensor for r in rejected)
    assert all("taken to be of another clock" in r["reason"] for r in rejected)
    (said,) = [line for line in out if line["message"].startswith(f"{sensor}: clock")]
    assert said["status"] in ("DEGRADED", "LOST")
    out.remove(said)
    expected = feed(session_of(scenario, lines[0]), lines)
    assert [line["estimate"] for line in out] == [line["estimate"] for line in expected]


# --- 10, 11, 12 --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_row_10_duplicates(kind: str) -> None:
    epochs = whole().epochs[:20]
    twice = [replace(e, measurements=(*e.measurements, *e.measurements)) for e in epochs]
    one, once = driven(kind, whole(), twice), driven(kind, whole(), epochs)
    for sensor, period, _ in SENSORS:
        rows = sum(len(m.z) for e in epochs for m in e.measurements if m.sensor == sensor)
        assert rows >= 20 // period
        assert one.counts[sensor] == {"duplicate": rows}
    assert_same(snapshot(one), snapshot(once))


@pytest.mark.parametrize("kind", KINDS)
def test_row_11_jump_forward(kind: str) -> None:
    """Ten minutes without anything but the inputs: propagated, and said to be old."""
    epochs = whole().epochs
    one = driven(kind, whole(), epochs[:60])
    before = np.sqrt(np.diag(one.P))
    steady = {k: np.repeat(u, 600, axis=0) for k, u in epochs[60].inputs.items()}
    t = epochs[59].t + 600.0
    found = one.step(Epoch(t, (), steady))
    assert found.status == "LOST"
    layout = whole().layout
    for _, _, block in SENSORS[:2]:
        rows = layout.tangent(block)
        assert (np.sqrt(np.diag(found.P))[rows] > 3 * before[rows]).all()
    assert (np.linalg.eigvalsh(found.P) > 0).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dt", [0.0, 1e-9])
def test_row_12_no_time_between(kind: str, dt: float) -> None:
    epochs = whole().epochs
    usual = driven(kind, whole(), epochs[:11])
    one = driven(kind, whole(), epochs[:10])
    late = tuple(m for m in epochs[10].measurements if m.sensor in ("laser", "gps"))
    rest = tuple(m for m in epochs[10].measurements if m.sensor not in ("laser", "gps"))
    one.step(replace(epochs[10], measurements=rest))
    t = epochs[10].t + dt
    found = one.step(Epoch(t, tuple(replace(m, t=t) for m in late), {}))
    assert len(one.epochs) == len(usual.epochs)
    moved = whole().layout.local(usual.x, found.x) / np.sqrt(np.diag(usual.P))
    assert np.abs(moved).max() < 1e-6


def test_row_12_of_a_recorded_pass() -> None:
    measurements = [m for e in whole().epochs[:5] for m in e.measurements]
    shaken = [replace(m, t=m.t + (5e-7 if m.sensor == "gps" else 0.0)) for m in measurements]
    epochs = make_epochs(whole().processes, shaken, flown()[1].inputs)
    assert [len(e.measurements) for e in epochs] == [4, 3, 4, 3, 4]


# --- 13 ----------------------------------------------------------------------------------


@each_sensor
@pytest.mark.parametrize("periods", [1, 10, 100])
def test_row_13_silence(sensor: str, period: int, block: str, periods: int) -> None:
    """The covariance grows meanwhile; afterwards the filter is where it would have been."""
    start = 20
    k = start + periods * period

    def silent(m: Measurement) -> Measurement | None:
        return None if start < m.t <= k else m

    a, b = clean(), run_estimator("ekf", problem(sensor, silent))
    silenced, whole = (np.trace(track.covariance(block)[k]) for track in (b, a))
    assert silenced > 1.002 * whole
    assert b.status == "ok"
    truth = flown()[1].truth
    assert truth is not None
    for epoch in (k, -1):  # within 99.99 %; no reset, no loss
        e = differences(b.layout, b.x, stored(b.layout, truth))[epoch]
        nees = float(e @ np.linalg.solve(b.P[epoch], e)) / len(e)
        assert nees < 1 + 4 * np.sqrt(2 / len(e))
    assert b.rejected[sensor] == 0
