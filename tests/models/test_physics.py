"""The models against physics: conservation, order, and a truth that shares no code."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from example_makers import gyro_model
from plain_physics import PAIR
from relnav_factors.derived.inertia_ratios import InertiaRatios
from relnav_factors.dynamics.body_velocity import BodyVelocity
from relnav_factors.dynamics.eccentric_relative_motion import EccentricRelativeMotion
from relnav_factors.dynamics.euler_rotation import EulerRotation

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.maths import so3
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion, frame_rotation, relative_transition

#: Principal moments, kg m^2, with the intermediate axis in the middle; and a tumble that
#: comes near it, rad/s.
J = np.array([100.0, 80.0, 60.0])
TUMBLE = np.array([0.02, 0.2, 0.02])
ORBIT = KeplerOrbit(7.2e6, 0.05, 0.3)


def parameters(moments: Array) -> Array:
    """k of principal moments: artanh of (J_y - J_z) / J_x and (J_z - J_x) / J_y."""
    jx, jy, jz = moments
    return np.asarray(np.arctanh([(jy - jz) / jx, (jz - jx) / jy]))


def lasting(seconds: float) -> Array:
    return np.array([[seconds]])


def angle_between(a: Array, b: Array) -> float:
    return float(np.linalg.norm(so3.log(np.ascontiguousarray(a.T @ b))))


# Rotation.


def tumbling(max_step: float = 0.25, **options: Any) -> EulerRotation:
    return EulerRotation(torque_density=1e-9, inertia_density=1e-8, max_step=max_step, **options)


def test_torque_free_rotation_keeps_energy_and_angular_momentum() -> None:
    """Over an hour and some hundred tumbles, with the momentum in a frame at rest."""
    model, k = tumbling(), parameters(J)
    R_ot, w = so3.exp(np.array([0.3, -0.8, 0.5])), TUMBLE
    energy, h_o = w @ (J * w), R_ot @ (J * w)
    turned = 0.0
    for n in range(60):
        R_ot, w, k_next = model.propagate(60.0 * n, lasting(60.0), R_ot, w, k)
        turned += 60 * float(np.linalg.norm(w))
        np.testing.assert_array_equal(k_next, k)
        assert w @ (J * w) == pytest.approx(energy, rel=1e-8)
        np.testing.assert_allclose(R_ot @ (J * w), h_o, atol=1e-7 * float(np.linalg.norm(h_o)))
    assert turned > 100 * 2 * np.pi


def test_rotation_about_a_principal_axis_is_steady() -> None:
    model, k, seconds = tumbling(), parameters(J), 100.0
    for axis in np.eye(3):
        R_ot, w, _ = model.propagate(0.0, lasting(seconds), np.eye(3), 0.3 * axis, k)
        np.testing.assert_allclose(w, 0.3 * axis, atol=1e-15)
        np.testing.assert_allclose(R_ot, so3.exp(0.3 * seconds * axis), atol=1e-12)


def test_intermediate_axis_is_unstable_and_the_others_are_not() -> None:
    """Growth at sqrt(-l_y l_z ...): w = 0.2 rad/s about y turns over within minutes."""
    model, k = tumbling(), parameters(J)
    for axis, flips in ((0, False), (1, True), (2, False)):
        w, least = 0.2 * np.eye(3)[axis] + 1e-3, 1.0
        R_ot = np.eye(3)
        for n in range(60):
            R_ot, w, _ = model.propagate(10.0 * n, lasting(10.0), R_ot, w, k)
            least = min(least, w[axis])
        assert (least < 0) == flips


def test_rotation_is_integrated_to_fourth_order() -> None:
    """Each halving of the step divides the errors of rate and attitude by 2^4 or more."""
    k, w0 = parameters(J), np.array([0.3, 0.5, 0.2])
    ends = [
        tumbling(max_step=h).propagate(0.0, lasting(16.0), np.eye(3), w0, k)
        for h in (0.5, 0.25, 0.125, 2**-8)
    ]
    best = ends.pop()
    rates = np.array([np.linalg.norm(w - best[1]) for _, w, _ in ends])
    angles = np.array([angle_between(best[0], R_ot) for R_ot, _, _ in ends])
    for errors in (rates, angles):
        orders = np.log2(errors[:-1] / errors[1:])
        assert (orders > 3.8).all(), orders


def slope(values: list[Array], h: float) -> Array:
    """Derivative at the first of three values h apart."""
    return np.asarray((4 * values[1] - 3 * values[0] - values[2]) / (2 * h))


def test_rates_change_as_the_moments_demand() -> None:
    """J w' + w x J w = 0."""
    rng, h = np.random.default_rng(1), 1e-4
    for w in rng.normal(size=(50, 3)):
        k = parameters(J)
        ends = (tumbling().propagate(0.0, lasting(n * h), np.eye(3), w, k)[1] for n in (1, 2))
        w_dot = slope([w, *ends], h)
        np.testing.assert_allclose(J * w_dot + np.cross(w, J * w), 0, atol=1e-5)


