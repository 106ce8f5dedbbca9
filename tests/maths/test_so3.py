"""SO(3) helpers: equal to GTSAM's, and the laws that they must obey."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from relnav_graph.arrays import Array
from relnav_graph.maths import dense, so3

ANGLES = [0.0, 1e-12, 1e-9, 1e-4, 0.2999, 0.3001, 1.0, 3.0, np.pi - 1e-6]
AXES = np.array([[1.0, 0, 0], [0, -1, 0], [1 / 3, 2 / 3, -2 / 3], [-0.6, 0.0, 0.8]])
VECTORS = [angle * axis for angle in ANGLES for axis in AXES]


def close(a: Array, b: Array, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


def draws(count: int, angle: float, seed: int = 0) -> Array:
    """Rotation vectors of uniform direction, with angles from 0 to `angle`."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    return np.asarray(axes * rng.uniform(0, angle, (count, 1)))


@pytest.mark.parametrize("phi", VECTORS, ids=lambda v: f"{np.linalg.norm(v):.4g}")
def test_exp_and_right_jacobians_equal_those_of_gtsam(phi: Array) -> None:
    close(so3.exp(phi), gtsam.Rot3.Expmap(phi).matrix())
    close(so3.right_jacobian(phi), gtsam.Rot3.ExpmapDerivative(phi))
    close(so3.right_jacobian_inverse(phi), gtsam.Rot3.LogmapDerivative(phi))


@pytest.mark.parametrize("phi", VECTORS, ids=lambda v: f"{np.linalg.norm(v):.4g}")
def test_log_inverts_exp_and_equals_that_of_gtsam(phi: Array) -> None:
    """Near pi too: through the quaternion, the logarithm loses nothing there."""
    R_ab = so3.exp(phi)
    close(so3.log(R_ab), phi)
    close(so3.log(R_ab), gtsam.Rot3.Logmap(gtsam.Rot3(R_ab)))


def test_small_rotations_keep_their_relative_accuracy() -> None:
    for angle in (1e-300, 1e-12, 1e-9, 1e-4):
        phi = angle * AXES[2]
        np.testing.assert_allclose(so3.log(so3.exp(phi)), phi, rtol=1e-12)


def test_series_and_closed_forms_meet_at_the_switch() -> None:
    """Nothing jumps at 0.3 rad by more than the step in the angle itself explains."""
    below, above = 0.3 * (1 - 1e-15) * AXES[2], 0.3 * (1 + 1e-15) * AXES[2]
    for f in (so3.exp, so3.right_jacobian, so3.right_jacobian_inverse):
        close(f(below), f(above), 3e-15)


def test_random_rotations_equal_those_of_gtsam() -> None:
    for phi in draws(300, 3.1):
        R_ab = so3.exp(phi)
        close(R_ab, gtsam.Rot3.Expmap(phi).matrix())
        close(so3.log(R_ab), phi)
        close(so3.right_jacobian(phi), gtsam.Rot3.ExpmapDerivative(phi))
        close(so3.right_jacobian_inverse(phi), gtsam.Rot3.LogmapDerivative(phi))


def test_exp_is_a_homomorphism_about_one_axis() -> None:
    for phi in draws(50, 1.5, 1):
        close(so3.exp(phi) @ so3.exp(0.7 * phi), so3.exp(1.7 * phi))
        close(so3.exp(phi) @ so3.exp(-phi), np.eye(3))
        close(so3.exp(phi) @ phi, phi)
        close(np.array(np.linalg.det(so3.exp(phi))), np.array(1.0))


def test_adjoint_moves_a_perturbation_to_the_other_side() -> None:
    for phi, d in zip(draws(50, 3, 2), draws(50, 3, 3), strict=True):
        R_ab = so3.exp(phi)
        close(R_ab @ so3.exp(d), so3.exp(R_ab @ d) @ R_ab)


def test_right_jacobian_is_the_derivative_of_exp() -> None:
    step = 1e-4
    for phi in draws(100, 6.0, 4):
        R_ab, columns = so3.exp(phi), []
        for axis in np.eye(3):
            ahead, back = (so3.log(R_ab.T @ so3.exp(phi + s * step * axis)) for s in (1, -1))
            columns.append((ahead - back) / (2 * step))
        close(so3.right_jacobian(phi), np.array(columns).T, 1e-8)


def test_right_jacobian_inverse_is_its_inverse() -> None:
    for phi in [*draws(200, 6.0, 5), *VECTORS]:
        close(so3.right_jacobian_inverse(phi) @ so3.right_jacobian(phi), np.eye(3), 1e-11)
        left_inverse = so3.right_jacobian_inverse(-phi)
        close(
            so3.exp(phi) @ so3.right_jacobian_inverse(phi).T, so3.right_jacobian_inverse(phi), 1e-11
        )
        close(left_inverse, so3.right_jacobian_inverse(phi).T)


