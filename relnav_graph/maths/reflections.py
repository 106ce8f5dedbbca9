"""Compiled orthogonal reflections: the first columns of a matrix brought to triangular form.

    H = I - scale v v^T,  v = x - length e,  scale = 2 / (v^T v),  H x = length e

Source: Householder 1958; Golub and Van Loan 2013, algorithm 5.2.1.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit

__all__ = ["SPARE", "WIDE", "householder", "householder_blocked", "room"]


#: Columns that `householder` wants beyond the last one.
SPARE = 3
#: Columns beside the triangle from which on `householder_blocked` is the faster one.
WIDE = 40


@jit(vectorize="columns")
def _reflect(
    a: Array, columns: int, below: int, rows: int, width: int, V: Array, scales: Array
) -> None:
    """:func:`householder`, which keeps the reflections: v_j in V[j] (columns, rows), its zeros left
    as they are, and 2 / (v_j^T v_j) in scales (columns,), 0 for none. With V of (0, 0), none are
    kept."""
    end, at, f = np.empty(rows, np.int64), np.empty(rows, np.int64), np.empty(rows)
    keep = V.shape[0] > 0
    for i in range(rows):
        end[i] = width
        while end[i] > 0 and a[i, end[i] - 1] == 0.0:
            end[i] -= 1
    for j in range(columns):
        last, count, total = end[j], 0, 0.0
        for i in range(max(j + 1, below), rows):
            if a[i, j] != 0.0:
                at[count], f[count] = i, a[i, j]
                count += 1
                total += a[i, j] * a[i, j]
                a[i, j], last = 0.0, max(last, end[i])
        if total == 0.0:
            continue
        pivot = a[j, j]
        length = np.sqrt(pivot * pivot + total)
        if pivot > 0.0:
            length = -length
        v = pivot - length
        scale = 2.0 / (v * v + total)
        a[j, j], end[j] = length, last
        for l in range(count):
            end[at[l]] = last
        if keep:
            scales[j], V[j, j] = scale, v
            for l in range(count):
                V[j, at[l]] = f[l]
        c = j + 1
        while c + 4 < last:
            w, x, y, z = v * a[j, c], v * a[j, c + 1], v * a[j, c + 2], v * a[j, c + 3]
            p, q, s, t = v * a[j, c + 4], v * a[j, c + 5], v * a[j, c + 6], v * a[j, c + 7]
            for l in range(count):
                i = at[l]
                w += f[l] * a[i, c]
                x += f[l] * a[i, c + 1]
                y += f[l] * a[i, c + 2]
                z += f[l] * a[i, c + 3]
                p += f[l] * a[i, c + 4]
                q += f[l] * a[i, c + 5]
                s += f[l] * a[i, c + 6]
                t += f[l] * a[i, c + 7]
            w, x, y, z = scale * w, scale * x, scale * y, scale * z
            p, q, s, t = scale * p, scale * q, scale * s, scale * t
            a[j, c] -= v * w
            a[j, c + 1] -= v * x
            a[j, c + 2] -= v * y
            a[j, c + 3] -= v * z
            a[j, c + 4] -= v * p
            a[j, c + 5] -= v * q
            a[j, c + 6] -= v * s
            a[j, c + 7] -= v * t
            for l in range(count):
                i = at[l]
                a[i, c] -= f[l] * w
                a[i, c + 1] -= f[l] * x
                a[i, c + 2] -= f[l] * y
                a[i, c + 3] -= f[l] * z
                a[i, c + 4] -= f[l] * p
                a[i, c + 5] -= f[l] * q
                a[i, c + 6] -= f[l] * s
                a[i, c + 7] -= f[l] * t
            c += 8
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


@jit
def householder(a: Array, columns: int, below: int, rows: int, width: int) -> None:
    """Triangularise the first columns of ``a[:rows, :width]`` by reflections, in place.

    below: rows from the diagonal down to this one are known to be zero there already. A
    reflection leaves out the rows that are zero in its column, and the columns in which none
    of its rows has begun; the sums of eight columns stay in registers. The `SPARE` columns
    after `width` are spoilt: there must be as many.
    """
    _reflect(a, columns, below, rows, width, np.empty((0, 0)), np.empty(0))


@jit
def room(columns: int, rows: int, width: int) -> int:
    """How many numbers `householder_blocked` wants to work with."""
    return rows * (columns + SPARE) + 2 * columns * (rows + columns) + (rows + 2 * columns) * width


@jit(vectorize="loops")
def householder_blocked(
    a: Array, columns: int, below: int, rows: int, width: int, work: Array
) -> None:
    """:func:`householder` for wide matrices: all reflections applied to the columns beside the
    triangle at once, by BLAS (Schreiber and Van Loan 1989).

        H_n ... H_1 = I - V L V^T,  L lower triangular,  L_jj = scale_j,
        L_j,:j = -scale_j v_j^T V_:j L_:j,:j

    work: (`room`,), spoilt; its arrays stand one after the other.
    """
    beside, at = width - columns, 0
    panel = work[at : at + rows * (columns + SPARE)].reshape(rows, columns + SPARE)
    at += rows * (columns + SPARE)
    Vt = work[at : at + columns * rows].reshape(columns, rows)
    at += columns * rows
    V = work[at : at + rows * columns].reshape(rows, columns)
    at += rows * columns
    G = work[at : at + columns * columns].reshape(columns, columns)
    at += columns * columns
    L = work[at : at + columns * columns].reshape(columns, columns)
    at += columns * columns
    rest = work[at : at + rows * beside].reshape(rows, beside)
    at += rows * beside
    first = work[at : at + columns * beside].reshape(columns, beside)
    at += columns * beside
    second = work[at : at + columns * beside].reshape(columns, beside)
    scales = np.zeros(columns)
    for j in range(columns):
        for i in range(rows):
            Vt[j, i] = 0.0
        for l in range(columns):
            L[j, l] = 0.0
    for i in range(rows):
        for j in range(columns):
            panel[i, j] = a[i, j]
        for j in range(beside):
            rest[i, j] = a[i, columns + j]
    _reflect(panel, columns, below, rows, columns, Vt, scales)
    for i in range(rows):
        for j in range(columns):
            a[i, j] = panel[i, j]
            V[i, j] = Vt[j, i]
    np.dot(Vt, V, G)
    for j in range(columns):
        L[j, j] = scales[j]
        for l in range(j):
            g = -scales[j] * G[j, l]
            for q in range(l + 1):
                L[j, q] += g * L[l, q]
    np.dot(Vt, rest, first)
    np.dot(L, first, second)
    np.dot(V, second, rest)
    for i in range(rows):
        for j in range(beside):
            a[i, columns + j] -= rest[i, j]