def test_inertia_parameters_give_the_ratios_of_the_moments() -> None:
    rng = np.random.default_rng(2)
    for corners in rng.uniform(0.01, 1, (200, 3)):
        moments = corners.sum() - corners  # of three point pairs on the axes
        jx, jy, jz = moments
        l, _ = InertiaRatios().value(parameters(moments))
        np.testing.assert_allclose(l, [(jy - jz) / jx, (jz - jx) / jy, (jx - jy) / jz], atol=1e-12)


def test_every_inertia_parameter_is_a_body_of_positive_mass() -> None:
    """Whatever k: the ratios obey their identity, and moments with these ratios exist, are
    positive and obey the triangle inequality."""
    rng = np.random.default_rng(3)
    for k in rng.normal(size=(300, 2)) * rng.uniform(0.1, 4, (300, 1)):
        (l_x, l_y, l_z), _ = InertiaRatios().value(k)
        assert l_x + l_y + l_z + l_x * l_y * l_z == pytest.approx(0, abs=1e-14)
        # J_y - l_x = J_z and J_z - l_y J_y = 1 for J_x = 1
        jy, jz = np.linalg.solve([[1, -1], [-l_y, 1]], [l_x, 1])
        moments = np.array([1.0, jy, jz])
        assert (moments > 0).all()
        assert 2 * moments.max() < moments.sum() * (1 + 1e-12)
        assert l_z == pytest.approx((1 - jy) / jz, abs=1e-9)


# Relative motion.


def relative_motion(gravity: Any, max_step: float = 1.0) -> EccentricRelativeMotion:
    return EccentricRelativeMotion(
        acceleration_density=1e-9, orbit=ORBIT, gravity=gravity, max_step=max_step
    )


@pytest.mark.parametrize("rho", [300.0, 10e3, 50e3])
def test_linear_gravity_neglects_what_the_books_say(rho: float) -> None:
    """The radial acceleration that Zhang et al. 2015, eq. 1 neglect, to second order in the
    separation: 1.5 mu rho^2 / r^4 across the radius, and minus twice that along it."""
    r = chief_motion(ORBIT.array(), 700.0)[0]
    size = 1.5 * MU_EARTH * rho**2 / r**4
    for axis, want in enumerate(np.array([[-2, 0, 0], [1, 0, 0], [1, 0, 0]])):
        start = rho * np.eye(3)[axis], np.zeros(3)
        exact, linear = (
            relative_motion(g).propagate(700.0, lasting(1.0), *start)[1]
            for g in ("exact", "linear")
        )
        third = 0.01 + 3 * rho / r  # what the next order may add
        np.testing.assert_allclose((exact - linear) / size, want, rtol=0, atol=third)


def test_exact_gravity_is_the_difference_of_two_attractions() -> None:
    """In the frame that turns with the target: Coriolis, centrifugal and Euler terms."""
    radius, _, _, rate, rate_dot = chief_motion(ORBIT.array(), 700.0)
    R, w = np.array([radius, 0, 0]), np.array([0, 0, rate])
    rng, h = np.random.default_rng(4), 0.1
    for x in rng.normal(size=(50, 6)) * ([1e5] * 3 + [50.0] * 3):
        d, v = x[:3], x[3:]
        gravity = -MU_EARTH * ((R + d) / np.linalg.norm(R + d) ** 3 - R / radius**3)
        apparent = -2 * np.cross(w, v) - np.cross(w, np.cross(w, d))
        want = gravity + apparent - np.cross([0, 0, rate_dot], d)
        model = relative_motion("exact")
        ends = (model.propagate(700.0, lasting(n * h), d, v)[1] for n in (1, 2))
        np.testing.assert_allclose(slope([v, *ends], h), want, rtol=0, atol=1e-8)


def test_small_separations_move_by_the_linear_transition_matrix() -> None:
    exact, linear = (
        EccentricRelativeMotion(acceleration_density=1e-9, orbit=ORBIT, gravity=g, max_step=1.0)
        for g in ("exact", "linear")
    )
    r, v = np.array([0.02, -0.03, 0.01]), np.array([1e-5, 2e-5, -1e-5])
    phi = relative_transition(ORBIT.array(), 500.0, 1500.0)
    for model in (exact, linear):
        x_next, F, _ = model.transition(500.0, lasting(1000.0), r, v)
        np.testing.assert_allclose(np.concatenate(x_next), phi @ [*r, *v], atol=1e-8)
        np.testing.assert_allclose(F, phi, rtol=0, atol=1e-5 * np.abs(phi).max())


def test_exact_motion_agrees_with_the_truth_to_micrometres_over_an_orbit() -> None:
    period = 2 * np.pi * np.sqrt(PAIR.semi_major_axis**3 / MU_EARTH)
    times = np.linspace(0, period, 13)
    truth = PAIR.simulate(times, np.random.default_rng(0)).values
    model = EccentricRelativeMotion(acceleration_density=1e-9, orbit=ORBIT, max_step=1.0)
    r, v = truth["relative_position"][0], truth["relative_velocity"][0]
    for n in range(12):
        r, v = model.propagate(times[n], lasting(times[n + 1] - times[n]), r, v)
        assert np.linalg.norm(r - truth["relative_position"][n + 1]) < 5e-6
        assert np.linalg.norm(v - truth["relative_velocity"][n + 1]) < 5e-9
    assert np.linalg.norm(r) > 50


