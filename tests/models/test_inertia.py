"""Inertia of any axes: every parameter is a body, Euler's equations, what a spin hides."""

from __future__ import annotations

import numpy as np
import pytest
from example_makers import HU_INERTIA
from passes import EXPERIMENTS
from relnav_factors.derived.inertia_ratios import InertiaMatrixRatios
from relnav_factors.dynamics.euler_rotation import EulerRotation
from relnav_factors.shared.inertia import inertia_matrix
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from relnav_graph.arrays import Array
from relnav_graph.core.models import derived_quantities
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.maths.inertia import TRACELESS
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.bounds import bounds
from relnav_graph.scoring.observability import explain
from relnav_graph.sim.truths.inertial import inertia_parameters

HU = EXPERIMENTS / "hu2019.toml"
HU_RATE = np.array([0.2, 0.05, 0.05])
FULL = EulerRotation(torque_density=1e-6, inertia_density=1e-8, inertia="full", max_step=0.5)


def reference(J: Array, R: Array, w: Array, T: float) -> tuple[Array, Array]:
    """J w' = -w x J w and R' = R [w x], integrated plainly."""

    def derivative(t: float, y: Array) -> Array:
        w = y[9:]
        turned = y[:9].reshape(3, 3) @ np.cross(np.eye(3), w)
        return np.concatenate([turned.ravel(), np.linalg.solve(J, -np.cross(w, J @ w))])

    y = solve_ivp(derivative, (0, T), np.concatenate([R.ravel(), w]), rtol=1e-11, atol=1e-12).y
    return y[:9, -1].reshape(3, 3), y[9:, -1]


def propagate(model: EulerRotation, k: Array, R: Array, w: Array, T: float) -> tuple[Array, Array]:
    blocks = [R, w, k] if len(k) else [R, w]
    out = model.propagate(0.0, np.array([[T]]), *blocks)
    return out[0], out[1]


@pytest.mark.parametrize("seed", range(5))
def test_every_parameter_is_a_body(seed: int) -> None:
    """Positive definite, each principal moment below the sum of the others; the exponential
    is scipy's."""
    k = 2 * np.random.default_rng(seed).normal(size=5)
    J, _ = inertia_matrix(k)
    moments = np.linalg.eigvalsh(J)
    assert moments[0] > 0
    assert moments[2] < moments[0] + moments[1]
    D = expm(np.einsum("a,aij->ij", k, TRACELESS))
    np.testing.assert_allclose(J, np.trace(D) * np.eye(3) - D, rtol=1e-12, atol=1e-12 * moments[2])


def test_parameters_and_ratios_of_a_matrix() -> None:
    k = inertia_parameters(HU_INERTIA)
    J, _ = inertia_matrix(k)
    np.testing.assert_allclose(J / J[0, 0], HU_INERTIA / 1000.0, atol=1e-13)
    ratios, _ = InertiaMatrixRatios().value(k)
    np.testing.assert_allclose(ratios, [0.8, 0.6, 0.06, 0.04, 0.03], atol=1e-13)
    np.testing.assert_allclose(inertia_parameters(np.eye(3)), 0, atol=1e-15)


def test_no_axes_are_special() -> None:
    """A turn of the axes turns the parameters, and keeps their length."""
    R = so3.exp(np.array([0.3, -1.2, 0.8]))
    k, turned = inertia_parameters(HU_INERTIA), inertia_parameters(R @ HU_INERTIA @ R.T)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(k), rel=1e-12)
    assert np.abs(turned - k).max() > 0.1


@pytest.mark.parametrize("inertia", ["full", "known"])
def test_rotation_is_that_of_eulers_equations(inertia: str) -> None:
    R, T = so3.exp(np.array([0.2, 0.1, -0.4])), 60.0
    model, k = FULL, inertia_parameters(HU_INERTIA)
    if inertia == "known":
        model = EulerRotation(
            torque_density=1e-6, inertia="known", known_inertia=7 * HU_INERTIA, max_step=0.5
        )
        k = np.zeros(0)
    got_R, got_w = propagate(model, k, R, HU_RATE, T)
    want_R, want_w = reference(HU_INERTIA, R, HU_RATE, T)
    assert np.linalg.norm(so3.log(want_R.T @ got_R)) < 1e-5
    np.testing.assert_allclose(got_w, want_w, atol=1e-6)
    assert np.abs(got_w - HU_RATE).max() > 0.01


