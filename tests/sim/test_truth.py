"""Physics of the simulated truth and statistics of the simulated gyro."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from plain_physics import (
    DEG,
    PAIR,
    initial_inertial,
    rodrigues,
    rtn,
    run,
    scipy_truth_apart,
    skew,
)
from scipy.special import chdtri

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.errors import InputError
from relnav_graph.sim.instruments.gyro import RateIntegratingGyro
from relnav_graph.sim.truths.integrate import STATE_SIZE, integrate
from relnav_graph.sim.truths.rigid_body_pair import RigidBodyPair

RADIUS = 7.0e6
MEAN_MOTION = np.sqrt(MU_EARTH / RADIUS**3)

# Circular orbit, bodies at rest in i: what moves, moves by noise or by the choice of frame.
QUIET = RigidBodyPair(
    semi_major_axis=RADIUS,
    relative_position=np.zeros(3),
    relative_velocity=np.zeros(3),
    target_inertia=np.array([100.0, 80.0, 60.0]),
    target_rate=np.zeros(3),
)


def assert_chi_square(total: float, dof: int) -> None:
    """`total`, a sum of dof squared standard normals, lies inside 99.98 %."""
    assert chdtri(dof, 1 - 1e-4) < total < chdtri(dof, 1e-4)


def assert_jointly_normal(a: Array, b: Array, P: Any) -> None:
    """Pairs (a, b), of zero mean and any shape, have the covariance P (2, 2)."""
    L = np.linalg.cholesky(np.asarray(P))
    first, second = np.linalg.solve(L, np.stack([a.ravel(), b.ravel()]))
    assert_chi_square((first**2).sum(), first.size)
    assert_chi_square((second**2).sum(), first.size)
    assert abs((first * second).sum()) < 4 * np.sqrt(first.size)


def orbit_states(pair: RigidBodyPair, times: Any, h: float = 0.5) -> tuple[Array, Array]:
    """r_ti_i and v_ti_i (N, 3) from the integrator itself, with its chaser 300 m away."""
    r_i, v_i = initial_inertial(pair)
    y0 = np.zeros(STATE_SIZE)
    y0[0:3], y0[3:6], y0[6:9], y0[12] = r_i, v_i, [300.0, 0, 0], 1.0
    spans = np.diff(times, prepend=0.0)
    counts = np.ceil(spans / h).astype(np.int64)
    y = np.empty((len(times), STATE_SIZE))
    p, still = np.array([pair.mu, 1.0, 1.0, 1.0]), np.zeros((counts.sum(), 6))
    integrate(p, y0, counts, spans / np.maximum(counts, 1), still, y)
    return y[:, 0:3], y[:, 3:6]


def test_agrees_with_a_plain_inertial_integration_at_tight_tolerance() -> None:
    found = scipy_truth_apart()
    assert found["relative_position"] < 1e-6
    assert found["relative_velocity"] < 1e-9
    assert found["target_rate"] < 1e-11
    assert max(found["target_attitude"], found["chaser_attitude"]) < 1e-9


def test_torque_free_target_keeps_energy_and_angular_momentum() -> None:
    times = np.linspace(0, 6000, 601)
    values = run(PAIR, times).values
    h_t = PAIR.target_inertia * values["target_rate"]
    energy = 0.5 * (h_t * values["target_rate"]).sum(axis=1)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-11)
    r_i, v_i = orbit_states(PAIR, times)
    R_io = np.array([rtn(r, v)[0] for r, v in zip(r_i, v_i, strict=True)])
    h_i = np.einsum("nij,njk,nk->ni", R_io, values["target_attitude"], h_t)
    assert np.abs(h_i - h_i[0]).max() < 1e-9 * np.linalg.norm(h_i[0])


def test_orbit_keeps_energy_and_angular_momentum_and_closes_after_one_period() -> None:
    period = 2 * np.pi * np.sqrt(PAIR.semi_major_axis**3 / PAIR.mu)
    r_i, v_i = orbit_states(PAIR, np.linspace(0, period, 101))
    energy = 0.5 * (v_i**2).sum(axis=1) - PAIR.mu / np.linalg.norm(r_i, axis=1)
    np.testing.assert_allclose(energy, -PAIR.mu / (2 * PAIR.semi_major_axis), rtol=1e-12)
    h_i = np.cross(r_i, v_i)
    assert np.abs(h_i - h_i[0]).max() < 1e-12 * np.linalg.norm(h_i[0])
    np.testing.assert_allclose(r_i[-1], r_i[0], atol=1e-4)  # 1e-4 m of 7e6 m


def test_integrator_is_of_sixth_order() -> None:
    """Each halving of the step divides the errors by 2^6, of the rotation and of the orbit."""
    fast = replace(PAIR, target_rate=np.array([0.4, 0.9, 0.3]))

    def errors(pair: RigidBodyPair, name: str, end: float, steps: list[float]) -> list[float]:
        best = run(replace(pair, max_step=steps[-1] / 8), [0, end]).values[name][-1]
        at = [run(replace(pair, max_step=h), [0, end]).values[name][-1] for h in steps]
        return [float(np.linalg.norm(value - best)) for value in at]

    rotation = errors(fast, "target_attitude", 32.0, [0.5, 0.25, 0.125])
    orbit = errors(replace(PAIR, target_rate=np.zeros(3)), "relative_position", 4800.0, [75, 37.5])
    for coarse, fine in [*pairwise(rotation), orbit]:
        assert np.log2(coarse / fine) == pytest.approx(6, abs=0.35)


def test_max_step_does_not_matter_without_noise() -> None:
    coarse = run(PAIR, [0, 700, 1500]).values
    for name, value in run(replace(PAIR, max_step=0.2), [0, 700, 1500]).values.items():
        np.testing.assert_allclose(value, coarse[name], rtol=1e-14, atol=1e-9)


def test_lands_on_uneven_times_and_starts_from_zero() -> None:
    dense = run(PAIR, np.linspace(0, 20, 201)).values
    for name, value in run(PAIR, [0.3, 7.7, 20.0]).values.items():
        np.testing.assert_allclose(value, dense[name][[3, 77, 200]], rtol=1e-14, atol=1e-11)
    start = run(PAIR, [0.0]).values
    for name in ("relative_position", "relative_velocity", "target_rate"):
        np.testing.assert_allclose(start[name][0], getattr(PAIR, name), atol=1e-12)
    for name in ("target_attitude", "chaser_attitude"):
        np.testing.assert_allclose(start[name][0], rodrigues(getattr(PAIR, name)), atol=1e-14)


def test_chaser_ahead_on_the_same_circle_has_positive_y_and_stays() -> None:
    lead = 100.0 / RADIUS  # rad
    ahead = RADIUS * np.array([np.cos(lead) - 1, np.sin(lead), 0])
    values = run(replace(QUIET, relative_position=ahead), np.linspace(0, 6000, 61)).values
    assert ahead[1] > 0
    assert np.abs(values["relative_position"] - ahead).max() < 1e-6
    assert np.abs(values["relative_velocity"]).max() < 1e-9


def test_relative_velocity_is_the_derivative_of_relative_position() -> None:
    values = run(PAIR, 500 + np.arange(-2, 3) * 2.0).values
    r = values["relative_position"]
    slope = (8 * (r[3] - r[1]) - (r[4] - r[0])) / 24.0
    np.testing.assert_allclose(slope, values["relative_velocity"][2], rtol=0, atol=1e-9)


@pytest.mark.parametrize("body", ["target", "chaser"])
def test_attitudes_turn_at_the_body_rate_less_the_orbital_rate(body: str) -> None:
    """R_ob' = R_ob [w_bi_b x] - [w_oi_o x] R_ob, with w_oi_o = h / r^2 from the orbit."""
    step = 0.1
    times = 500 + np.arange(-2, 3) * step
    values = run(PAIR, times).values
    R_ob, w_bi_b = values[f"{body}_attitude"], values[f"{body}_rate"][2]
    r_i, v_i = orbit_states(PAIR, times, step)
    _, w_oi_o = rtn(r_i[2], v_i[2])
    slope = (8 * (R_ob[3] - R_ob[1]) - (R_ob[4] - R_ob[0])) / (12 * step)
    want = R_ob[2] @ skew(w_bi_b) - skew(w_oi_o) @ R_ob[2]
    np.testing.assert_allclose(slope, want, rtol=0, atol=1e-10)


