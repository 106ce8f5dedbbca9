"""The published filters: their predictions, their limits, and that of what they assume."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, stored
from passes import differences as apart
from scipy.linalg import expm

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.conformance.numeric import differences
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track, Truth
from relnav_graph.errors import ModelError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.online.driver import online
from relnav_graph.estimators.published.hu2019 import HuOneStep, euler_step
from relnav_graph.estimators.published.own_coordinates import Published, PublishedFilter
from relnav_graph.estimators.published.xiong2013 import (
    XiongFilter,
    clohessy_wiltshire,
    orbital_axes,
    relative_in_inertial,
)
from relnav_graph.maths import so3
from relnav_graph.maths.inertia import inertia_of, inertia_parameters, parameter_slopes
from relnav_graph.maths.orbit import two_body
from relnav_graph.runs.passes import simulated_pass
from relnav_graph.scenario.build import load_scenario

HU_INERTIA = np.array([[1000.0, 60, 40], [60, 800, 30], [40, 30, 600]])
RATIOS = np.array([0.8, 0.6, 0.06, 0.04, 0.03])
RATE = np.array([0.2, 0.05, 0.05])
HU_FILTERS = ("hu2019_one_step", "hu2019_five_steps")


def a_pass(name: str, *settings: str, seed: int = 0) -> tuple[Problem, Truth]:
    found = simulated_pass(load_scenario(EXPERIMENTS / f"{name}.toml", settings), seed)
    assert found.recording.truth is not None
    return found.problem, found.recording.truth


def true_motion(seconds: float) -> tuple[Array, Array]:
    """R and w of a free body of Hu's inertia, by ten thousand small steps."""
    R, w, h = np.eye(3), RATE, seconds / 10_000
    inverse = np.linalg.inv(HU_INERTIA)

    def slope(w: Array) -> Array:
        return -inverse @ np.cross(w, HU_INERTIA @ w)

    for _ in range(10_000):
        half = w + 0.5 * h * slope(w)
        R = R @ so3.exp(np.ascontiguousarray(h * half))
        w = w + h * slope(half)
    return R, w


@pytest.mark.parametrize(("steps", "attitude", "rate"), [(1, 0.10, 0.0077), (5, 0.018, 0.0016)])
def test_euler_steps_err_as_much_as_is_known_of_them(
    steps: int, attitude: float, rate: float
) -> None:
    """Degrees and degrees a second, in one second of the published tumble."""
    R, w = np.eye(3), RATE
    for _ in range(steps):
        R, w, _ = euler_step(R, w, RATIOS, 1.0 / steps)
    R_true, w_true = true_motion(1.0)
    error = np.degrees(np.linalg.norm(so3.log(np.ascontiguousarray(R.T @ R_true))))
    assert error == pytest.approx(attitude, rel=0.1)
    assert np.degrees(np.linalg.norm(w - w_true)) == pytest.approx(rate, rel=0.05)


def test_the_printed_transition_is_the_slope_of_the_motion_as_steps_shrink() -> None:
    """(Phi - I) / h is the A of eq. 13; d of an attitude on the right, as everywhere here."""
    h = 1e-6
    R0 = so3.exp(np.array([0.3, -0.2, 0.5]))
    R1, w1, Phi = euler_step(R0, RATE, RATIOS, h)

    def moved(d: Array) -> Array:
        turned = R0 @ so3.exp(np.ascontiguousarray(d[:3]))
        R, w, _ = euler_step(turned, RATE + d[3:6], RATIOS + d[6:], h)
        e = so3.log(np.ascontiguousarray(R1.T @ R)) - d[:3]
        return np.concatenate([e, w - w1 - d[3:6]]) / h

    A = (Phi - np.eye(11)) / h
    np.testing.assert_allclose(A[:6], differences(moved, np.full(11, 1e-3)), atol=1e-6)
    assert (A[6:] == 0).all()


def test_inertia_parameters_and_their_inverse() -> None:
    rng = np.random.default_rng(0)
    for k in (np.zeros(5), *rng.normal(size=(5, 5))):
        J = inertia_of(k)
        np.testing.assert_allclose(inertia_parameters(7.0 * J), k, atol=1e-12)
        changes = np.array([c + c.T for c in rng.normal(size=(4, 3, 3))])

        def of(d: Array, J: Array = J, changes: Array = changes) -> Array:
            return inertia_parameters(J + np.tensordot(d, changes, 1))

        numeric = differences(of, np.full(4, 1e-6))
        np.testing.assert_allclose(parameter_slopes(J, changes), numeric, atol=1e-6)


def engines() -> list[tuple[str, PublishedFilter, str]]:
    return [("hu2019", HuOneStep(), "11"), ("xiong2013", XiongFilter(), "24")]