def test_the_axes_of_principal_inertia_are_a_case_of_any() -> None:
    moments = np.array([100.0, 80.0, 60.0])
    jx, jy, jz = moments
    principal = EulerRotation(torque_density=1e-6, inertia_density=1e-8, max_step=0.5)
    ratios = np.arctanh([(jy - jz) / jx, (jz - jx) / jy])
    a = propagate(principal, ratios, np.eye(3), HU_RATE, 30.0)
    b = propagate(FULL, inertia_parameters(np.diag(moments)), np.eye(3), HU_RATE, 30.0)
    for one, other in zip(a, b, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_published_steps_err_as_worked_out() -> None:
    """Of one second: five Euler steps err a fifth as much as one, a Runge-Kutta step far
    less than either."""
    k, R = inertia_parameters(HU_INERTIA), np.eye(3)
    want_R, want_w = reference(HU_INERTIA, R, HU_RATE, 1.0)
    found = {}
    for name, integrator, step in (
        ("one", "euler", 1.0),
        ("five", "euler", 0.2),
        ("proper", "runge_kutta", 1.0),
    ):
        model = EulerRotation(
            torque_density=1e-6,
            inertia="full",
            integrator=integrator,  # type: ignore[arg-type]
            max_step=step,
        )
        got_R, got_w = propagate(model, k, R, HU_RATE, 1.0)
        angle = np.degrees(np.linalg.norm(so3.log(want_R.T @ got_R)))
        found[name] = angle, np.degrees(np.linalg.norm(got_w - want_w))
    assert found["one"][0] == pytest.approx(0.10, rel=0.2)
    assert found["one"][1] == pytest.approx(0.0077, rel=0.2)
    assert found["five"][0] == pytest.approx(0.018, rel=0.2)
    assert found["five"][1] == pytest.approx(0.0016, rel=0.2)
    assert max(found["proper"]) < 1e-4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inertia": "known"}, "known_inertia goes with"),
        ({"known_inertia": HU_INERTIA}, "known_inertia goes with"),
        ({"inertia": "known", "known_inertia": np.diag([1.0, 1.0, 3.0])}, "no body has"),
        ({"inertia": "known", "known_inertia": np.tri(3) + np.eye(3)}, "no body has"),
    ],
)
def test_known_inertia_is_checked(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        EulerRotation(torque_density=1e-6, **change)  # type: ignore[arg-type]


SPIN = [
    "time.epochs=100",
    "truth.target_inertia=[[1000.0,0,0],[0,800.0,0],[0,0,600.0]]",
    "truth.target_rate=[0.2,0.0,0.0]",
]


def test_a_steady_spin_hides_ratios_and_is_said_to() -> None:
    """About a principal axis only the products with that axis show. The others keep their
    prior, in the bound as in the words."""
    scenario = load_scenario(HU, SPIN)
    recording = scenario.simulate(0)
    assert recording.truth is not None
    problem = scenario.problem(recording, 0)
    x = np.array(
        [
            problem.layout.pack({b.name: recording.truth.values[b.name][k] for b in problem.layout})
            for k in range(len(recording.times))
        ]
    )
    P = bounds(problem, x).smoothed.P[-1]
    kept = np.sqrt(np.diag(P)[problem.layout.tangent("inertia_matrix_parameters")]) / 0.05
    assert (kept[[0, 1, 4]] > 0.99).all()  # both of the diagonal, and yz
    assert (kept[[2, 3]] < 0.2).all()  # xy, xz
    found = explain("spin", problem, x, derived_quantities(problem.layout), None)
    hidden = {row["direction"] for row in found["weak"] if row["verdict"] == "not observable"}
    assert len(hidden) == 3
    assert all("inertia" in name for name in hidden)
