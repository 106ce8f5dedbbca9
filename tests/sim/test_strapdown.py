"""Strapdown data: many samples as one, the sensors that give them, and their memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from relnav_factors.dynamics.gyro_bias import GyroBias
from relnav_factors.dynamics.inertial_orbit_motion import InertialOrbitMotion
from relnav_factors.shared.strapdown import condense

from relnav_graph.arrays import Array
from relnav_graph.maths import so3
from relnav_graph.sim.instruments.strapdown import StrapdownAccelerometer, StrapdownGyro

MODEL = InertialOrbitMotion(velocity_random_walk_density=5e-4)
X = (np.array([6.878e6, 1e5, -2e5]), np.array([100.0, 6e3, 4.5e3]))
R_IC, B_G, B_F = so3.exp(np.array([0.4, -1.0, 0.7])), np.full(3, 2e-5), np.full(3, 1e-3)


def samples(rate: float, count: int = 50, dt: float = 0.02) -> Array:
    """Coning and sculling: rate and force turn together. (count, 7)"""
    t = dt * (np.arange(count) + 0.5)
    w = rate * np.stack([np.cos(9 * t), np.sin(9 * t), 0.3 + 0.1 * np.sin(4 * t)], axis=1)
    f = 0.03 * np.stack([np.cos(9 * t), np.sin(9 * t), 1 - t / t[-1]], axis=1)
    return np.hstack([np.full((count, 1), dt), w, f])


@pytest.mark.parametrize("rate", [1e-3, 0.08])
def test_samples_taken_together_move_the_chaser_as_one_by_one(rate: float) -> None:
    """What is lost is how the force is spread over the interval: a displacement."""
    fine = samples(rate)
    few = condense(fine, 0.1)
    assert len(few) == 1 or (rate > 0.01 and len(few) <= 2)
    (r, v), F, Q = MODEL.transition(0.0, fine, *X, R_IC, B_G, B_F)
    (r_few, v_few), F_few, Q_few = MODEL.transition(0.0, few, *X, R_IC, B_G, B_F)
    gained = v - MODEL.transition(0.0, fine * [1, 1, 1, 1, 0, 0, 0], *X, R_IC, B_G, 0 * B_F)[0][1]
    assert np.linalg.norm(gained) > 0.01
    # Gravity changes by 1e-6 / s^2 times the displacement; the biases' share is that of a
    # constant rate.
    assert np.abs(v_few - v).max() < 1e-7 + 0.2 * rate * np.linalg.norm(B_F)
    assert np.abs(r_few - r).max() < 0.01
    others = [*range(9), 12, 13, 14]
    np.testing.assert_allclose(F_few[3:, others], F[3:, others], atol=0.03 * rate + 1e-4)
    # The gyro's bias turns the force about the middle of a row: 1e-9 m/s for 2e-5 rad/s.
    assert np.abs((F_few - F)[:, 9:12] @ B_G).max() < 1e-7
    np.testing.assert_allclose(Q_few, Q, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("rate", [1e-3, 0.08])
def test_samples_taken_together_turn_the_chaser_as_one_by_one(rate: float) -> None:
    noise: dict[str, Any] = {"angle_random_walk_density": 1e-5, "bias_random_walk_density": 1e-8}
    model, together = GyroBias(**noise), GyroBias(**noise, samples="together")
    u = np.ascontiguousarray(samples(rate)[:, :4])
    np.testing.assert_array_equal(model.condense(u), u)
    few = together.condense(u)
    assert len(few) <= 2
    (R, _), F, Q = model.transition(0.0, u, R_IC, B_G)
    (R_few, _), F_few, Q_few = together.transition(0.0, few, R_IC, B_G)
    assert np.abs(so3.log(R.T @ R_few)).max() < 0.1 * rate * np.linalg.norm(B_G) + 1e-12
    np.testing.assert_allclose(F_few, F, atol=0.1 * rate)
    np.testing.assert_allclose(Q_few, Q, rtol=0.02, atol=1e-3 * Q[0, 0])


def test_a_fast_turn_stays_in_as_many_rows_as_it_needs() -> None:
    """Ten revolutions would wrap in one row."""
    u = np.zeros((500, 7))
    u[:, 0], u[:, 3], u[:, 4] = 0.02, 2 * np.pi, 1.0
    few = condense(u, 0.1)
    turned = few[:, 3] * few[:, 0]
    assert turned.max() < 0.13
    np.testing.assert_allclose(turned.sum(), 20 * np.pi, rtol=1e-12)
    np.testing.assert_allclose(few[:, 0].sum(), 10.0, rtol=1e-12)


@pytest.mark.parametrize(
    "source",
    [
        StrapdownGyro(
            period=0.02,
            angle_random_walk_density=1e-4,
            drift_sigma=1e-3,
            drift_time_constant=30.0,
            constant_bias=np.full(3, 0.01),
        ),
        StrapdownAccelerometer(
            period=0.02,
            velocity_random_walk_density=1e-4,
            drift_sigma=1e-3,
            drift_time_constant=30.0,
            constant_bias=np.full(3, 0.01),
        ),
    ],
    ids=lambda s: s.kind,
)
def test_errors_are_as_declared(source: StrapdownGyro | StrapdownAccelerometer) -> None:
    """White noise of density n has the variance n^2 / dt; the bias does not decay; what drifts
    about it has its standard deviation from the start and forgets where it began; the same numbers
    come in whatever intervals."""
    sampler = source.begin(np.random.default_rng(0))
    errors, drifts = [], []
    for k in range(6000):
        errors.append(sampler.take(source.edges(float(k), k + 1.0)))
        drifts.append(sampler.drift)
        np.testing.assert_array_equal(sampler.bias, np.full(3, 0.01))
    drift, e = np.array(drifts), np.array(errors)
    assert e.shape == (6000, 50, 3)
    assert drift.std() == pytest.approx(1e-3, rel=0.1)
    # The mean of 200 correlation times: within 3 sigma of the constant, of which none decays.
    assert np.abs(e.mean(axis=(0, 1)) - 0.01).max() < 3 * 1e-3 * np.sqrt(2 / 200)
    assert np.abs(e[3000:].mean(axis=(0, 1)) - 0.01).max() < 3 * 1e-3 * np.sqrt(2 / 100)
    one = np.mean(drift[30:] * drift[:-30]) / np.mean(drift**2)
    assert one == pytest.approx(np.exp(-1), abs=0.1)
    white = (e - e.mean(axis=1, keepdims=True)).std() * np.sqrt(50 / 49)
    assert white == pytest.approx(1e-4 / np.sqrt(0.02), rel=0.02)
    again = source.begin(np.random.default_rng(0))
    np.testing.assert_array_equal(again.take(source.edges(0.0, 1.0)), errors[0])
    begins = [source.begin(np.random.default_rng(seed)).drift for seed in range(200)]
    assert np.std(begins) == pytest.approx(1e-3, rel=0.1)
