"""Distances between target and chaser, with biases that are constant and that wander."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from relnav_factors.dynamics.range_bias import RangeBias
from relnav_factors.sensors.inter_satellite_range import Range, RangeRate
from scipy.special import chdtri

from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario

ONE = np.zeros(1, dtype=np.int64)

#: Two craft 200 km apart: fixes of a metre now and then, a link with an offset that wanders.
PASS: dict[str, Any] = {
    "title": "ranging",
    "time": {"step": 30.0, "epochs": 61},
    "processes": {
        "relative": {"kind": "relative_two_body", "acceleration_density": 1e-6},
        "orbit": {"kind": "orbit_two_body", "acceleration_density": 1e-6},
        "wander": {"kind": "range_bias", "part": "drift", "sigma": 0.01, "time_constant": 600.0},
    },
    "sensors": {
        "link": {"kind": "range", "sigma": 1e-3, "bias": True, "drift": True},
        "doppler": {"kind": "range_rate", "sigma": 1e-4, "bias": True},
        "fix": {"kind": "position_fix", "sigma": 0.05, "period": 60.0},
        "gps": {"kind": "gps_position", "sigma": 3.0},
    },
    "prior": {
        "relative_position": {"sigma": 0.1},
        "relative_velocity": {"sigma": 1e-3},
        "chaser_position": {"sigma": 10.0},
        "chaser_velocity": {"sigma": 0.01},
        "range_bias": {"sigma": 1.0, "mean": [0.0]},
        "range_rate_bias": {"sigma": 0.01, "mean": [0.0]},
        "range_drift": {"sigma": 0.01, "mean": [0.0]},
    },
    "truth": {
        "kind": "inertial_pair",
        "semi_major_axis": "6900 km",
        "relative_position": [0.0, -2e5, 0.0],
        "target_inertia": np.diag([2.0, 3.0, 4.0]).tolist(),
        "target_rate": [0.0, 0.0, 0.0],
        "statics": {"range_bias": [0.7], "range_rate_bias": [-0.004]},
    },
}


def scenario(**changes: Any) -> Scenario:
    return make_scenario({**PASS, **changes}, "ranging")


@cache
def flown(run: int = 0) -> Recording:
    return scenario().simulate(5, run)


@pytest.mark.parametrize("kind", ["ekf", "iekf", "rts", "batch", "incremental"])
def test_constant_and_wander_of_a_link_are_found(kind: str) -> None:
    recording = flown()
    truth = recording.truth
    assert truth is not None
    assert "range_drift: drawn from the estimators' own process" in truth.source
    track = run_estimator(kind, scenario().problem(recording, 5))
    blocks = [b for b in track.blocks if b.name.startswith("range_")]
    assert {b.name for b in blocks} == {"range_bias", "range_rate_bias", "range_drift"}
    squares = 0.0
    for block in blocks:
        off = float((track.value(block.name)[-1] - truth.values[block.name][-1])[0])
        variance = float(track.covariance(block.name)[-1, 0, 0])
        squares += off**2 / variance
        told = 0.1 if block.name.endswith("bias") else 1.0
        assert variance < told * PASS["prior"][block.name]["sigma"] ** 2
    assert squares < chdtri(len(blocks), 1e-4)


def test_wander_is_drawn_as_it_goes_on() -> None:
    """With the law of its own process from the first epoch on."""
    process = RangeBias(sigma=0.01, time_constant=600.0, part="drift")
    rng = np.random.default_rng(1)
    times = 30.0 * np.arange(2001, dtype=np.float64)
    drift = process.wandering(times, rng)["range_drift"][:, 0] / 0.01
    squares = (drift[::100] ** 2).sum()  # 3000 s apart
    assert chdtri(21, 1 - 1e-3) < squares < chdtri(21, 1e-3)
    assert np.corrcoef(drift[1:], drift[:-1])[0, 1] == pytest.approx(np.exp(-30 / 600), abs=0.02)


def test_a_plain_range_leaves_the_other_sensors_as_they_were() -> None:
    sensors = {**PASS["sensors"], "link": {"kind": "range", "sigma": 1e-3}}
    processes = {n: p for n, p in PASS["processes"].items() if n != "wander"}
    prior = {n: p for n, p in PASS["prior"].items() if n not in ("range_bias", "range_drift")}
    plain = scenario(sensors=sensors, processes=processes, prior=prior, truth=_without_bias())
    found = plain.simulate(5)
    assert "range_drift" not in plain.layout
    for a, b in zip(found.measurements, flown().measurements, strict=True):
        assert a.sensor == b.sensor
        assert np.array_equal(a.z, b.z) == (a.sensor != "link")


def _without_bias() -> dict[str, Any]:
    return {**PASS["truth"], "statics": {"range_rate_bias": [-0.004]}}


def test_a_link_without_its_constant_in_the_truth_is_refused() -> None:
    with pytest.raises(InputError, match=r"'link' cannot be simulated: the truth has no \['range_"):
        scenario(truth=_without_bias()).simulate(5)


def test_a_distance_is_positive_unless_it_has_an_offset() -> None:
    z = np.array([[-3.0]])
    with pytest.raises(InputError, match=r"range: found -3\.0 m, expected one above 0"):
        Range(sigma=0.1).accept(z)
    np.testing.assert_array_equal(Range(sigma=0.1, bias=True).accept(z), z)


@pytest.mark.parametrize("cls", [Range, RangeRate])
def test_row_47_no_direction_at_distance_zero(cls: Any) -> None:
    model = cls(sigma=0.1)
    z = Measurement("link", 3.0, np.array([[1.0]]), ONE)
    with pytest.raises(GeometryError, match="distance between target and chaser is zero"):
        model.residual(z, *[np.zeros(3)] * len(model.reads))


def test_rate_is_that_of_the_distance() -> None:
    r, v, h = np.array([3.0, -4.0, 12.0]), np.array([0.1, 0.4, -0.3]), 1e-5
    rate = RangeRate(sigma=0.1).predict(ONE, r, v)
    ends = [Range(sigma=0.1).predict(ONE, r + s * h * v) for s in (-1, 1)]
    np.testing.assert_allclose(rate, (ends[1] - ends[0]) / (2 * h), rtol=1e-7)


def test_without_drift_the_constant_is_left() -> None:
    """What the published filters without drifts ask of a model."""
    link = Range(sigma=0.1, bias=True, drift=True).without_drift()
    assert [b.name for b in link.reads] == ["relative_position", "range_bias"]
    assert RangeBias(sigma=0.1, time_constant=9.0, part="drift").without_drift() is None
    assert Layout(link.reads).dim == 4
