"""Principal axes and ratios of a full inertia: right values, no signs, singular where they are."""

from __future__ import annotations

import numpy as np
import pytest
from relnav_factors.derived.principal_axes import PrincipalAxes, PrincipalRatios
from relnav_factors.shared.inertia import inertia_matrix

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import INERTIA_MATRIX
from relnav_graph.core.contracts import Ambiguous
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track, Truth
from relnav_graph.maths import so3
from relnav_graph.scoring.deviations import errors
from relnav_graph.sim.truths.inertial import inertia_parameters

MOMENTS = np.array([6.0, 8.0, 10.0])


def shape(R: Array) -> Array:
    """k of a body with principal axes R_tp and `MOMENTS`."""
    return inertia_parameters(R @ np.diag(MOMENTS) @ R.T)


@pytest.mark.parametrize("turn", [[0.2, -0.3, 0.4], [0.0, 0.0, 0.0], [1.5, 0.2, -0.7]])
def test_axes_and_ratios_are_those_of_the_body(turn: list[float]) -> None:
    R = so3.exp(np.array(turn))
    k = shape(R)
    axes, _ = PrincipalAxes().value(k)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    J = inertia_matrix(k)[0]
    np.testing.assert_allclose(axes.T @ J @ axes / J.trace(), np.diag(MOMENTS) / 24, atol=1e-12)
    near = PrincipalAxes().nearest(axes[None], R[None])[0]
    np.testing.assert_allclose(near, R, atol=1e-10)
    np.testing.assert_allclose(PrincipalRatios().value(k)[0], [0.6, 0.8], rtol=1e-12)


def test_half_turns_do_not_count() -> None:
    """Axes near a quarter turn from those of t: the signs that are nearest to t differ."""
    R = so3.exp(np.array([0.0, 0.0, np.pi / 2 - 0.01]))
    true = shape(R @ so3.exp(np.array([0.0, 0.0, 0.02])))
    assert isinstance(PrincipalAxes(), Ambiguous)
    layout = Layout([INERTIA_MATRIX])
    track = Track("t", "smoothed", layout, np.zeros(1), shape(R)[None], 1e-6 * np.eye(5)[None])
    truth = Truth(np.zeros(1), {"inertia_matrix_parameters": true[None]})
    found = errors(track, truth, [PrincipalAxes()])["principal_axes"]
    assert np.linalg.norm(found.e) == pytest.approx(0.02, rel=1e-6)


def test_equal_moments_have_no_axes() -> None:
    _, J = PrincipalAxes().value(np.zeros(5))
    assert np.isnan(J).all()
    round_body = inertia_parameters(np.diag([6.0, 6.0, 9.0]))
    _, J = PrincipalAxes().value(round_body)
    assert np.isnan(J[2]).all()  # any turn about the third axis
    assert np.isfinite(J[:2]).all()
    ratios, J = PrincipalRatios().value(round_body)
    np.testing.assert_allclose(ratios, [2 / 3, 2 / 3], rtol=1e-12)
    assert np.isfinite(J).all()
