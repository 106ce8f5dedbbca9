"""Reflections: triangles, against NumPy's, narrow and wide ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.maths.reflections import SPARE, householder, householder_blocked, room


@jit(from_python=True)
def _plain(a: Array, columns: int, below: int, rows: int, width: int) -> None:
    householder(a, columns, below, rows, width)


@jit(from_python=True)
def _blocked(a: Array, columns: int, below: int, rows: int, width: int) -> None:
    householder_blocked(a, columns, below, rows, width, np.empty(room(columns, rows, width)))


@pytest.mark.parametrize("width", [9, 13, 60, 171])
@pytest.mark.parametrize("reflect", [_plain, _blocked])
def test_the_triangle_is_that_of_a_qr_decomposition(
    reflect: Callable[..., None], width: int
) -> None:
    """R of A = Q R, up to the signs of its rows; what is beside it keeps its products."""
    rng, rows, columns = np.random.default_rng(width), 25, 8
    A = rng.standard_normal((rows, width))
    A[12:, 3:6] = 0.0  # rows and columns that begin late
    a = np.hstack([A, np.zeros((rows, SPARE))])
    reflect(a, columns, 0, rows, width)
    got = a[:, :width]
    R = np.linalg.qr(A[:, :columns])[1]
    np.testing.assert_array_equal(np.tril(got[:, :columns], -1), 0.0)
    np.testing.assert_allclose(np.abs(got[:columns, :columns]), np.abs(R), atol=1e-13)
    np.testing.assert_allclose(got.T @ got, A.T @ A, atol=1e-12)


def test_rows_that_are_zero_below_the_diagonal_are_left_alone() -> None:
    """`below`: what stands between the diagonal and these rows is not looked at."""
    rng, n, width = np.random.default_rng(0), 6, 60
    top = np.triu(rng.standard_normal((n, width)))
    A = np.vstack([top, rng.standard_normal((5, width))])
    plain, blocked = (np.hstack([A, np.zeros((len(A), SPARE))]) for _ in range(2))
    _plain(plain, n, n, len(A), width)
    _blocked(blocked, n, n, len(A), width)
    np.testing.assert_allclose(blocked[:, :width], plain[:, :width], atol=1e-13)
