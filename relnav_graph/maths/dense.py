"""Compiled linear algebra on small vectors and matrices, in plain loops over rows.

The inner loops run along rows, so that the compiler vectorises them, and leave out factors
of zero: transition and whitening matrices are sparse by block. Against LAPACK, a call costs
nothing and nothing is allocated. C-contiguous float64 throughout.

Source: Golub and Van Loan 2013, algorithms 3.1.1 and 4.2.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit

__all__ = [
    "add_scaled",
    "add_scaled_vector",
    "cholesky",
    "column_squares",
    "copy",
    "identity",
    "inverse_upper",
    "matmul",
    "matmul_into",
    "matrix_at",
    "matvec",
    "norm",
    "part_of",
    "propagate_covariance",
    "put_block",
    "put_matrix",
    "put_vector",
    "sandwich",
    "scaled_cholesky",
    "solve_lower",
    "solve_lower_transposed",
    "stacked",
    "sum_of_squares",
    "symmetrize",
    "transpose_in_place",
    "transposed_matmul",
    "transposed_matvec",
    "vector_at",
]


@jit(vectorize="columns")
def matmul_into(a: Array, b: Array, out: Array) -> None:
    """``out = a b``, for a (m, k), b (k, n), out (m, n)."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
        for l in range(a.shape[1]):
            f = a[i, l]
            if f == 0.0:
                continue
            j = 0
            while j + 3 < b.shape[1]:
                w, x = out[i, j] + f * b[l, j], out[i, j + 1] + f * b[l, j + 1]
                y, z = out[i, j + 2] + f * b[l, j + 2], out[i, j + 3] + f * b[l, j + 3]
                out[i, j], out[i, j + 1], out[i, j + 2], out[i, j + 3] = w, x, y, z
                j += 4
            while j < b.shape[1]:
                out[i, j] += f * b[l, j]
                j += 1


@jit
def sandwich(F: Array, P: Array, out: Array) -> None:
    """``out = F P F^T``, exactly symmetric, for F (m, n), a symmetric P (n, n), out (m, m)."""
    n = F.shape[0]
    half, turned = np.empty((n, F.shape[1])), np.empty((F.shape[1], n))
    matmul_into(F, P, half)
    for i in range(n):
        for j in range(F.shape[1]):
            turned[j, i] = half[i, j]
    matmul_into(F, turned, out)
    symmetrize(out)


@jit
def transpose_in_place(a: Array) -> None:
    """``a = a^T``, for a square matrix (n, n)."""
    for i in range(a.shape[0]):
        for j in range(i):
            a[i, j], a[j, i] = a[j, i], a[i, j]


@jit
def symmetrize(P: Array) -> None:
    """``P = (P + P^T) / 2``, for P (n, n): removes the asymmetry of rounding."""
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@jit(vectorize="loops")
def cholesky(a: Array) -> bool:
    """Replace a symmetric a (n, n) by L, ``L L^T = a``; False unless positive definite."""
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


@jit
def scaled_cholesky(P: Array, scale: Array, L: Array) -> bool:
    """``P = diag(scale) L L^T diag(scale)``, all (n, n) but scale (n,): sigmas, and the lower
    factor of the correlations. False unless P is positive definite.
    """
    for i in range(P.shape[0]):
        scale[i] = np.sqrt(P[i, i])
    for i in range(P.shape[0]):
        for j in range(P.shape[0]):
            L[i, j] = P[i, j] / (scale[i] * scale[j])
    return cholesky(L)


@jit(vectorize="loops")
def solve_lower(L: Array, b: Array) -> None:
    """``b = L^-1 b``, for a lower triangular L (n, n) and b (n, m)."""
    for i in range(L.shape[0]):
        for l in range(i):
            f = L[i, l]
            if f != 0.0:
                for j in range(b.shape[1]):
                    b[i, j] -= f * b[l, j]
        f = 1.0 / L[i, i]
        for j in range(b.shape[1]):
            b[i, j] *= f


@jit(vectorize="loops")
def solve_lower_transposed(L: Array, b: Array) -> None:
    """``b = L^-T b``, for a lower triangular L (n, n) and b (n, m)."""
    for i in range(L.shape[0] - 1, -1, -1):
        f = 1.0 / L[i, i]
        for j in range(b.shape[1]):
            b[i, j] *= f
        for l in range(i):
            f = L[i, l]
            if f != 0.0:
                for j in range(b.shape[1]):
                    b[l, j] -= f * b[i, j]


@jit(vectorize="loops")
def inverse_upper(R: Array) -> Array:
    """``R^-1`` (n, n) of an upper triangular matrix R (n, n)."""
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


