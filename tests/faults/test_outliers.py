"""Outliers, biases, and a pose that fits by symmetry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from online_passes import KINDS, driven, fresh, in_sigmas, zhang
from passes import EXPERIMENTS, RANGER, ZHANG, differences, stored, toy_measurements, toy_problem

from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.problem import Problem
from relnav_graph.estimators import run_estimator
from relnav_graph.maths.losses import Loss
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.metrics import score

GATES = {"fix": 1 - 1e-6, "ranger": 1 - 1e-6}
#: A step of three sigmas raises the alarm within so many samples; a drift of 0.2 sigmas a
#: sample within the second number.
SAMPLES_STEP, SAMPLES_DRIFT = 15, 40


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sensor", ["fix", "ranger"])
@pytest.mark.parametrize("many", [10.0, 100.0, 1e6])
def test_row_15_one_outlier(kind: str, sensor: str, many: float) -> None:
    """Gated: the estimate is what it would be without that observation."""
    problem = toy_problem(toy_measurements(), gates=GATES)
    sigma = {"fix": 0.1, "ranger": RANGER.sigma}[sensor]
    clean, struck, absent = (fresh(kind, problem) for _ in range(3))
    for epoch in problem.epochs:
        reference = clean.step(epoch)
        if epoch.t != 15.0:
            found, least = struck.step(epoch), absent.step(epoch)
        else:
            own = [m for m in epoch.measurements if m.sensor == sensor]
            others = [m for m in epoch.measurements if m.sensor != sensor]
            hit = [replace(m, z=m.z + many * sigma * (m.ids[:, None] == 0)) for m in own]
            rest = [replace(m, z=m.z[1:], ids=m.ids[1:]) for m in own if len(m.z) > 1]
            found = struck.step(replace(epoch, measurements=(*others, *hit)))
            refused = [(r.sensor, r.ids, r.reason) for r in found.refused]
            assert refused == [(sensor, (0,), "gated")]
            least = absent.step(replace(epoch, measurements=(*others, *rest)))
        assert in_sigmas(problem.layout, found, least) < 1e-2
    assert in_sigmas(problem.layout, found, reference) < 0.5


@pytest.mark.parametrize("loss", ["huber", "cauchy", "dcs", "tukey", "student_t"])
@pytest.mark.parametrize("kind", ["iekf", "batch", "incremental", "fixed_lag"])
def test_row_15_one_outlier_under_a_loss(kind: str, loss: Any) -> None:
    losses = {"ranger": Loss(loss)}
    ms = [
        replace(m, z=m.z + 1e3 * RANGER.sigma * (m.ids[:, None] == 1))
        if (m.sensor, m.t) == ("ranger", 15.0)
        else m
        for m in toy_measurements()
    ]
    clean = run_estimator(kind, toy_problem(toy_measurements(), losses=losses))
    found = run_estimator(kind, toy_problem(ms, losses=losses))
    sigma = np.sqrt(np.einsum("kii->ki", clean.P))
    assert (np.abs(found.x - clean.x) / sigma).max() < (1.0 if loss == "huber" else 0.5)
    assert found.status == "ok"
    assert found.downweighted["ranger"] + found.rejected["ranger"] >= 1


def _long_pass(bias: Any, seed: int = 5) -> Problem:
    """150 fixes and ranges of a body at rest; a bias (m) on the fixes as a function of t."""
    rng, out = np.random.default_rng(seed), []
    r, drift = np.array([9.0, -6.0, 4.0]), np.zeros(1)
    for t in np.arange(150.0):
        z = r + 0.1 * rng.normal(size=3) + bias(t) * np.array([1.0, 0, 0])
        out.append(Measurement("fix", t, z[None], np.zeros(1, dtype=np.int64)))
        ids = RANGER.observables()
        ranges = RANGER.predict(ids, r, drift) + RANGER.sigma * rng.normal(size=(3, 1))
        out.append(Measurement("ranger", t, ranges, ids))
    problem = toy_problem([])
    return replace(problem, epochs=make_epochs(problem.processes, out, {}))


def _first_alarm(problem: Problem, since: float) -> float:
    one = fresh("iekf", problem)
    for epoch in problem.epochs:
        found = one.step(epoch)
        if "fix: its innovations are biased" in found.message:
            assert found.status == "DEGRADED"
            assert epoch.t >= since, "a false alarm"
            return epoch.t - since
    return np.inf


def test_row_16_a_bias_step_raises_the_alarm() -> None:
    step = _first_alarm(_long_pass(lambda t: 0.3 * (t >= 100)), 100.0)
    assert step <= SAMPLES_STEP


def test_row_16_a_slow_drift_raises_the_alarm() -> None:
    drift = _first_alarm(_long_pass(lambda t: 0.02 * max(t - 60.0, 0.0)), 60.0)
    assert drift <= SAMPLES_DRIFT


@pytest.mark.parametrize("seed", range(5))
def test_row_16_no_alarm_without_a_bias(seed: int) -> None:
    assert _first_alarm(_long_pass(lambda t: 0.0, seed), 0.0) == np.inf


def test_row_16_a_step_beyond_the_gate_is_an_alarm_too() -> None:
    problem = replace(_long_pass(lambda t: 3.0 * (t >= 100)), gates=GATES)
    one = driven("iekf", problem, problem.epochs[: 100 + SAMPLES_STEP])
    assert one.health()[0] == "DEGRADED"
    assert "of its newest observations left out" in one.health()[1]


CLEAN = ("time.epochs=60",)
STRUCK = ("sensors.beacons.outliers.fraction=0.3", "sensors.beacons.outliers.size=100")
GATED = "sensors.beacons.gate=0.999"


def _errors(kind: str, *settings: str) -> dict[str, tuple[float, str]]:
    scenario = load_scenario(ZHANG, [*CLEAN, *settings])
    recording = scenario.simulate(0)
    track = run_estimator(kind, scenario.problem(recording, 0))
    found: dict[str, tuple[float, str]] = {}
    for row in [track] if track.smoothed is None else [track, track.smoothed]:
        s = score(row, recording.truth, derived_quantities(scenario.layout))
        rmse = s.states["relative_attitude"].rmse
        assert rmse is not None
        found[row.kind] = (rmse, row.status)
    return found


@pytest.mark.parametrize("robust", [(GATED,), (GATED, "sensors.beacons.loss=cauchy")])
def test_row_17_thirty_percent_outliers_on_the_beacons(robust: tuple[str, ...]) -> None:
    """The smoothed error is at most 1.5 times that without outliers."""
    clean = _errors("batch")["smoothed"][0]
    rmse, status = _errors("batch", *STRUCK, *robust)["smoothed"]
    assert status == "ok"
    assert rmse < 1.5 * clean


@pytest.mark.parametrize("kind", ["batch", "incremental", "fixed_lag"])
@pytest.mark.parametrize("seed", [0, 1])
def test_row_17_smoothers_with_thirty_percent_outliers(kind: str, seed: int) -> None:
    """Close by, under a gate alone: at most 1.5 times the smoothed error without them."""
    options = ("time.epochs=100", 'online.window="30 s"')
    rmse = list[float]()
    for settings in ((), (*STRUCK, GATED)):
        scenario = load_scenario(EXPERIMENTS / "zhang2015_close.toml", [*options, *settings])
        recording = scenario.simulate(seed)
        track = run_estimator(kind, scenario.problem(recording, seed))
        smoothed = track.smoothed or track
        assert smoothed.status == "ok", smoothed.message
        states = score(smoothed, recording.truth, derived_quantities(scenario.layout)).states
        rmse.append(states["relative_attitude"].rmse or np.inf)
    assert rmse[1] < 1.5 * rmse[0]


def test_row_17_one_gate_for_filter_and_graph() -> None:
    """Of the same fixes, of which 30 % are wrong, all reject the same."""
    rng, ms = np.random.default_rng(7), list[Measurement]()
    wrong = 0
    for m in toy_measurements():
        if m.sensor == "fix":
            hit = rng.random() < 0.3
            wrong += hit
            ms.append(replace(m, z=m.z + hit * rng.choice((-20.0, 20.0), 3)))
    problem = toy_problem(ms, gates={"fix": 0.9999})
    assert wrong > 5
    for kind in ("ekf", "iekf", "batch", "incremental", "fixed_lag"):
        track = run_estimator(kind, problem)
        assert track.status == "ok", track.message
        for row in filter(None, (track, track.smoothed)):
            assert row.rejected == {"fix": wrong, "ranger": 0}, row.name


def test_row_17_filter_and_graph_under_the_same_gate() -> None:
    """Confidently wrong is none of them: far off, they say so."""
    short = "time.epochs=40", 'online.window="100 s"'
    clean = _errors("iekf", *short)["filtered"][0]
    for kind in ("ekf", "iekf", "fixed_lag"):
        for rmse, status in _errors(kind, *STRUCK, GATED, *short).values():
            assert status != "ok" or rmse < 5 * clean


@pytest.mark.parametrize("kind", ["iekf", "fixed_lag", "incremental"])
def test_row_17_a_burst(kind: str) -> None:
    """Four epochs in a row of nothing but nonsense."""
    problem = toy_problem(toy_measurements(), gates=GATES)
    one, rng = fresh(kind, problem), np.random.default_rng(2)
    for epoch in problem.epochs:
        ms = epoch.measurements
        if 12 <= epoch.t < 16:
            ms = tuple(replace(m, z=m.z + 3 + rng.normal(size=m.z.shape)) for m in ms)
        found = one.step(replace(epoch, measurements=ms))
    clean = driven(kind, problem)
    assert in_sigmas(problem.layout, found, clean) < 0.5
    assert found.status == "OK", found.message


#: Beacons 0 to 3 are seen where the target, turned by 180 degrees about z, would have them.
TURNED = np.array([1, 0, 3, 2, 4, 5])


@pytest.mark.parametrize("kind", ["iekf", "fixed_lag", "incremental"])
def test_row_17_a_plausible_wrong_symmetry(kind: str) -> None:
    """Five epochs of swapped beacons: gated; the attitude does not flip."""
    problem, recording = zhang(40, GATED)
    one, truth = fresh(kind, problem), recording.truth
    assert truth is not None
    for epoch in problem.epochs:
        ms = epoch.measurements
        if 25 <= epoch.t / 10 < 30:
            ms = tuple(replace(m, ids=TURNED[m.ids]) for m in ms)
        found = one.step(replace(epoch, measurements=ms))
        if epoch.t == 270.0:
            assert any(r.reason == "gated" for r in found.refused)
    e = differences(problem.layout, found.x[None], stored(problem.layout, truth)[-1:])[0]
    assert e @ np.linalg.solve(found.P, e) < 5 * problem.layout.dim
