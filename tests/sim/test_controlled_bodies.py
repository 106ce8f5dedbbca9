"""The truth of the attitude loop by physics, against the estimators' own model, and the law."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from example_makers import HU_INERTIA
from relnav_factors.dynamics.gravity_gradient_rotation import GravityGradientRotation

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.sim.control.attitude_tracking import AttitudeTracking
from relnav_graph.sim.truths.controlled_bodies import ControlledBodies

HUBBLE = np.array([[36046.0, -706, 1491], [-706, 86868, 449], [1491, 449, 93848]])
SERVICER = np.array([[18748.0, 525, -2197], [525, 55903, 1366], [-2197, 1366, 53025]])
ORBIT: dict[str, Any] = {"semi_major_axis": 6.938e6, "inclination": 0.5, "raan": 0.3}
PAIR = ControlledBodies(
    **ORBIT,
    argument_of_latitude=0.7,
    target_inertia=HUBBLE,
    chaser_inertia=SERVICER,
    target_attitude=np.array([0.3, -0.8, 0.5]),
    target_rate=np.array([1e-3, -2e-3, 5e-4]),
    chaser_rate=np.array([-2e-3, 1e-3, 3e-3]),
)
#: Where there is neither gravity nor air.
FREE = replace(PAIR, semi_major_axis=1e12)


def start(truth: ControlledBodies, seed: int = 0) -> Any:
    return truth.fly(0.0, np.random.default_rng(seed))


def radial(t: float) -> tuple[Array, Array]:
    """Unit vectors outwards and along the velocity of `ORBIT`, in i."""
    a = ORBIT["semi_major_axis"]
    latitude = 0.7 + np.sqrt(MU_EARTH / a**3) * t
    plane = so3.exp(np.array([0, 0, ORBIT["raan"]]))
    plane = plane @ so3.exp(np.array([ORBIT["inclination"], 0, 0]))
    R_io = plane @ so3.exp(np.array([0, 0, latitude]))
    return R_io[:, 0], R_io[:, 1]


def point_masses(J: Array) -> tuple[Array, Array]:
    """Six point masses (kg) and places (m) with the inertia J."""
    second, axes = np.linalg.eigh(0.5 * np.trace(J) * np.eye(3) - J)
    arms = 3.0 * np.vstack([axes.T, -axes.T])
    return np.tile(second / (2 * 9.0), 2), arms


def test_energy_and_momentum_stay_where_nothing_pulls() -> None:
    values = FREE.simulate(np.linspace(0, 5000, 51), np.random.default_rng(0)).values
    for body, J in (("target", HUBBLE), ("chaser", SERVICER)):
        w, R = values[f"{body}_rate"], values[f"{body}_attitude"]
        h_i = np.einsum("nij,jk,nk->ni", R, J, w)
        energy = np.einsum("ni,ij,nj->n", w, J, w)
        np.testing.assert_allclose(h_i, np.broadcast_to(h_i[0], h_i.shape), rtol=0, atol=1e-6)
        np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
        assert np.ptp(w, axis=0).max() > 1e-4


@pytest.mark.parametrize("t", [0.0, 1234.5])
def test_gravity_gradient_is_that_of_point_masses(t: float) -> None:
    """Newton's law on each mass, for the truth and for the model of the estimators."""
    R_it = so3.exp(np.array([0.4, -1.1, 0.6]))
    masses, places_t = point_masses(HUBBLE)
    outwards, _ = radial(t)
    r_i = 6.938e6 * outwards + places_t @ R_it.T
    pull_i = -MU_EARTH * r_i / np.linalg.norm(r_i, axis=1)[:, None] ** 3
    torque_i = np.cross(places_t @ R_it.T, masses[:, None] * pull_i).sum(axis=0)
    want = R_it.T @ torque_i
    assert np.linalg.norm(want) > 0.01
    model = GravityGradientRotation(
        torque_density=1e-7, known_inertia=HUBBLE, true_anomaly=0.7, **ORBIT
    )
    np.testing.assert_allclose(model.torque(t, R_it), want, rtol=1e-5, atol=1e-7)
    still = replace(PAIR, target_rate=np.zeros(3), target_attitude=so3.log(R_it))
    flight = still.fly(t, np.random.default_rng(0))
    flight.advance(t + 0.01, None, {})
    change = HUBBLE @ flight.values()["target_rate"] / 0.01
    np.testing.assert_allclose(change, want, rtol=1e-4, atol=1e-6)


def test_model_of_the_estimators_follows_the_truth() -> None:
    """Written twice, and apart: after an hour and a half in steps of a second."""
    values = PAIR.simulate(np.array([0.0, 5400.0]), np.random.default_rng(0)).values
    errors = []
    for step in (4.0, 1.0):
        model = GravityGradientRotation(
            torque_density=1e-7, known_inertia=HUBBLE, true_anomaly=0.7, max_step=step, **ORBIT
        )
        first = values["target_attitude"][0], values["target_rate"][0]
        R, w = model.propagate(0.0, np.array([[5400.0]]), *first)
        turn = so3.log(np.ascontiguousarray(R.T @ values["target_attitude"][1]))
        errors.append(np.linalg.norm(turn))
        assert np.linalg.norm(w - values["target_rate"][1]) < 1e-8
    assert np.degrees(errors[1]) < 1e-4
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.05)  # of second order