def test_mean_rate_turns_the_chaser_over_each_interval() -> None:
    """The product of Exp(mean rate dt) is the whole inertial rotation."""
    edges = np.array([0.0, 3.0, 10.0, 40.0])
    still = replace(PAIR, semi_major_axis=1e15)  # so wide an orbit that o does not turn
    R_ic = run(still, edges).values["chaser_attitude"]
    means = still.mean_rate(edges[:-1], edges[1:])
    for k, dt in enumerate(np.diff(edges)):
        np.testing.assert_allclose(R_ic[k] @ rodrigues(means[k] * dt), R_ic[k + 1], atol=1e-12)
    with pytest.raises(InputError, match=r"t = 3\.0 s does not run forwards"):
        PAIR.mean_rate(edges[[0, 1]], edges[[1, 1]])


def test_inertia_parameters_are_artanh_of_the_ratios() -> None:
    k = run(PAIR, [0.0]).values["inertia_parameters"][0]
    l_x, l_y, l_z = 20 / 100, -40 / 80, 20 / 60
    np.testing.assert_allclose(np.tanh([*k, -k.sum()]), [l_x, l_y, l_z])


@pytest.mark.parametrize("max_step", [0.5, 2.0])
def test_torque_noise_has_its_density_whatever_the_step(max_step: float) -> None:
    """Of a body at rest w(t) is a Wiener process: independent steps, variance density^2 dt.

    The gyroscopic term is of second order in the noise, 1e-6 of it here.
    """
    density = 1e-8
    noisy = replace(QUIET, torque_density=density, max_step=max_step)
    w = np.array([run(noisy, [0, 10, 30], seed).values["target_rate"] for seed in range(200)])
    P = density**2 * np.diag([10.0, 20.0])
    assert_jointly_normal(w[:, 1], w[:, 2] - w[:, 1], P)


