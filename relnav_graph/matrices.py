"""Compiled linear algebra on small matrices, in plain loops over rows.

The inner loops run along rows, so that the compiler vectorises them, and leave out factors
of zero: transition and whitening matrices are sparse by block. Against LAPACK, a call costs
nothing and nothing is allocated. C-contiguous float64 throughout.

Source: Golub and Van Loan 2013, algorithms 3.1.1, 4.2.2 and 5.2.1.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit

__all__ = [
    "SPARE",
    "cholesky",
    "householder",
    "inverse_upper",
    "product",
    "sandwich",
    "scaled_cholesky",
    "solve_lower",
    "solve_lower_transposed",
    "symmetrize",
    "transpose",
]


#: Columns that `householder` wants beyond the last one.
SPARE = 3


@jit(vectorize="columns")
def product(a: Array, b: Array, out: Array) -> None:
    """``out = a b``."""
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
def transpose(a: Array) -> None:
    """``a = a^T``, for a square matrix."""
    for i in range(a.shape[0]):
        for j in range(i):
            a[i, j], a[j, i] = a[j, i], a[i, j]


@jit
def symmetrize(P: Array) -> None:
    """Remove the asymmetry of rounding."""
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@jit(vectorize="loops")
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


@jit
def scaled_cholesky(P: Array, scale: Array, L: Array) -> bool:
    """L of the correlation matrix of P, and the sigmas; False unless positive definite."""
    for i in range(P.shape[0]):
        scale[i] = np.sqrt(P[i, i])
    for i in range(P.shape[0]):
        for j in range(P.shape[0]):
            L[i, j] = P[i, j] / (scale[i] * scale[j])
    return cholesky(L)


@jit(vectorize="loops")
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


@jit(vectorize="loops")
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


@jit(vectorize="loops")
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


@jit(vectorize="columns")
def householder(a: Array, columns: int, below: int, rows: int, width: int) -> None:
    """Triangularise the first columns of ``a[:rows, :width]`` by reflections, in place.

    below: rows from the diagonal down to this one are known to be zero there already. A
    reflection leaves out the rows that are zero in its column, and the columns in which none
    of its rows has begun; the sums of four columns stay in registers. The `SPARE` columns
    after `width` are spoilt: there must be as many.
    """
    end, at, f = np.empty(rows, np.int64), np.empty(rows, np.int64), np.empty(rows)
    for i in range(rows):
        end[i] = width
        while end[i] > 0 and a[i, end[i] - 1] == 0.0:
            end[i] -= 1
    for j in range(columns):
        last, count, s = end[j], 0, 0.0
        for i in range(max(j + 1, below), rows):
            if a[i, j] != 0.0:
                at[count], f[count] = i, a[i, j]
                count += 1
                s += a[i, j] * a[i, j]
                a[i, j], last = 0.0, max(last, end[i])
        if s == 0.0:
            continue
        pivot = a[j, j]
        length = np.sqrt(pivot * pivot + s)
        if pivot > 0.0:
            length = -length
        v = pivot - length
        scale = 2.0 / (v * v + s)
        a[j, j], end[j] = length, last
        for l in range(count):
            end[at[l]] = last
        c = j + 1
        while c < last:
            w, x, y, z = v * a[j, c], v * a[j, c + 1], v * a[j, c + 2], v * a[j, c + 3]
            for l in range(count):
                i = at[l]
                w += f[l] * a[i, c]
                x += f[l] * a[i, c + 1]
                y += f[l] * a[i, c + 2]
                z += f[l] * a[i, c + 3]
            w, x, y, z = scale * w, scale * x, scale * y, scale * z
            a[j, c] -= v * w
            a[j, c + 1] -= v * x
            a[j, c + 2] -= v * y
            a[j, c + 3] -= v * z
            for l in range(count):
                i = at[l]
                a[i, c] -= f[l] * w
                a[i, c + 1] -= f[l] * x
                a[i, c + 2] -= f[l] * y
                a[i, c + 3] -= f[l] * z
            c += 4