def test_drag_pushes_on_the_centre_of_pressure() -> None:
    faces, centre = np.array([14.0, 110.0, 60.0]), np.array([0.5, 0.2, -0.2])
    still = replace(PAIR, target_rate=np.zeros(3))
    windy = replace(still, atmosphere=1e-9, target_faces=faces, target_pressure_centre=centre)
    rates = []
    for truth in (still, windy):
        flight = start(truth)
        flight.advance(0.01, None, {})
        rates.append(flight.values()["target_rate"])
    R_it = so3.exp(PAIR.target_attitude.copy())
    _, ahead = radial(0.0)
    v_t = R_it.T @ ahead * np.sqrt(MU_EARTH / 6.938e6)
    force = -0.5 * 1e-9 * 2.2 * (faces @ np.abs(v_t)) * v_t
    want = np.cross(centre, force)
    np.testing.assert_allclose(HUBBLE @ (rates[1] - rates[0]) / 0.01, want, rtol=1e-3)


def test_command_turns_the_chaser_and_nothing_else() -> None:
    flight, drifting = start(FREE), start(FREE)
    torque = np.array([3.0, -2.0, 1.0])
    flight.advance(0.01, torque, {})
    drifting.advance(0.01, None, {})
    one, other = flight.values(), drifting.values()
    turned = SERVICER @ (one["chaser_rate"] - other["chaser_rate"]) / 0.01
    np.testing.assert_allclose(turned, torque, rtol=1e-4)
    np.testing.assert_array_equal(one["target_rate"], other["target_rate"])


def test_start_is_drawn_as_asked_for() -> None:
    assert start(PAIR).values()["target_rate"] == pytest.approx(PAIR.target_rate)
    drawn = replace(PAIR, random_attitude=True, target_rate_sigma=0.01)
    values = [start(drawn, seed).values() for seed in range(400)]
    R = np.array([v["target_attitude"] for v in values])
    assert np.abs(R.mean(axis=0)).max() < 0.15  # uniform: each entry has the variance 1/3
    assert np.abs((R**2).mean(axis=0) - 1 / 3).max() < 0.06
    w = np.array([v["target_rate"] for v in values]) - PAIR.target_rate
    assert w.std(axis=0) == pytest.approx([0.01] * 3, rel=0.12)
    fixed = {k: v for k, v in values[0].items() if k.startswith("chaser")}
    for name, value in fixed.items():
        np.testing.assert_array_equal(value, start(drawn, 7).values()[name])


def test_wrong_values_are_refused() -> None:
    with pytest.raises(InputError, match="chaser_inertia: found"):
        replace(PAIR, chaser_inertia=np.diag([1.0, 1.0, 3.0]))
    with pytest.raises(InputError, match="found command"):
        start(PAIR).advance(1.0, np.zeros(2), {})
    with pytest.raises(InputError, match="found command"):
        start(PAIR).advance(1.0, np.array([0.0, np.nan, 0.0]), {})
    with pytest.raises(InputError, match="cannot drive the inputs gyro"):
        start(PAIR).advance(1.0, None, {"gyro": np.array([0.0, 1.0])})
    with pytest.raises(InputError, match="known_inertia"):
        GravityGradientRotation(
            torque_density=1e-7, known_inertia=np.diag([1.0, 1.0, 3.0]), semi_major_axis=7e6
        )
    with pytest.raises(InputError, match="orbit"):
        GravityGradientRotation(
            torque_density=1e-7, known_inertia=HU_INERTIA, semi_major_axis=7e6, eccentricity=1.2
        )


# --- the tracking law -----------------------------------------------------------------------

LAW = AttitudeTracking(
    semi_major_axis=6.938e6,
    inclination=0.5,
    raan=0.3,
    argument_of_latitude=0.7,
    target_inertia=HUBBLE,
    chaser_inertia=SERVICER,
    attitude_gain=0.05,
    rate_gain=0.05,
)


def sliding(values: dict[str, Array]) -> Array:
    """s = w_c - w_r of the law."""
    R_ct = values["chaser_attitude"].T @ values["target_attitude"]
    e = so3.quaternion(np.ascontiguousarray(R_ct.T))[1:]
    found: Array = values["chaser_rate"] - R_ct @ values["target_rate"] + 0.05 * e
    return found


@pytest.mark.parametrize("turn", [[3.1, 0, 0], [0.4, -1.1, 0.9], [0, 2.0, -2.0]])
def test_tracking_is_exponentially_stable_where_the_target_is_known(turn: list[float]) -> None:
    """s' J s, the storage of the passive loop, falls as exp(-2 k t) (Egeland, Godhavn 1994)."""
    truth = replace(PAIR, chaser_attitude=PAIR.target_attitude + np.array(turn))
    flight, storage = start(truth), []
    dt = 0.1
    for k in range(6000):
        values = flight.values()
        s = sliding(values)
        storage.append(s @ SERVICER @ s)
        own = {name: values[name] for name in LAW.own}
        target = {name: values[name] for name in LAW.reads}
        flight.advance((k + 1) * dt, LAW.command(k * dt, target, own), {})
    fall = np.array(storage[:1500]) / storage[0]
    np.testing.assert_allclose(fall, np.exp(-2 * 0.05 * dt * np.arange(1500)), rtol=0.1, atol=1e-6)
    found = LAW.control_errors({name: v[None] for name, v in flight.values().items()})
    error = so3.log(np.ascontiguousarray(found["control_attitude"][0]))
    assert np.degrees(np.linalg.norm(error)) < 1e-3
    assert np.degrees(np.linalg.norm(found["control_rate"])) < 1e-4