def stacked(arrays: Iterable[Array], *shape: int) -> Array:
    """Arrays of one shape, made one after the other and never side by side, as (N, ...)."""
    return np.fromiter(arrays, dtype=np.dtype((np.float64, shape)))


@jit
def part_of(a: Array, chosen: Indices) -> Array:
    """The rows and columns `chosen` (k,) of a (n, n), as (k, k)."""
    out = np.empty((chosen.shape[0], chosen.shape[0]))
    for i in range(chosen.shape[0]):
        for j in range(chosen.shape[0]):
            out[i, j] = a[chosen[i], chosen[j]]
    return out


@jit
def identity(n: int) -> Array:
    """Unit matrix (n, n)."""
    out = np.zeros((n, n))
    for i in range(n):
        out[i, i] = 1.0
    return out


@jit
def matrix_at(x: Array, start: int) -> Array:
    """The (3, 3) matrix whose rows stand in x from `start` on."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = x[start + 3 * i + j]
    return out


@jit
def vector_at(x: Array, start: int) -> Array:
    """The (3,) vector that stands in x from `start` on."""
    out = np.empty(3)
    for i in range(3):
        out[i] = x[start + i]
    return out


@jit
def put_matrix(x: Array, start: int, matrix: Array) -> None:
    """Write a (3, 3) matrix into x, row by row, from `start` on."""
    for i in range(3):
        for j in range(3):
            x[start + 3 * i + j] = matrix[i, j]


@jit
def put_vector(x: Array, start: int, v: Array) -> None:
    """Write a vector v (n,) into x (m,), from `start` on."""
    for i in range(v.shape[0]):
        x[start + i] = v[i]


@jit
def put_block(out: Array, row: int, column: int, block: Array, factor: float) -> None:
    """Write ``factor block`` into a matrix, its upper left corner at (row, column)."""
    for i in range(block.shape[0]):
        for j in range(block.shape[1]):
            out[row + i, column + j] = factor * block[i, j]


@jit
def add_scaled(a: Array, b: Array, factor: float) -> Array:
    """``a + factor b`` of two matrices (m, n)."""
    out = np.empty((a.shape[0], a.shape[1]))
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j] + factor * b[i, j]
    return out


@jit
def add_scaled_vector(a: Array, b: Array, factor: float) -> Array:
    """``a + factor b`` of two vectors (n,)."""
    out = np.empty(a.shape[0])
    for i in range(a.shape[0]):
        out[i] = a[i] + factor * b[i]
    return out


@jit
def propagate_covariance(F: Array, P: Array) -> Array:
    """``F P F^T`` (m, m), for F (m, n) and a symmetric P (n, n)."""
    out = np.empty((F.shape[0], F.shape[0]))
    sandwich(F, P, out)
    return out


@jit
def matmul(a: Array, b: Array) -> Array:
    """Product of two small matrices, (m, k) by (k, n); cheaper than a BLAS call."""
    out = np.empty((a.shape[0], b.shape[1]))
    matmul_into(a, b, out)
    return out


@jit
def transposed_matmul(a: Array, b: Array) -> Array:
    """``a^T b`` of small matrices, (k, m) and (k, n)."""
    k, m, n = a.shape[0], a.shape[1], b.shape[1]
    out = np.zeros((m, n))
    for l in range(k):
        for i in range(m):
            f = a[l, i]
            for j in range(n):
                out[i, j] += f * b[l, j]
    return out


@jit
def matvec(matrix: Array, v: Array) -> Array:
    """``matrix v`` for a (m, k) matrix and a (k,) vector."""
    m, k = matrix.shape
    out = np.zeros(m)
    for i in range(m):
        for j in range(k):
            out[i] += matrix[i, j] * v[j]
    return out


@jit
def transposed_matvec(matrix: Array, v: Array) -> Array:
    """``matrix^T v`` for a (k, m) matrix and a (k,) vector."""
    k, m = matrix.shape
    out = np.zeros(m)
    for i in range(k):
        for j in range(m):
            out[j] += matrix[i, j] * v[i]
    return out


@jit
def norm(v: Array) -> float:
    """Length ``|v|`` of a vector (n,)."""
    s = 0.0
    for i in range(v.shape[0]):
        s += v[i] * v[i]
    return math.sqrt(s)


@jit
def copy(a: Array, out: Array) -> None:
    """``out = a``, both (m, n)."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j]


@jit
def sum_of_squares(v: Array) -> float:
    """``v^T v`` of a vector (n,)."""
    out = 0.0
    for i in range(v.shape[0]):
        out += v[i] * v[i]
    return out


@jit
def column_squares(a: Array, first: int, column: int) -> float:
    """The sum of squares of one column of a (m, n), from the row `first` on."""
    out = 0.0
    for i in range(first, a.shape[0]):
        out += a[i, column] * a[i, column]
    return out