def test_everything_is_finite_at_pi() -> None:
    for axis in AXES:
        phi = np.pi * axis
        R_ab = so3.exp(phi)
        assert np.isfinite(so3.right_jacobian(phi)).all()
        assert np.isfinite(so3.right_jacobian_inverse(phi)).all()
        back = so3.log(R_ab)  # phi or -phi: the same rotation
        close(np.array(np.linalg.norm(back)), np.array(np.pi))
        close(so3.exp(back), R_ab)
    for diagonal in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1]):
        exact = np.diag(diagonal)
        close(np.abs(so3.log(exact)), np.where(np.array(diagonal) > 0, np.pi, 0.0))


def test_log_near_pi_is_accurate_although_the_trace_is_flat_there() -> None:
    for gap in (1e-3, 1e-6, 1e-9):
        for axis in AXES:
            close(so3.log(so3.exp((np.pi - gap) * axis)), (np.pi - gap) * axis)


def test_quaternion_is_hamilton_scalar_first_with_positive_scalar() -> None:
    angle, axis = 0.8, AXES[2]
    want = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    close(so3.quaternion(so3.exp(angle * axis)), want)
    for phi in draws(300, np.pi, 6):
        R_ab = so3.exp(phi)
        q_wxyz = so3.quaternion(R_ab)
        assert q_wxyz[0] >= 0
        close(np.array(np.linalg.norm(q_wxyz)), np.array(1.0))
        close(so3.from_quaternion(q_wxyz), R_ab)
        close(so3.from_quaternion(-q_wxyz), R_ab)
        close(so3.from_quaternion(3.5 * q_wxyz), R_ab)
        close(gtsam.Rot3(*q_wxyz).matrix(), R_ab)


def test_quaternion_multiplies_as_hamilton_does() -> None:
    """The product of rotations is that of quaternions, in the same order."""

    def product(a: Array, b: Array) -> Array:
        w = a[0] * b[0] - a[1:] @ b[1:]
        return np.array([w, *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])

    for phi, psi in zip(draws(50, 3, 7), draws(50, 3, 8), strict=True):
        A, B = so3.exp(phi), so3.exp(psi)
        close(so3.from_quaternion(product(so3.quaternion(A), so3.quaternion(B))), A @ B)


def test_every_branch_of_the_quaternion_keeps_its_digits() -> None:
    """Shepperd's method: half turns about and near each axis."""
    for i in range(3):
        for gap in (0.0, 1e-8, 1e-3):
            phi = (np.pi - gap) * np.roll([0.8, 0.48, 0.36], i)
            q_wxyz = so3.quaternion(so3.exp(phi))
            close(q_wxyz[1:] / np.sin(0.5 * (np.pi - gap)), phi / (np.pi - gap))
            close(q_wxyz[:1], np.array([np.sin(gap / 2)]))


def test_project_removes_rounding_and_leaves_rotations_alone() -> None:
    rng = np.random.default_rng(9)
    for phi in draws(50, 3, 10):
        R_ab = so3.exp(phi)
        close(so3.project(R_ab), R_ab, 1e-15)
        worn = R_ab + 1e-6 * rng.normal(size=(3, 3))
        mended = so3.project(worn)
        close(mended.T @ mended, np.eye(3), 1e-10)
        u, _, vt = np.linalg.svd(worn)  # the nearest rotation
        close(mended, u @ vt, 1e-10)


def test_vector_helpers_equal_those_of_numpy() -> None:
    rng = np.random.default_rng(11)
    for _ in range(50):
        a, b, m, n = rng.normal(size=3), rng.normal(size=3), *rng.normal(size=(2, 3, 4))
        close(so3.cross(a, b), np.cross(a, b))
        close(so3.skew(a) @ b, np.cross(a, b))
        close(so3.skew(a).T, -so3.skew(a))
        close(dense.transposed_matmul(m, n), m.T @ n)
        close(dense.matmul(m, np.ascontiguousarray(n.T)), m @ n.T)
        close(dense.matvec(np.ascontiguousarray(m.T), a), m.T @ a)
        close(dense.transposed_matvec(m, a), m.T @ a)


def test_stacked_equals_a_list_of_arrays_and_may_be_empty() -> None:
    turns = np.random.default_rng(3).normal(size=(50, 3))
    found = dense.stacked((so3.exp(turn) for turn in turns), 3, 3)
    np.testing.assert_array_equal(found, [so3.exp(turn) for turn in turns])
    assert dense.stacked(iter([]), 3, 3).shape == (0, 3, 3)
