"""Stamps of two sensors from a nanosecond to a millisecond apart (row 40)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from online_passes import driven, zhang

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch, process_inputs
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators import run_estimator

COUNT, STEP = 25, 10.0
#: What is known beforehand leaves the filters little to linearise anew.
KNOWN = (
    'prior.relative_position.sigma="0.02 m"',
    'prior.relative_velocity.sigma="0.0001 m/s"',
    'prior.target_attitude.sigma="0.05 deg"',
    'prior.target_rate={sigma="0.01 deg/s", mean=["0.2 deg/s", "2.5 deg/s", "0.2 deg/s"]}',
    "prior.inertia_parameters={sigma=0.02, mean=[0.1655, 0.2027]}",
)
#: Between whole numbers of steps: the same epochs leave the window. Long enough for what leaves
#: to be settled; half as long, a fixed-lag smoother is 0.2 sigma from the batch at equal stamps.
WINDOW = 15.5 * STEP
SECOND = "second"


def moved(problem: Problem, before: Epoch | None, values: dict[str, Array], d: float) -> Array:
    """The stored state d seconds on, by the processes; rates of the gyro as in `before`."""
    after = dict(values)
    for name, p in problem.processes.items():
        u = before.inputs[name][:1].copy() if before else np.zeros((1, 1))
        u[:, 0] = d
        x = [np.ascontiguousarray(values[b.name]) for b in p.advances + p.reads]
        after |= {b.name: v for b, v in zip(p.advances, p.propagate(0.0, u, *x), strict=True)}
    return problem.layout.pack(after)


@cache
def split(d: float) -> Problem:
    """zhang2015 whose odd beacons belong to a second sensor, which is d seconds later."""
    problem, recording = zhang(COUNT, *KNOWN)
    truth, gyro = recording.truth, recording.inputs["gyro"]
    assert truth is not None
    sensor, layout = problem.sensors["beacons"], problem.layout
    # The last sample goes on for a step: a second stamp may follow the last epoch.
    longer = InputSeries(
        "gyro",
        np.append(gyro.t_start, gyro.t_end[-1]),
        np.append(gyro.t_end, gyro.t_end[-1] + STEP),
        np.vstack([gyro.values, gyro.values[-1:]]),
    )
    times, seen = list[float](), list[tuple[Measurement, ...]]()
    for k, epoch in enumerate(problem.epochs):
        (m,) = epoch.measurements
        odd = m.ids % 2 == 1
        own = Measurement("beacons", m.t, m.z[~odd], m.ids[~odd])
        values = {b.name: truth.values[b.name][k] for b in layout}
        following = problem.epochs[min(k + 1, COUNT - 1)]
        ahead = layout.values(moved(problem, following, values, d)) if d else values
        h = [
            sensor.predict(m.ids, *(np.ascontiguousarray(v[b.name]) for b in sensor.reads))
            for v in (values, ahead)
        ]
        z = m.z + h[1] - h[0]
        z /= np.linalg.norm(z, axis=1)[:, None]
        other = Measurement(SECOND, m.t + d, z[odd], m.ids[odd])
        if d:
            times += [m.t, m.t + d]
            seen += [(own,), (other,)]
        else:
            times.append(m.t)
            seen.append((own, other))
    epochs = []
    for k, (t, measurements) in enumerate(zip(times, seen, strict=True)):
        u = {
            name: process_inputs(p, {"gyro": longer}, times[k - 1], t)
            for name, p in (problem.processes.items() if k else ())
        }
        epochs.append(Epoch(t, measurements, u))
    sensors = {**problem.sensors, SECOND: sensor}
    return replace(problem, sensors=sensors, epochs=tuple(epochs), window=WINDOW)


def away(d: float, x: Array, P: Array, same: Array, k: int) -> float:
    """Sigmas per state, of P (n, n), from x (size,), d seconds after epoch k, to the estimate
    `same` (size,) of equal stamps."""
    problem = split(0.0)
    following = problem.epochs[min(k + 1, COUNT - 1)]
    on = moved(problem, following, problem.layout.values(same), d) if d else same
    e = problem.layout.local(on, x)
    return float(np.sqrt(e @ np.linalg.solve(P, e) / len(e)))


@cache
def estimate(kind: str, d: float) -> Track:
    return run_estimator(kind, split(d))


@pytest.mark.parametrize("d", [1e-9, 1e-6, 2e-6, 1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("kind", ["batch", "incremental", "fixed_lag"])
def test_row_40_smoothers_estimate_as_with_equal_stamps(kind: str, d: float) -> None:
    track, same = estimate(kind, d), estimate(kind, 0.0)
    assert track.status == "ok", track.message
    assert away(d, track.x[-1], same.P[-1], same.x[-1], COUNT - 1) < 0.05
    ahead, same = track.smoothed or track, same.smoothed or same
    assert ahead.status == "ok", ahead.message
    if kind == "fixed_lag":  # an epoch leaves with the first of two stamps, half a step earlier
        return
    for k in range(COUNT):
        assert away(0.0, ahead.x[2 * k], same.P[k], same.x[k], k) < 0.05, k
        scale = np.sqrt(np.diag(same.P[k]))
        assert np.abs((ahead.P[2 * k] - same.P[k]) / np.outer(scale, scale)).max() < 0.02


@pytest.mark.parametrize("d", [1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("kind", ["ekf", "iekf", "rts"])
def test_row_40_filters_estimate_as_with_equal_stamps(kind: str, d: float) -> None:
    """But for what an update in two steps, each linearised on its own, makes of it, which is the
    same at any distance."""
    track, same, limit = estimate(kind, d), estimate(kind, 0.0), estimate(kind, 1e-9)
    assert track.status == "ok", track.message
    assert away(d, track.x[-1], same.P[-1], same.x[-1], COUNT - 1) < 0.12
    on = limit.x[-1], same.P[-1]
    assert away(d, track.x[-1], on[1], on[0], COUNT - 1) < 0.05


@pytest.mark.parametrize("d", [1e-9, 5e-6])
@pytest.mark.parametrize("kind", ["fixed_lag", "incremental"])
def test_row_40_online_too(kind: str, d: float) -> None:
    one, same = driven(kind, split(d)), estimate(kind, 0.0)
    assert one.health()[0] == "OK", one.health()
    assert away(d, one.x, same.P[-1], same.x[-1], COUNT - 1) < 0.05
