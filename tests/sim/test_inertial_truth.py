"""Truths in axes that do not rotate: against the pair in the orbital frame, and by physics."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from example_makers import HU_INERTIA

from relnav_graph.arrays import Array
from relnav_graph.core.track import Truth
from relnav_graph.errors import InputError
from relnav_graph.sim.truths.inertial import InertialPair, TumblingBody
from relnav_graph.sim.truths.rigid_body_pair import RigidBodyPair

BODY = TumblingBody(
    target_inertia=HU_INERTIA,
    target_rate=np.array([0.2, 0.05, 0.05]),
    target_attitude=np.array([0.3, -0.8, 0.5]),
)
ORBIT: dict[str, Any] = {
    "semi_major_axis": 7.2e6,
    "eccentricity": 0.05,
    "true_anomaly": 0.3,
    "inclination": 0.9,
    "raan": 2.1,
    "argument_of_perigee": -1.2,
}
PAIR = InertialPair(
    **ORBIT,
    target_inertia=np.diag([100.0, 80.0, 60.0]),
    target_rate=np.array([0.01, 0.04, -0.02]),
    relative_position=np.array([30.0, -200.0, 50.0]),
    relative_velocity=np.array([0.01, -0.3, 0.02]),
    chaser_rate=np.array([0.001, -0.002, 0.003]),
)


def run(truth: Any, times: Any, seed: int = 0) -> Truth:
    found: Truth = truth.simulate(np.asarray(times, dtype=float), np.random.default_rng(seed))
    return found


def test_energy_and_momentum_of_any_inertia_stay() -> None:
    values = run(BODY, np.linspace(0, 600, 61)).values
    w, R = values["target_rate"], values["target_attitude"]
    h_o = np.einsum("nij,jk,nk->ni", R, HU_INERTIA, w)
    energy = np.einsum("ni,ij,nj->n", w, HU_INERTIA, w)
    np.testing.assert_allclose(h_o, np.broadcast_to(h_o[0], h_o.shape), atol=1e-7 * 200)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    assert np.ptp(w, axis=0).min() > 0.01


def test_start_is_as_asked_for() -> None:
    values = run(BODY, [0.0, 1.0]).values
    np.testing.assert_allclose(values["target_rate"][0], BODY.target_rate, atol=1e-15)
    values = run(PAIR, [0.0, 1.0]).values
    r, v = values["chaser_position"][0], values["chaser_velocity"][0]
    h = np.cross(r, v)
    R_io = np.column_stack([r, np.cross(h, r), h])
    R_io /= np.linalg.norm(R_io, axis=0)
    np.testing.assert_allclose(
        R_io.T @ values["relative_position"][0], PAIR.relative_position, atol=1e-9
    )
    assert np.linalg.norm(r) == pytest.approx(7.2e6 * (1 - 0.0025) / (1 + 0.05 * np.cos(0.3)))


def test_pair_moves_as_the_pair_in_the_orbital_frame() -> None:
    """The same two orbits, told from the chaser and from the target."""
    values = run(PAIR, [0.0, 400.0, 900.0]).values
    other = RigidBodyPair(
        **ORBIT,
        relative_position=-PAIR.relative_position,
        relative_velocity=-PAIR.relative_velocity,
        target_inertia=np.array([100.0, 80.0, 60.0]),
        target_rate=PAIR.target_rate,
    )
    want = other.simulate(np.array([0.0, 400.0, 900.0]), np.random.default_rng(0)).values
    near, far = (np.linalg.norm(v["relative_position"], axis=1) for v in (values, want))
    np.testing.assert_allclose(near, far, atol=1e-6)
    np.testing.assert_allclose(values["target_rate"], want["target_rate"], atol=1e-9)


def test_shared_noise_leaves_the_relative_motion_alone() -> None:
    """Position and velocity of the orbit have the covariance of white noise integrated
    twice, with a random walk beside it, whatever the epochs."""
    noisy = replace(PAIR, position_density=10.0, acceleration_density=0.1)
    quiet, T = run(PAIR, [0.0, 7.0, 20.0]).values, 20.0
    errors = []
    for seed in range(150):
        values = run(noisy, [0.0, 7.0, 20.0], seed).values
        parts = [values[n][-1] - quiet[n][-1] for n in ("chaser_position", "chaser_velocity")]
        errors.append(np.concatenate(parts))
        moved = values["relative_position"][-1] - quiet["relative_position"][-1]
        assert np.abs(moved).max() < 0.05  # by the gradient of gravity only
    e = np.array(errors).reshape(-1, 2, 3).transpose(0, 2, 1).reshape(-1, 2)
    P = np.array([[100 * T + 0.01 * T**3 / 3, 0.01 * T**2 / 2], [0.01 * T**2 / 2, 0.01 * T]])
    nees = np.einsum("ni,ij,nj->n", e, np.linalg.inv(P), e)
    assert nees.mean() / 2 == pytest.approx(1, abs=4 / np.sqrt(len(nees)))
    L = np.linalg.cholesky(P)
    white = np.linalg.solve(L, e.T)
    assert np.abs(white @ white.T / len(e) - np.eye(2)).max() < 5 / np.sqrt(len(e))


@pytest.mark.parametrize(
    "bad", [np.diag([1.0, 1.0, 2.5]), np.diag([1.0, -1.0, 1.0]), np.tri(3) + 3 * np.eye(3)]
)
def test_an_inertia_that_no_body_has(bad: Array) -> None:
    with pytest.raises(InputError, match=r"TumblingBody\.target_inertia: found"):
        replace(BODY, target_inertia=bad)


def test_torque_is_white() -> None:
    still = replace(BODY, target_rate=np.zeros(3), torque_density=1e-6)
    w = np.array([run(still, [0.0, 30.0], seed).values["target_rate"][-1] for seed in range(200)])
    assert (w**2).mean() == pytest.approx(30e-12, rel=4 * np.sqrt(2 / w.size))
