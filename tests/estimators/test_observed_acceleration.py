"""The desired acceleration of thienel2006's controller, as the observer gives it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from example_makers import HU_INERTIA
from passes import EXPERIMENTS

from relnav_graph.arrays import Array
from relnav_graph.estimators.published.momentum_observer import (
    momentum_rate,
    observed_acceleration,
    observer_step,
)
from relnav_graph.maths import so3
from relnav_graph.runs.closed_loop import Flown, fly
from relnav_graph.scenario.build import load_scenario
from relnav_graph.sim.control.attitude_tracking import AttitudeTracking

INVERSE = np.linalg.inv(HU_INERTIA)


def test_it_is_the_slope_of_the_observers_rate() -> None:
    """Of J^-1 R^T h, with h as the observer carries it on and R turning by that rate."""
    rng, beta, dt = np.random.default_rng(4), 30.0, 1e-5
    for _ in range(20):
        R_hat = so3.exp(rng.normal(size=3))
        R_seen = R_hat @ so3.exp(0.3 * rng.normal(size=3))
        h_i, torque = 50 * rng.normal(size=3), rng.normal(size=3)
        w = momentum_rate(INVERSE, R_hat, h_i)
        ahead = []
        for step in (dt, -dt):
            numbers = np.array([0.02, beta, step])
            _, h = observer_step(numbers, INVERSE, R_hat, h_i, R_seen, torque)
            # What is known acts in the axes of the measured attitude there, of the estimate here.
            h = h + step * (R_hat - R_seen) @ torque
            ahead.append(momentum_rate(INVERSE, R_hat @ so3.exp(step * w), h))
        inertia = np.array([HU_INERTIA, INVERSE])
        got = observed_acceleration(beta, inertia, R_hat, h_i, R_seen, torque)
        np.testing.assert_allclose(got, (ahead[0] - ahead[1]) / (2 * dt), rtol=1e-6, atol=1e-9)


LAW = AttitudeTracking(
    semi_major_axis=6.938e6,
    target_inertia=HU_INERTIA,
    chaser_inertia=HU_INERTIA,
    attitude_gain=0.05,
    rate_gain=0.05,
    acceleration="observer",
)


def test_the_law_follows_it() -> None:
    """By J_c R_ct for each change of it; without one, by Euler's equations."""
    R_ct = so3.exp(np.array([0.1, -0.4, 0.2]))
    target = {"target_attitude": np.eye(3), "target_rate": np.array([0.01, -0.02, 0.03])}
    own = {"chaser_attitude": R_ct.T.copy(), "chaser_rate": np.zeros(3)}

    def command(law: AttitudeTracking, **more: Array) -> Array:
        return law.command(100.0, {**target, **more}, own)

    turning, euler = np.array([1e-3, 2e-3, -3e-3]), replace(LAW, acceleration="euler")
    still = command(LAW, target_acceleration=np.zeros(3))
    want = still + HU_INERTIA @ R_ct @ turning
    np.testing.assert_allclose(command(LAW, target_acceleration=turning), want, rtol=1e-12)
    np.testing.assert_array_equal(command(LAW), command(euler, target_acceleration=turning))
    assert np.abs(command(LAW) - still).max() > 0.01


def flown(kind: str, source: str) -> Flown:
    settings = ("time.epochs=61", 'control.start="20 s"', f"control.acceleration={source}")
    return fly(load_scenario(EXPERIMENTS / "thienel2006.toml", settings), kind, seed=1)


@pytest.mark.parametrize(("kind", "gives"), [("momentum_observer", True), ("ekf", False)])
def test_only_an_observer_gives_one(kind: str, gives: bool) -> None:
    rates = []
    for source in ("euler", "observer"):
        one = flown(kind, source)
        assert one.track.truth is not None
        rates.append(one.track.truth.values["control_rate"])
    np.testing.assert_array_equal(rates[0][:21], rates[1][:21])
    assert (rates[0] != rates[1]).any() == gives