def test_linear_motion_is_off_by_the_neglected_term() -> None:
    """Decimetres in half an orbit at 300 m, where the exact model has micrometres."""
    truth = PAIR.simulate(np.array([0.0, 3000.0]), np.random.default_rng(0)).values
    model = EccentricRelativeMotion(acceleration_density=1e-9, orbit=ORBIT, gravity="linear")
    r, _ = model.propagate(
        0.0, lasting(3000.0), truth["relative_position"][0], truth["relative_velocity"][0]
    )
    error = np.linalg.norm(r - truth["relative_position"][1])
    assert 0.01 < error < 1.0


def test_exact_motion_is_integrated_to_fourth_order() -> None:
    r, v = PAIR.relative_position, PAIR.relative_velocity
    ends = [
        EccentricRelativeMotion(
            acceleration_density=1e-9, orbit=KeplerOrbit(7.2e6, 0.3), max_step=h
        ).propagate(0.0, lasting(3200.0), r, v)[0]
        for h in (200.0, 100.0, 50.0, 2.0)
    ]
    errors = np.array([np.linalg.norm(e - ends[-1]) for e in ends[:-1]])
    assert (np.log2(errors[:-1] / errors[1:]) > 3.7).all()


# Attitudes against the truth.


def test_target_attitude_agrees_with_the_truth() -> None:
    times = np.linspace(0, 6000, 11)
    truth = PAIR.simulate(times, np.random.default_rng(0)).values
    k = truth["inertia_parameters"][0]
    np.testing.assert_allclose(k, parameters(J), atol=1e-15)
    model = tumbling(max_step=0.5, orbit=ORBIT)
    R_ot, w = truth["target_attitude"][0], truth["target_rate"][0]
    for n in range(10):
        R_ot, w, k = model.propagate(times[n], lasting(600.0), R_ot, w, k)
        assert angle_between(truth["target_attitude"][n + 1], R_ot) < 1e-7
        np.testing.assert_allclose(w, truth["target_rate"][n + 1], rtol=0, atol=1e-9)


def test_chaser_attitude_agrees_with_the_truth() -> None:
    """A gyro without noise, whose bias is known, in rows of uneven length."""
    times = np.linspace(0, 6000, 11)
    truth = PAIR.simulate(times, np.random.default_rng(0)).values
    model = gyro_model(1e-6, 1e-9, orbit=ORBIT)
    b, rng = np.array([1e-4, -2e-4, 3e-4]), np.random.default_rng(5)
    R_oc = truth["chaser_attitude"][0]
    for n in range(10):
        edges = times[n] + 600 * np.array([0, *np.sort(rng.uniform(0, 1, 30)), 1])
        gyro = PAIR.mean_rate(edges[:-1], edges[1:]) + b
        u = np.ascontiguousarray(np.hstack([np.diff(edges)[:, None], gyro]))
        R_oc, b_next = model.propagate(times[n], u, R_oc, b)
        np.testing.assert_array_equal(b_next, b)
        assert angle_between(truth["chaser_attitude"][n + 1], R_oc) < 1e-11


def test_constant_body_velocity_and_rate_make_a_helix() -> None:
    """Round once, in one row of inputs: back at the start but for the advance along the
    axis; a quarter of the way, at the place on the circle of radius v / w."""
    model: Any = BodyVelocity(velocity_density=np.full(3, 0.1))
    w, advance, forward = 0.02, 0.3, 1.5
    R = so3.exp(np.array([0.4, -0.7, 0.2]))
    u = np.array([[0.0, forward, 0, advance, 0, 0, w]])
    for share, place in ((1.0, [0.0, 0.0]), (0.5, [0.0, 2.0]), (0.25, [1.0, 1.0])):
        u[0, 0] = seconds = share * 2 * np.pi / w
        (r,) = model.propagate(0.0, u, np.zeros(3), R)
        want = np.array([*(np.array(place) * forward / w), advance * seconds])
        np.testing.assert_allclose(R.T @ r, want, atol=1e-10)


def test_a_body_at_rest_in_i_turns_back_in_o() -> None:
    """R_ot' = -[w_oi_o x] R_ot: one turn of o against the body in one orbit."""
    model, seconds = tumbling(orbit=ORBIT), 1500.0
    R_ot, _, _ = model.propagate(200.0, lasting(seconds), np.eye(3), np.zeros(3), np.zeros(2))
    swept = chief_motion(ORBIT.array(), 1700.0)[2] - chief_motion(ORBIT.array(), 200.0)[2]
    np.testing.assert_allclose(R_ot, so3.exp(np.array([0, 0, -swept])), atol=1e-12)
    np.testing.assert_allclose(R_ot, frame_rotation(ORBIT.array(), 200.0, 1700.0), atol=1e-12)
