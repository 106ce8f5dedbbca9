"""Directions: unit vectors, and the residual on the sphere that all that measure one share."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.maths import dense, so3

#: What a status of 1 of :func:`sphere_residual` means.
OPPOSITE = 1


@jit
def direction(p: Array, jacobian: Array) -> tuple[Array, float]:
    """Unit vector ``b = p / |p|`` and the length ``|p|``.

    p: (3,), m; jacobian: of p, (3, n); becomes that of b, in place: ``(I - b b^T) dp / |p|``.
    Returns b (3,) and the length, m.
    """
    distance = dense.norm(p)
    b = np.empty(3)
    for i in range(3):
        b[i] = p[i] / distance
    for j in range(jacobian.shape[1]):
        along = b[0] * jacobian[0, j] + b[1] * jacobian[1, j] + b[2] * jacobian[2, j]
        for i in range(3):
            jacobian[i, j] = (jacobian[i, j] - along * b[i]) / distance
    return b, distance


@jit
def tangent_basis(b: Array) -> Array:
    """Two orthogonal unit vectors across the unit vector b.

    b: (3,). Returns them as the columns of a (3, 2) matrix, without unit.
    """
    smallest = 0
    for i in range(1, 3):
        if abs(b[i]) < abs(b[smallest]):
            smallest = i
    axis = np.zeros(3)
    axis[smallest] = 1.0
    first = so3.cross(b, axis)
    length, second = dense.norm(first), so3.cross(b, first)
    out = np.empty((3, 2))
    for i in range(3):
        out[i, 0], out[i, 1] = first[i] / length, second[i] / length
    return out


@jit
def turned(lines: Array, e: Array) -> Array:
    """Unit vectors, each turned by a rotation across it.

    lines: (k, 3); e: (k, 2), rad, how far it moves along each column of `tangent_basis`. Returns
    (k, 3).
    """
    out = np.empty(lines.shape)
    for k in range(lines.shape[0]):
        basis = tangent_basis(lines[k])
        angle = dense.norm(e[k])
        stretch = np.sin(angle) / angle if angle > 0.0 else 1.0
        for i in range(3):
            step = basis[i, 0] * e[k, 0] + basis[i, 1] * e[k, 1]
            out[k, i] = np.cos(angle) * lines[k, i] + stretch * step
    return out


@jit
def sphere_residual(z: Array, b: Array, db: Array, row: int, r: Array, H: Array) -> int:
    """Fill two rows of r and H with the rotation from z to b, resolved across z.

    z: measured unit vector (3,); b: predicted one (3,); db: Jacobian of b, (3, n). Fills
    ``r[row : row + 2]``, rad, and the same rows of H, (2, n). Returns `OPPOSITE` when b is opposite
    to z, else 0.

        r = angle / sin(angle) B^T b,  angle between z and b, B = tangent_basis(z)

    This is the logarithm on the sphere: two numbers, so that its noise has full rank.
    """
    basis = tangent_basis(z)
    across = dense.transposed_matvec(basis, b)
    c = z[0] * b[0] + z[1] * b[1] + z[2] * b[2]
    s = dense.norm(across)
    angle = np.arctan2(s, c)
    if angle > 3.14:
        return OPPOSITE
    if angle < 0.05:  # series of angle / sin and of its derivative by cos, to 1e-10
        a2 = angle * angle
        stretch = 1 + a2 / 6 * (1 + 7 * a2 / 60)
        slope = -1 / 3.0 - 2 * a2 / 15 - 2 * a2 * a2 / 63
    else:
        stretch = angle / s
        slope = -(s - angle * c) / s**3
    for i in range(2):
        r[row + i] = stretch * across[i]
        for j in range(db.shape[1]):
            cos_j = z[0] * db[0, j] + z[1] * db[1, j] + z[2] * db[2, j]
            value = slope * across[i] * cos_j
            for k in range(3):
                value += stretch * basis[k, i] * db[k, j]
            H[row + i, j] = value
    return 0
