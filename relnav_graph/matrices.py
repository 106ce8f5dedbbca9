"""Compiled linear algebra on small matrices, in plain loops over rows.

The inner loops run along rows, so that the compiler vectorises them, and leave out factors
of zero: transition and whitening matrices are sparse by block. Against LAPACK, a call costs
nothing and nothing is allocated. C-contiguous float64 throughout.

Source: Golub and Van Loan 2013, algorithms 3.1.1, 4.2.2 and 5.2.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relnav_graph.compiled import jit, jit_vector

__all__ = [
    "cholesky",
    "householder",
    "inverse_upper",
    "product",
    "sandwich",
    "solve_lower",
    "solve_lower_transposed",
    "symmetrize",
]

Array = NDArray[np.float64]


@jit_vector
def product(a: Array, b: Array, out: Array) -> None:
    """``out = a b``."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
        for l in range(a.shape[1]):
            f = a[i, l]
            if f != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += f * b[l, j]


@jit
def sandwich(F: Array, P: Array, out: Array) -> None:
    """``out = F P F^T`` for a symmetric P, exactly symmetric."""
    n = F.shape[0]
    half, turned = np.empty((n, F.shape[1])), np.empty((F.shape[1], n))
    product(F, P, half)
    for i in range(n):
        for j in range(F.shape[1]):
            turned[j, i] = half[i, j]
    product(F, turned, out)
    symmetrize(out)


@jit
def symmetrize(P: Array) -> None:
    """Remove the asymmetry of rounding."""
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@jit_vector
def cholesky(a: Array) -> bool:
    """Replace a symmetric matrix by its lower Cholesky factor; False unless it is positive
    definite."""
    n = a.shape[0]
    for j in range(n):
        for l in range(j):
            f = a[j, l]
            if f != 0.0:
                for i in range(j, n):
                    a[i, j] -= f * a[i, l]
        if not a[j, j] > 0.0:
            return False
        pivot = np.sqrt(a[j, j])
        for i in range(j, n):
            a[i, j] /= pivot
        for i in range(j):
            a[i, j] = 0.0
    return True


@jit_vector
def solve_lower(L: Array, b: Array) -> None:
    """``b = L^-1 b`` for a lower triangular L."""
    for i in range(L.shape[0]):
        for l in range(i):
            f = L[i, l]
            if f != 0.0:
                for j in range(b.shape[1]):
                    b[i, j] -= f * b[l, j]
        f = 1.0 / L[i, i]
        for j in range(b.shape[1]):
            b[i, j] *= f


@jit_vector
def solve_lower_transposed(L: Array, b: Array) -> None:
    """``b = L^-T b`` for a lower triangular L."""
    for i in range(L.shape[0] - 1, -1, -1):
        f = 1.0 / L[i, i]
        for j in range(b.shape[1]):
            b[i, j] *= f
        for l in range(i):
            f = L[i, l]
            if f != 0.0:
                for j in range(b.shape[1]):
                    b[l, j] -= f * b[i, j]


@jit_vector
def inverse_upper(R: Array) -> Array:
    """Inverse of an upper triangular matrix."""
    n = R.shape[0]
    out = np.zeros((n, n))
    for i in range(n - 1, -1, -1):
        f = 1.0 / R[i, i]
        out[i, i] = f
        for l in range(i + 1, n):
            g = f * R[i, l]
            if g != 0.0:
                for j in range(l, n):
                    out[i, j] -= g * out[l, j]
    return out


@jit_vector
def householder(a: Array, columns: int, below: int, rows: int, width: int) -> None:
    """Triangularise the first columns of ``a[:rows, :width]`` by reflections, in place.

    below: rows from the diagonal down to this one are known to be zero there already.
    """
    w = np.empty(width)
    for j in range(columns):
        first = max(j + 1, below)
        s = 0.0
        for i in range(first, rows):
            s += a[i, j] * a[i, j]
        if s == 0.0:
            continue
        pivot = a[j, j]
        length = np.sqrt(pivot * pivot + s)
        if pivot > 0.0:
            length = -length
        v = pivot - length
        for c in range(j + 1, width):
            w[c] = v * a[j, c]
        for i in range(first, rows):
            f = a[i, j]
            if f != 0.0:
                for c in range(j + 1, width):
                    w[c] += f * a[i, c]
        scale = 2.0 / (v * v + s)
        for c in range(j + 1, width):
            w[c] *= scale
            a[j, c] -= v * w[c]
        a[j, j] = length
        for i in range(first, rows):
            f = a[i, j]
            if f != 0.0:
                for c in range(j + 1, width):
                    a[i, c] -= f * w[c]
                a[i, j] = 0.0
