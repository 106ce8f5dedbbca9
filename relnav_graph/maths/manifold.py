"""Moving on the state manifold: rotations and vectors side by side in one array.

A state is stored as x (size,), nine numbers row by row for a rotation; its tangent vector d
(dim,) has three for a rotation, the right perturbation in rad. `kinds` (blocks, 4) says what
stands where: one row (is_SO3, stored offset, tangent offset, dim) per block.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import INDEX_MATRIX, MATRIX
from relnav_graph.maths import dense, so3


@jit(from_python=True)
def retract(x: Array, d: Array, kinds: Indices) -> Array:
    """``x (+) d``: the state x (size,) moved by a tangent vector d (dim,).

    kinds: one row (is_SO3, stored offset, tangent offset, dim) per block.
    """
    out = x.copy()
    for k in range(kinds.shape[0]):
        so3_block, i, j, n = kinds[k, 0], kinds[k, 1], kinds[k, 2], kinds[k, 3]
        if so3_block:
            turned = dense.matmul(dense.matrix_at(x, i), so3.exp(dense.vector_at(d, j)))
            dense.put_matrix(out, i, so3.project(turned))
        else:
            for m in range(n):
                out[i + m] += d[j + m]
    return out


@jit(from_python=True)
def local(a: Array, b: Array, kinds: Indices, dim: int) -> Array:
    """``d = b (-) a``: the tangent vector d (dim,) with ``a (+) d = b``.

    a, b: states (size,); kinds: (blocks, 4).
    """
    out = np.empty(dim)
    for k in range(kinds.shape[0]):
        so3_block, i, j, n = kinds[k, 0], kinds[k, 1], kinds[k, 2], kinds[k, 3]
        if so3_block:
            turned = dense.transposed_matmul(dense.matrix_at(a, i), dense.matrix_at(b, i))
            dense.put_vector(out, j, so3.log(turned))
        else:
            for m in range(n):
                out[j + m] = b[i + m] - a[i + m]
    return out


@jit
def times_jacobian(a: Array, d: Array, kinds: Indices, inverse: bool) -> None:
    """``a = a J``, for a (m, dim) and the right Jacobian J of the retraction at d (dim,).

    J, or its inverse, is block-diagonal: J_r on attitudes, the identity elsewhere.
    """
    row = np.empty(3)
    for k in range(kinds.shape[0]):
        if kinds[k, 0]:
            j = kinds[k, 2]
            phi = dense.vector_at(d, j)
            block = so3.right_jacobian_inverse(phi) if inverse else so3.right_jacobian(phi)
            for i in range(a.shape[0]):
                for m in range(3):
                    row[m] = 0.0
                    for l in range(3):
                        row[m] += a[i, j + l] * block[l, m]
                dense.put_vector(a[i], j, row)


@jit
def times_transposed_jacobian(a: Array, d: Array, kinds: Indices, inverse: bool) -> None:
    """``a = a J^T``, for a (m, dim) and J as in :func:`times_jacobian`.

    The right Jacobian at -d is the transpose of that at d.
    """
    back = np.empty(d.shape[0])
    for i in range(d.shape[0]):
        back[i] = -d[i]
    times_jacobian(a, back, kinds, inverse)


@jit
def block_jacobian(d: Array, kinds: Indices, inverse: bool) -> Array:
    """The Jacobian J (n, n) of :func:`times_jacobian` at d (n,)."""
    out = dense.identity(d.shape[0])
    times_jacobian(out, d, kinds, inverse)
    return out


@jit_loop(MATRIX, MATRIX, INDEX_MATRIX, MATRIX)
def retract_all(x: Array, d: Array, kinds: Indices, out: Array) -> None:
    """:func:`retract` for each row of x (N, size) and d (N, dim), into out (N, size)."""
    for k in range(x.shape[0]):
        give_way(k)
        dense.put_vector(out[k], 0, retract(x[k], d[k], kinds))


@jit_loop(MATRIX, MATRIX, INDEX_MATRIX, MATRIX)
def local_all(a: Array, b: Array, kinds: Indices, out: Array) -> None:
    """:func:`local` for each row of a and b (N, size), into out (N, dim)."""
    for k in range(a.shape[0]):
        give_way(k)
        dense.put_vector(out[k], 0, local(a[k], b[k], kinds, out.shape[1]))
