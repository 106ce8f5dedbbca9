"""Inertia up to its scale: from what stands in the state to what Euler's equations need."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.maths import dense
from relnav_graph.maths.inertia import TRACELESS

#: Largest norm of a matrix of which an exponential is taken, and the squarings that it takes.
_LARGEST, _SQUARINGS = 1024.0, 11


@jit(from_python=True)
def principal_ratios(k: Array) -> tuple[Array, Array]:
    """``l = tanh(k_x, k_y, -(k_x + k_y))``, such as ``l_x = (J_y - J_z) / J_x``.

    k: (2,). Returns l (3,) and its Jacobian (3, 2), all without unit.
    """
    l, jacobian = np.empty(3), np.zeros((3, 2))
    l[0], l[1], l[2] = np.tanh(k[0]), np.tanh(k[1]), -np.tanh(k[0] + k[1])
    jacobian[0, 0] = 1 - l[0] * l[0]
    jacobian[1, 1] = 1 - l[1] * l[1]
    jacobian[2, 0] = jacobian[2, 1] = l[2] * l[2] - 1
    return l, jacobian


@jit
def _exponential(S: Array) -> tuple[Array, Array]:
    """exp(S) of a symmetric (3, 3) matrix and its derivatives along `TRACELESS`, (5, 3, 3):
    Taylor's series of S / 2^m, differentiated term by term, then squared m times.

    NaN where S is so large that exp(S) is beyond floats."""
    size = 0.0
    for i in range(3):
        for j in range(3):
            size += S[i, j] ** 2
    if not size < _LARGEST**2:
        return np.full((3, 3), np.nan), np.full((5, 3, 3), np.nan)
    squarings = 0
    for _ in range(_SQUARINGS):
        if size > 0.25:
            size, squarings = size / 4, squarings + 1
    scale = 0.5**squarings
    small = dense.add_scaled(np.zeros((3, 3)), S, scale)
    out, term = dense.identity(3), dense.identity(3)
    d_out, d_term = np.zeros((5, 3, 3)), np.zeros((5, 3, 3))
    for n in range(1, 15):  # 0.5^15 / 15! is far below rounding
        for a in range(5):
            d = dense.matmul(d_term[a], small)
            d = dense.add_scaled(d, dense.matmul(term, TRACELESS[a]), scale)
            dense.put_block(d_term[a], 0, 0, d, 1.0 / n)
            dense.put_block(d_out[a], 0, 0, dense.add_scaled(d_out[a], d_term[a], 1.0), 1.0)
        term = dense.add_scaled(np.zeros((3, 3)), dense.matmul(term, small), 1.0 / n)
        out = dense.add_scaled(out, term, 1.0)
    for _ in range(squarings):
        for a in range(5):
            d = dense.add_scaled(dense.matmul(d_out[a], out), dense.matmul(out, d_out[a]), 1.0)
            dense.put_block(d_out[a], 0, 0, d, 1.0)
        out = dense.matmul(out, out)
    return out, d_out


@jit
def _inertia_of(density: Array) -> Array:
    """J = tr(D) I - D of the second moments D of the mass, (3, 3)."""
    out = dense.add_scaled(np.zeros((3, 3)), density, -1.0)
    for i in range(3):
        out[i, i] += density[0, 0] + density[1, 1] + density[2, 2]
    return out


@jit
def inertia_matrix(k: Array) -> tuple[Array, Array]:
    """J (3, 3), up to its scale, and its derivatives to k (5,), (5, 3, 3), without unit.

        J = tr(D) I - D,  D = exp(sum of k_a TRACELESS[a])

    Every k is a body: D, the second moment of the mass, is positive definite, which holds for
    inertias of positive mass and for no others (Wensing, Kim, Slotine 2018, section III).
    """
    S = np.zeros((3, 3))
    for a in range(5):
        S = dense.add_scaled(S, TRACELESS[a], k[a])
    density, slope = _exponential(S)
    d_inertia = np.empty((5, 3, 3))
    for a in range(5):
        dense.put_block(d_inertia[a], 0, 0, _inertia_of(slope[a]), 1.0)
    return _inertia_of(density), d_inertia


@jit
def _inverse(J: Array) -> Array:
    """Of a symmetric positive definite (3, 3) matrix, by cofactors."""
    out, determinant = np.empty((3, 3)), 0.0
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            c, d = (j + 1) % 3, (j + 2) % 3
            out[j, i] = J[a, c] * J[b, d] - J[a, d] * J[b, c]
    for j in range(3):
        determinant += J[0, j] * out[j, 0]
    return out / determinant


@jit
def _gyroscopic(J: Array) -> Array:
    """C (3, 6) with w x J w = C (w_x^2, w_y^2, w_z^2, w_y w_z, w_z w_x, w_x w_y)."""
    out = np.zeros((3, 6))
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        out[i, j], out[i, m] = J[j, m], -J[j, m]
        out[i, 3 + i] = J[m, m] - J[j, j]
        out[i, 3 + j], out[i, 3 + m] = -J[i, j], J[i, m]
    return out


@jit
def coefficients_of(J: Array) -> Array:
    """``A = -J^-1 C`` (3, 6) of a known inertia, with ``w x J w = C (w_x^2, ..., w_x w_y)``.

    J: (3, 3), kg m^2 or any other scale. Order of the columns: see `principal_coefficients`.
    """
    return dense.add_scaled(np.zeros((3, 6)), dense.matmul(_inverse(J), _gyroscopic(J)), -1.0)


@jit
def principal_coefficients(k: Array) -> tuple[Array, Array]:
    """``w' = A (w_x^2, w_y^2, w_z^2, w_y w_z, w_z w_x, w_x w_y)`` about principal axes, no torque.

    k: (2,). Returns A (3, 6), which has no unit for w in rad/s, with ``w_x' = l_x w_y w_z`` and
    cyclic, and its derivatives to k, (2, 3, 6).
    """
    A, slope = np.zeros((3, 6)), np.zeros((2, 3, 6))
    l, dl = principal_ratios(k)
    for i in range(3):
        A[i, 3 + i] = l[i]
        for a in range(2):
            slope[a, i, 3 + i] = dl[i, a]
    return A, slope


@jit
def full_coefficients(k: Array) -> tuple[Array, Array]:
    """``A = -J^-1 C`` for a body about any axes, as `principal_coefficients` for principal ones.

    k: (5,), of `inertia_matrix`. Returns A (3, 6), which has no unit for w in rad/s, and its
    derivatives to k, (5, 3, 6).
    """
    J, dJ = inertia_matrix(k)
    slope = np.zeros((5, 3, 6))
    A, minus = coefficients_of(J), dense.add_scaled(np.zeros((3, 3)), _inverse(J), -1.0)
    for a in range(5):  # of J A = -C
        bent = dense.add_scaled(_gyroscopic(dJ[a]), dense.matmul(dJ[a], A), 1.0)
        dense.put_block(slope[a], 0, 0, dense.matmul(minus, bent), 1.0)
    return A, slope