def test_acceleration_noise_gives_a_velocity_walk_and_its_integral() -> None:
    """Var v = s^2 T and Var r = s^2 T^3 / 3, Cov = s^2 T^2 / 2; gravity is nothing in 10 s."""
    density, T = 1e-4, 10.0
    noisy = replace(QUIET, acceleration_density=density, max_step=0.1)
    runs = [run(noisy, [0, T], seed).values for seed in range(200)]
    r = np.array([values["relative_position"][1] for values in runs])
    v = np.array([values["relative_velocity"][1] for values in runs])
    v += np.cross([0, 0, MEAN_MOTION], r)  # as seen in i
    P = density**2 * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
    assert_jointly_normal(r, v, P)
    assert not np.any([values["target_rate"] for values in runs])


def test_a_seed_fixes_each_noise_whatever_the_other() -> None:
    torque = replace(PAIR, torque_density=1e-6)
    both = replace(torque, acceleration_density=1e-5)
    a, b, c = (run(both, [0, 50.0], seed).values for seed in (3, 3, 4))
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert not np.array_equal(a["target_rate"], c["target_rate"])
    assert np.array_equal(a["target_rate"], run(torque, [0, 50.0], 3).values["target_rate"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"eccentricity": 1.0}, "eccentricity: found 1.0"),
        ({"eccentricity": -0.1}, "eccentricity: found -0.1"),
        ({"target_inertia": [1.0, 2.0, 3.5]}, r"target_inertia: found \[1.0, 2.0, 3.5\]"),
        ({"target_inertia": [1.0, -2.0, 3.0]}, "target_inertia: found -2.0"),
        ({"torque_density": -1e-8}, "torque_density: found -1e-08"),
    ],
)
def test_bad_parameters_raise_with_the_value(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(PAIR, **change)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0, 2.0, 2.0], r"found 2.0 s after 2.0 s"),
        ([-1.0, 3.0], r"found -1.0 s"),
        ([0.0, np.nan], r"finite"),
        ([[0.0, 1.0]], r"shape \(1, 2\)"),
    ],
)
def test_bad_times_raise_with_the_value(times: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        run(PAIR, times)


# The gyro: after 64 s either noise makes half of the variance of the angle.
SIGMA_V, SIGMA_U, DT = 4e-4, 1e-5, 4.0


def gyro(sigma_v: float = SIGMA_V, sigma_u: float = SIGMA_U) -> RateIntegratingGyro:
    return RateIntegratingGyro(DT, sigma_v, sigma_u, np.array([1.0, -2.0, 3.0]) * DEG / 3600)


def sample(sensor: RateIntegratingGyro, n: int, seed: int) -> tuple[Array, Array]:
    """Errors (n, 3) of the output at zero rate, and biases (n + 1, 3)."""
    t = sensor.edges(0.0, n * sensor.period)
    series, bias = sensor.sample(np.zeros((n, 3)), t[:-1], t[1:], np.random.default_rng(seed))
    return series.values, bias


def test_gyro_without_noise_reads_the_mean_rate_and_the_bias() -> None:
    sensor = gyro(0.0, 0.0)
    t = sensor.edges(5.0, 29.0)
    rates = PAIR.mean_rate(t[:-1], t[1:])
    series, bias = sensor.sample(rates, t[:-1], t[1:], np.random.default_rng(0))
    assert series.name == "gyro"
    want = np.tile(PAIR.chaser_rate + sensor.initial_bias, (6, 1))
    np.testing.assert_allclose(series.values, want, rtol=1e-14)
    np.testing.assert_array_equal(bias, np.tile(sensor.initial_bias, (7, 1)))


def test_gyro_white_noise_averages_over_the_sample() -> None:
    values, _ = sample(gyro(sigma_u=0.0), 4000, 1)
    e = values - gyro().initial_bias
    assert_jointly_normal(e[1:], e[:-1], SIGMA_V**2 / DT * np.eye(2))


def test_gyro_bias_and_its_mean_are_drawn_jointly() -> None:
    """(b_{k+1} - b_k, mean b - b_k) has covariance s^2 [[dt, dt / 2], [dt / 2, dt / 3]]."""
    values, bias = sample(gyro(sigma_v=0.0), 4000, 2)
    np.testing.assert_array_equal(bias[0], gyro().initial_bias)
    step, mean = np.diff(bias, axis=0), values - bias[:-1]
    P = SIGMA_U**2 * DT * np.array([[1, 1 / 2], [1 / 2, 1 / 3]])
    assert_jointly_normal(step, mean, P)
    assert_jointly_normal(step[1:], step[:-1], P[0, 0] * np.eye(2))


def test_gyro_errors_do_not_depend_on_how_the_time_is_cut() -> None:
    """Variance of the angle error after T: s_v^2 T + s_u^2 T^3 / 3, for every period."""
    T = 64.0
    variance = SIGMA_V**2 * T + SIGMA_U**2 * T**3 / 3
    for period in (2.0, 16.0):
        sensor = replace(gyro(), period=period, initial_bias=np.zeros(3))
        errors = [sample(sensor, int(T / period), s)[0].sum(axis=0) * period for s in range(400)]
        assert_chi_square((np.array(errors) ** 2).sum() / variance, 1200)


def test_gyro_edges_end_with_the_pass() -> None:
    sensor = replace(gyro(), period=0.1)
    np.testing.assert_allclose(sensor.edges(0.0, 0.3), [0, 0.1, 0.2, 0.3], atol=1e-15)
    np.testing.assert_allclose(sensor.edges(1.0, 1.25), [1, 1.1, 1.2, 1.25])
    assert len(sensor.edges(0.0, 6000.0)) == 60001
    with pytest.raises(InputError, match=r"from 2\.0 s to 2\.0 s"):
        sensor.edges(2.0, 2.0)


def test_gyro_refuses_gaps_and_wrong_sizes() -> None:
    t, rng = np.arange(4.0), np.random.default_rng(0)
    with pytest.raises(InputError, match="adjoin"):
        gyro().sample(np.zeros((2, 3)), t[[0, 2]], t[[1, 3]], rng)
    with pytest.raises(InputError, match=r"found rates \(2, 3\), expected \(3, 3\)"):
        gyro().sample(np.zeros((2, 3)), t[:-1], t[1:], rng)
    with pytest.raises(InputError, match=r"angle_random_walk_density: found -1\.0"):
        gyro(sigma_v=-1.0)