@pytest.mark.parametrize(("name", "estimator", "states"), engines())
def test_own_coordinates_and_back(name: str, estimator: PublishedFilter, states: str) -> None:
    """As many error states as are printed; x(y(x)) = x, and the Jacobian is that of x(y)."""
    problem, truth = a_pass(name, "time.epochs=3")
    own: Published = estimator.of(problem)
    assert own.layout.dim == int(states) == problem.layout.dim
    x = stored(problem.layout, truth)[1]
    y = own.own(x)
    scale = np.maximum(1.0, np.abs(x))
    np.testing.assert_allclose(own.scenario(y) / scale, x / scale, atol=1e-12)

    def moved(d: Array) -> Array:
        return problem.layout.local(x, own.scenario(own.layout.retract(y, d)))

    steps = np.full(own.layout.dim, 1e-5)
    for block in own.layout:
        if block.name in ("chaser_position", "chaser_velocity"):
            steps[own.layout.tangent(block.name)] = 10.0
    numeric, found = differences(moved, steps), own.jacobian(y)
    error = np.abs(numeric - found) * steps  # of each row, in its unit, by one step
    assert (error < 1e-7 * np.maximum(1.0, np.abs(found * steps).max())).all()


def gap(a: Track, b: Track) -> float:
    """The largest difference of attitude and rate over the pass, rad and rad/s."""
    return float(np.abs(apart(a.layout, a.x, b.x)[:, :6]).max())


def test_hu_agrees_with_the_proper_filter_as_steps_shrink() -> None:
    """Euler's error is of first order in the step; the same noise and the same measurements."""
    found = []
    for step in (0.1, 0.05):
        settings = f'time.step="{step} s"', f"time.epochs={int(5 / step) + 1}"
        problem, _ = a_pass("hu2019", *settings)
        ekf = run_estimator("ekf", problem)
        tracks = [run_estimator(kind, problem) for kind in HU_FILTERS]
        found.append([gap(t, ekf) for t in tracks])
        sigma = np.sqrt(np.diag(ekf.P[-1]))
        for track in tracks:
            assert np.abs(np.sqrt(np.diag(track.P[-1])) / sigma - 1).max() < 0.1 * step / 0.05
    (one, five), (half, half_of_five) = found
    assert half < 0.65 * one
    assert half_of_five < 0.65 * five
    assert five < 0.35 * one


def test_hu_ranks_one_step_five_steps_and_an_integrator() -> None:
    problem, truth = a_pass("hu2019", "time.epochs=151")
    errors = []
    for kind in (*HU_FILTERS, "ekf"):
        track = run_estimator(kind, problem)
        e = apart(problem.layout, stored(problem.layout, truth), track.states)
        errors.append(np.degrees(np.sqrt((e[75:, :3] ** 2).sum(axis=1).mean())))
    one, five, ekf = errors
    assert one > 2 * five > 4 * ekf


def test_xiong_axes_are_along_track_against_the_normal_and_to_nadir() -> None:
    C, w = orbital_axes(np.array([7e6, 0.0, 0.0]), np.array([0.0, 7.5e3, 0.0]))
    np.testing.assert_allclose(C, np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]]).astype(float))
    np.testing.assert_allclose(w, [0.0, -7.5e3 / 7e6, 0.0])


@pytest.mark.parametrize("kind", range(3))
def test_clohessy_wiltshire_is_the_relative_motion_of_near_circular_orbits(kind: int) -> None:
    """Ten minutes of the exact difference of two circular orbits, 20 m apart, in all directions;
    what is left is of second order, rho^2 / r, and the turn of the chaser's axes against the
    target's."""
    r, v = np.array([7e6, 0.0, 0.0]), np.array([0.0, np.sqrt(MU_EARTH / 7e6), 0.0])
    n, T = float(np.sqrt(MU_EARTH / 7e6**3)), 600.0
    own = np.zeros(6)
    own[kind], own[3:] = 20.0, [0.002, -0.003, 0.004]
    relative = relative_in_inertial(own, r, v)
    ahead = two_body(r, v, MU_EARTH, T)[:2]
    target = two_body(r - relative[:3], v - relative[3:], MU_EARTH, T)[:2]
    found = relative_in_inertial(expm(clohessy_wiltshire(n) * T) @ own, *ahead)
    exact = np.concatenate([ahead[0] - target[0], ahead[1] - target[1]])
    np.testing.assert_allclose(found[:3], exact[:3], atol=20 * 30**2 / 7e6)
    np.testing.assert_allclose(found[3:], exact[3:], atol=20 * n * 30**2 / 7e6)
    assert np.linalg.norm(exact[:3] - relative[:3]) > 1.0


def test_xiong_agrees_with_the_proper_filter_but_for_millimetres() -> None:
    """200 m behind, C_o^i from the chaser's orbit costs rho^2 / r."""
    problem, _ = a_pass("xiong2013_0p1m", "time.epochs=121")
    ekf, own = (run_estimator(kind, problem) for kind in ("ekf", "xiong2013_filter"))
    assert own.status == "ok"
    gap = apart(problem.layout, ekf.x, own.x) / np.sqrt(np.diagonal(ekf.P, axis1=1, axis2=2))
    assert 1e-6 < np.abs(gap).max() < 0.2
    position = ekf.value("relative_position") - own.value("relative_position")
    assert np.abs(position).max() < 0.02
    ratio = np.sqrt(np.diagonal(own.P, axis1=1, axis2=2) / np.diagonal(ekf.P, axis1=1, axis2=2))
    np.testing.assert_allclose(ratio, 1.0, atol=0.02)


