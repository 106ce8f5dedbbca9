"""Faulted attitudes, positions and odometry. Each test bears the row of the table of faults
that it shows: what was injected, and what must happen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, ONE_ID, differences, sigmas, stored
from passes_odometry import odometry_scenario

from relnav_graph.core.contracts import Sensor
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.maths import so3
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

Change = Callable[[Measurement], Measurement | None]

GATED = 0.9999


@cache
def passes() -> dict[str, tuple[Scenario, Recording]]:
    """A pass of each kind of problem, with a gate on each sensor."""
    xiong = [f"sensors.{s}.gate={GATED}" for s in ("stereo", "gps", "star_tracker")]
    found = {
        "xiong2013_0p1m": load_scenario(
            EXPERIMENTS / "xiong2013_0p1m.toml",
            # Priors so tight that no first fix is in doubt.
            [*xiong, "time.epochs=125", 'prior.target_attitude.sigma="1 deg"'],
        ),
        "hu2019": load_scenario(
            EXPERIMENTS / "hu2019.toml", [f"sensors.vision.gate={GATED}", "time.epochs=230"]
        ),
        "odometry": odometry_scenario(gate=GATED),
    }
    return {name: (scenario, scenario.simulate(1)) for name, scenario in found.items()}


SENSORS = [
    ("xiong2013_0p1m", "stereo"),
    ("xiong2013_0p1m", "gps"),
    ("xiong2013_0p1m", "star_tracker"),
    ("hu2019", "vision"),
    ("odometry", "odometry"),
]
each_sensor = pytest.mark.parametrize(("name", "sensor"), SENSORS)


def model(name: str, sensor: str) -> Sensor:
    return passes()[name][0].sensors[sensor]


def some(name: str, sensor: str) -> Measurement:
    return next(m for m in passes()[name][1].measurements if m.sensor == sensor)


def problem(name: str, sensor: str = "", change: Change = lambda m: m) -> Problem:
    """The pass, with the measurements of one sensor changed or, where None, taken away."""
    scenario, recording = passes()[name]
    kept = []
    for m in recording.measurements:
        changed = change(m) if m.sensor == sensor else m
        if changed is not None:
            kept.append(changed)
    return scenario.problem(replace(recording, measurements=tuple(kept)), 1)


@cache
def clean(name: str, kind: str) -> Track:
    return run_estimator(kind, problem(name))


def nees(name: str, track: Track, k: int) -> float:
    """Normalised error at epoch k, over its mean."""
    truth = passes()[name][1].truth
    assert truth is not None
    e = differences(track.layout, track.x, stored(track.layout, truth))[k]
    return float(e @ np.linalg.solve(track.P[k], e)) / len(e)


@each_sensor
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_row_01_not_finite(name: str, sensor: str, bad: float) -> None:
    m = some(name, sensor)
    z = m.z.copy()
    z[-1, -1] = bad
    with pytest.raises(InputError, match=rf"sensor '{sensor}' at t = .*: z of id .* not finite"):
        replace(m, z=z)


@each_sensor
@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -1e-3])
def test_row_02_sigma_that_is_none(name: str, sensor: str, bad: float) -> None:
    one: Any = model(name, sensor)
    field = next(f for f in ("sigma", "attitude_sigma") if hasattr(one, f))
    with pytest.raises(InputError, match=rf"{field}: found {bad}"):
        replace(one, **{field: np.array([1e-3, bad, 1e-3])})


@each_sensor
def test_row_04_wrong_length_or_type(name: str, sensor: str) -> None:
    m, one = some(name, sensor), model(name, sensor)
    with pytest.raises(InputError, match=f"{one.kind}: found z of"):
        one.accept(m.z[:, :-1])
    for z in (m.z.astype(complex), np.ma.masked_array(m.z), m.z[0], np.array([["a"]])):
        with pytest.raises(InputError, match=f"sensor '{sensor}'"):
            Measurement(sensor, m.t, z, m.ids)


QUATERNIONS = [("xiong2013_0p1m", "star_tracker", 0), ("hu2019", "vision", 0)]
QUATERNIONS += [("odometry", "odometry", 3)]
each_quaternion = pytest.mark.parametrize(("name", "sensor", "at"), QUATERNIONS)


@each_quaternion
@pytest.mark.parametrize("factor", [0.0, 0.9, 1.01, 57.3])
def test_row_05_quaternion_length(name: str, sensor: str, at: int, factor: float) -> None:
    def scaled(m: Measurement) -> Measurement:
        return replace(m, z=np.hstack([m.z[:, :at], factor * m.z[:, at:]]))

    with pytest.raises(InputError, match=rf"{sensor}.*of length {factor:.3g}.*unit quaternion"):
        run_estimator("ekf", problem(name, sensor, scaled))


@each_quaternion
def test_row_05_quaternion_digits(name: str, sensor: str, at: int) -> None:
    """Four digits of a file are enough to be normalised."""

    def rounded(m: Measurement) -> Measurement:
        return replace(m, z=np.hstack([m.z[:, :at], m.z[:, at:] * (1 + 4e-4)]))

    a, b = clean(name, "iekf"), run_estimator("iekf", problem(name, sensor, rounded))
    assert np.abs(differences(a.layout, a.x, b.x) / sigmas(a.P)).max() < 1e-6


@each_quaternion
@pytest.mark.parametrize("kind", ["ekf", "batch"])
def test_row_05_quaternion_sign(name: str, sensor: str, at: int, kind: str) -> None:
    def negated(m: Measurement) -> Measurement:
        return replace(m, z=np.hstack([m.z[:, :at], -m.z[:, at:]]))

    a, b = clean(name, kind), run_estimator(kind, problem(name, sensor, negated))
    np.testing.assert_array_equal(a.x, b.x)


@pytest.mark.parametrize(("name", "sensor"), SENSORS[:4])
@pytest.mark.parametrize("periods", [1, 10, 100])
def test_row_13_silence(name: str, sensor: str, periods: int) -> None:
    """The covariance grows meanwhile; afterwards the filter is where it would have been.

    Where the sensor is the only one, the rate must be known well enough before to bridge a
    hundred seconds of 12 deg/s."""
    start = 110 if name == "hu2019" else 10
    k = start + periods

    def silent(m: Measurement) -> Measurement | None:
        return None if start < m.t <= k else m

    a, b = clean(name, "ekf"), run_estimator("ekf", problem(name, sensor, silent))
    block = model(name, sensor).reads[-1].name
    rows = a.layout.tangent(block)
    assert np.trace(b.P[k][rows, rows]) > 1.01 * np.trace(a.P[k][rows, rows])
    assert b.status == "ok"
    # Within 99.99 %; no reset, no loss.
    assert nees(name, b, k) < 1 + 4 * np.sqrt(2 / a.layout.dim)
    assert nees(name, b, -1) < 1 + 4 * np.sqrt(2 / a.layout.dim)
    assert b.rejected[sensor] <= a.rejected[sensor] + 1


@each_sensor
@pytest.mark.parametrize(
    ("size", "kind"),
    [
        (10.0, "ekf"),
        (100.0, "ekf"),
        (1e6, "ekf"),
        (10.0, "batch"),
        (1e6, "batch"),
        (1e6, "incremental"),
    ],
)
def test_row_15_one_outlier(name: str, sensor: str, size: float, kind: str) -> None:
    """Gated: the estimate is as if the observation had not been there."""
    one, when = model(name, sensor), 30.0

    def wrong(m: Measurement) -> Measurement:
        if m.t != when:
            return m
        R = one.noise(m)
        e = np.zeros(R.shape[:2])
        e[-1, -1] = size * np.sqrt(R[-1, -1, -1])
        if "attitude" in one.kind or one.kind in ("star_tracker", "pose_odometry"):
            e[-1, -1] = min(e[-1, -1], 2.5)  # an angle; more is less again
        return replace(m, z=one.perturb(m.z, e))

    a, b = clean(name, kind), run_estimator(kind, problem(name, sensor, wrong))
    assert b.rejected[sensor] == a.rejected[sensor] + 1
    moved = differences(a.layout, a.x, b.x)[-1] / sigmas(a.P)[-1]
    assert np.abs(moved).max() < 0.5
    if kind == "batch":
        there = differences(a.layout, a.x, b.x) / sigmas(b.P)
        assert np.abs(there).max() < 3  # of the observation itself, which is missing there


def flipped(share: float) -> Change:
    """That share of the attitudes turned by half a turn about a symmetry axis."""
    rng = np.random.default_rng(4)
    half = so3.exp(np.array([np.pi, 0.0, 0.0]))

    def change(m: Measurement) -> Measurement:
        if rng.random() > share or m.t == 0.0:
            return m
        wrong = so3.from_quaternion(m.z[0]) @ half
        return replace(m, z=so3.quaternion(np.ascontiguousarray(wrong))[None])

    return change


@pytest.mark.parametrize("kind", ["ekf", "iekf", "batch", "incremental"])
def test_row_17_wrong_symmetry(kind: str) -> None:
    """Three in ten plausible attitudes are half a turn off: all of them are refused."""
    track = run_estimator(kind, problem("hu2019", "vision", flipped(0.3)))
    assert track.status == "ok"
    assert 0.2 * 230 < track.rejected["vision"] < 0.4 * 230
    assert nees("hu2019", track, -1) < 1 + 4 * np.sqrt(2 / track.layout.dim)


@pytest.mark.parametrize("kind", ["ekf", "batch"])
def test_row_17_mostly_wrong_is_flagged(kind: str) -> None:
    track = run_estimator(kind, problem("hu2019", "vision", flipped(0.7)))
    assert track.status != "ok"
    assert "vision" in track.message


@pytest.mark.parametrize(("name", "sensor"), SENSORS[:4])
def test_row_17_burst(name: str, sensor: str) -> None:
    """Ten epochs of rubbish in a row cost ten epochs."""
    one, rng = model(name, sensor), np.random.default_rng(0)

    def burst(m: Measurement) -> Measurement:
        if not 30 <= m.t < 40:
            return m
        e = rng.normal(size=one.noise(m).shape[:2])
        e *= 100 * np.sqrt(one.noise(m)[:, :1, 0]) / np.linalg.norm(e, axis=1, keepdims=True)
        return replace(m, z=one.perturb(m.z, e))

    track = run_estimator("ekf", problem(name, sensor, burst))
    assert track.status == "ok"
    assert track.rejected[sensor] >= 9 * len(some(name, sensor).ids)
    assert nees(name, track, -1) < 1 + 4 * np.sqrt(2 / track.layout.dim)


def test_row_05_one_id_only() -> None:
    """A sensor of one attitude gives it under the id 0."""
    np.testing.assert_array_equal(some("hu2019", "vision").ids, ONE_ID)
