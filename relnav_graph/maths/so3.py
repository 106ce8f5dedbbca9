"""Rotations: exponential, logarithm, Jacobians, quaternions.

Matrices are active (``R_ab`` takes b-components to a-components). Perturbations act on
the right, ``R Exp(d)``, with d in the right-hand frame in radians: GTSAM's ``retract``.
All functions take and return C-contiguous float64 and are compiled. They are
written in plain loops over small arrays: array expressions and slices take numba many times as
long to compile, and run no faster.

Sources: Sola, Deray, Atchuthan 2018 (arXiv:1812.01537), eqs. 132-147; Chirikjian 2012.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.maths.dense import matmul, norm, transposed_matmul

# Below this angle (rad) the coefficients come from their series, which are exact to rounding
# there. The closed form (t - sin t) / t^3 has a relative error of about eps / t^2.
_SERIES = 0.3


@jit
def cross(a: Array, b: Array) -> Array:
    """``a x b``: the vector product. a, b: (3,), in one frame. Returns (3,)."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@jit
def put_cross(out: Array, row: int, column: int, a: Array, b: Array, factor: float) -> None:
    """Write ``factor a x b`` into one row of a matrix, from `column` on.

    out: (m, n); a, b: (3,), in one frame.
    """
    out[row, column] = factor * (a[1] * b[2] - a[2] * b[1])
    out[row, column + 1] = factor * (a[2] * b[0] - a[0] * b[2])
    out[row, column + 2] = factor * (a[0] * b[1] - a[1] * b[0])


@jit
def skew(v: Array) -> Array:
    """``[v x]``, the matrix of the vector product: ``skew(a) b = a x b``.

    v: (3,). Returns (3, 3), in the unit of v.
    """
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]
    return out


@jit
def _quadratic(v: Array, a: float, b: float) -> Array:
    """``I + a [v x] + b [v x]^2``, with ``[v x]^2 = v v^T - |v|^2 I`` written out.

    v: (3,). Returns (3, 3).
    """
    s = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = b * v[i] * v[j]
        out[i, i] += 1.0 - b * s
    out[0, 1] -= a * v[2]
    out[0, 2] += a * v[1]
    out[1, 2] -= a * v[0]
    out[1, 0] += a * v[2]
    out[2, 0] -= a * v[1]
    out[2, 1] += a * v[0]
    return out


@jit
def _coefficients(t: float) -> tuple[float, float, float]:
    """``sin t / t``, ``(1 - cos t) / t^2``, ``(t - sin t) / t^3`` of an angle t >= 0 in rad."""
    s = t * t
    if t < _SERIES:
        a = 1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110))))
        b = 0.5 * (1 - s / 12 * (1 - s / 30 * (1 - s / 56 * (1 - s / 90 * (1 - s / 132)))))
        c = (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110 * (1 - s / 156))))) / 6
        return a, b, c
    half = np.sin(0.5 * t)
    return np.sin(t) / t, 2 * half * half / s, (t - np.sin(t)) / (s * t)


@jit(from_python=True)
def exp(phi: Array) -> Array:
    """Rotation matrix (3, 3) of the rotation vector `phi` (3,) in rad (Rodrigues)."""
    a, b, _ = _coefficients(norm(phi))
    return _quadratic(phi, a, b)


@jit(from_python=True)
def quaternion(matrix: Array) -> Array:
    """Hamilton quaternion ``q_wxyz``, w >= 0, of a rotation matrix (Shepperd 1978).

    matrix: (3, 3). Returns (4,), scalar first, of length 1.
    """
    m = matrix
    q = np.empty(4)
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    k = -1
    best = trace
    for i in range(3):
        if m[i, i] > best:
            best = m[i, i]
            k = i
    if k < 0:
        q[0] = 1 + trace
        q[1], q[2], q[3] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    else:
        i, j = (k + 1) % 3, (k + 2) % 3
        q[0] = m[j, i] - m[i, j]
        q[1 + k] = 1 + 2 * m[k, k] - trace
        q[1 + i] = m[i, k] + m[k, i]
        q[1 + j] = m[j, k] + m[k, j]
    scale = (1.0 if q[0] >= 0 else -1.0) / norm(q)
    for i in range(4):
        q[i] *= scale
    return q


@jit(from_python=True)
def from_quaternion(q_wxyz: Array) -> Array:
    """Rotation matrix of a Hamilton quaternion, which need not have length 1.

    q_wxyz: (4,), scalar first. Returns (3, 3).
    """
    n = norm(q_wxyz)
    v = np.empty(3)
    for i in range(3):
        v[i] = q_wxyz[1 + i] / n
    return _quadratic(v, 2 * q_wxyz[0] / n, 2.0)


@jit
def log(matrix: Array) -> Array:
    """Rotation vector of a rotation matrix, of length at most pi rad.

    matrix: (3, 3). Returns (3,), rad. The way over the quaternion keeps all digits near 0 and
    near pi, where the formula with the trace loses half of them.
    """
    q = quaternion(matrix)
    n = norm(q[1:])
    stretch = 2.0 / q[0] if n < 1e-12 else 2 * np.arctan2(n, q[0]) / n
    v = np.empty(3)
    for i in range(3):
        v[i] = stretch * q[1 + i]
    return v


@jit
def right_jacobian(phi: Array) -> Array:
    """``J_r`` (3, 3): ``Exp(phi + d) = Exp(phi) Exp(J_r d)`` to first order; phi (3,) in rad."""
    _, b, c = _coefficients(norm(phi))
    return _quadratic(phi, -b, c)


@jit
def right_jacobian_inverse(phi: Array) -> Array:
    """Inverse (3, 3) of :func:`right_jacobian` at phi (3,) in rad; finite below 2 pi rad."""
    t = norm(phi)
    s = t * t
    if t < _SERIES:
        c = (1 + s / 60 * (1 + s / 42 * (1 + s / 40 * (1 + s / 39.6)))) / 12
    else:
        c = (1 - 0.5 * t / np.tan(0.5 * t)) / s
    return _quadratic(phi, 0.5, c)


@jit
def project(matrix: Array) -> Array:
    """The rotation nearest to `matrix`, to first order in the distance.

    matrix: (3, 3), a rotation but for rounding errors. Returns (3, 3).

    One Newton step of the polar decomposition, ``M (3 I - M^T M) / 2``, which keeps rounding
    errors from growing in products of many rotations.
    """
    correction = transposed_matmul(matrix, matrix)
    for i in range(3):
        for j in range(3):
            correction[i, j] = (1.5 if i == j else 0.0) - 0.5 * correction[i, j]
    return matmul(matrix, correction)