def circular(*settings: str) -> tuple[Problem, Truth]:
    """zhang2015_close on a circular orbit, its target at rest in the orbital frame to begin with,
    and spinning about the orbit's normal, z, its axis of largest inertia."""
    rate = np.sqrt(MU_EARTH / 7.2e6**3)
    still = (
        "orbit.eccentricity=0.0",
        "time.epochs=300",
        'truth.target_attitude=["0 deg", "0 deg", "0 deg"]',
        'truth.target_inertia=["60 kg*m^2", "80 kg*m^2", "100 kg*m^2"]',
        f'truth.target_rate=["0 rad/s", "0 rad/s", "{rate} rad/s"]',
        'truth.torque_density="0 rad/s^1.5"',
    )
    return a_pass("zhang2015_close", *still, *settings)


def nees_of(problem: Problem, truth: Truth, track: Track) -> float:
    """Mean NEES / n of the blocks that move, at the last epoch."""
    layout = track.layout
    e = layout.local(track.x[-1], stored(layout, truth)[-1])
    return float(e @ np.linalg.solve(track.P[-1], e)) / layout.dim


def test_a_body_that_is_its_orbital_frame_is_estimated_rightly() -> None:
    """What the assumption gains where it holds: attitude and position are better than a filter can
    tell that has to find the target's attitude."""
    problem, truth = circular()
    kim, iekf = (run_estimator(k, problem) for k in ("kim2007_body_is_orbital", "iekf"))
    assert kim.status == "ok"
    assert kim.name == "kim2007_body_is_orbital"
    assert nees_of(problem, truth, kim) < 2.2
    place = kim.layout.tangent("relative_position"), iekf.layout.tangent("relative_position")
    own, other = (np.trace(t.P[-1][p, p]) for t, p in zip((kim, iekf), place, strict=True))
    assert own < other
    np.testing.assert_allclose(
        kim.value("target_attitude"), np.broadcast_to(np.eye(3), (300, 3, 3)), atol=1e-6
    )


def test_a_tumbling_target_is_lost_and_said_to_be() -> None:
    problem, truth = a_pass("zhang2015_close", "time.epochs=120")
    kim, iekf = (run_estimator(k, problem) for k in ("kim2007_body_is_orbital", "iekf"))
    assert iekf.status == "ok"
    assert kim.status == "degraded"
    true = truth.values["relative_position"][-1]
    errors = [np.linalg.norm(t.value("relative_position")[-1] - true) for t in (kim, iekf)]
    assert errors[0] > 100 * errors[1]


@pytest.mark.parametrize("kind", [*HU_FILTERS, "xiong2013_filter"])
def test_published_filters_serve_online(kind: str) -> None:
    name = "xiong2013" if kind.startswith("xiong") else "hu2019"
    problem, _ = a_pass(name, "time.epochs=8")
    track = run_estimator(kind, problem)
    live = online(kind, replace(problem, epochs=()))
    for epoch in problem.epochs:
        estimate = live.step(epoch)
    np.testing.assert_allclose(estimate.x, track.x[-1], rtol=1e-12)
    np.testing.assert_allclose(estimate.P, track.P[-1], rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "name", "expected"),
    [
        ("hu2019_one_step", "xiong2013", "expected a state of just target_attitude"),
        ("xiong2013_filter", "hu2019", "expected a state of just relative_position"),
        ("kim2007_body_is_orbital", "hu2019", "found no orbit"),
    ],
)
def test_row_41_a_published_filter_of_another_system_is_refused(
    kind: str, name: str, expected: str
) -> None:
    problem, _ = a_pass(name, "time.epochs=3")
    with pytest.raises(ModelError, match=f"{kind}: .*{expected}"):
        run_estimator(kind, problem)


def test_a_gate_is_the_scenarios() -> None:
    """What the filters share with the proper ones, and report: gates and what they left out."""
    options: tuple[Any, ...] = (
        "sensors.vision.gate=0.999",
        "sensors.vision.outliers.fraction=0.2",
        "sensors.vision.outliers.size=100",
        "time.epochs=60",
    )
    problem, _ = a_pass("hu2019", *options)
    five, ekf = (run_estimator(k, problem) for k in ("hu2019_five_steps", "ekf"))
    assert five.status == "ok"
    assert 5 <= five.rejected["vision"] <= 25
    assert abs(five.rejected["vision"] - ekf.rejected["vision"]) <= 3
    assert five.left_out["vision"].t.shape == (five.rejected["vision"],)
