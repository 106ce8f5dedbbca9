"""Compiled: what a filter did not foresee, its covariance, and the gate that it must pass.

Rows are whitened: the covariance of the measurement noise is the unit matrix.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.linear.tables import Tables, rows_of
from relnav_graph.linear.update import least_squares
from relnav_graph.maths.dense import (
    cholesky,
    column_squares,
    matmul_into,
    scaled_cholesky,
    solve_lower,
)
from relnav_graph.maths.reflections import SPARE

__all__ = ["gate", "innovation_covariance", "misfit"]


@jit
def innovation_covariance(H: Array, P: Array, S: Array) -> None:
    """``S = H P H^T + I``, symmetric, for H (rows, n), P (n, n), S (rows, rows)."""
    HP = np.empty((H.shape[0], H.shape[1]))
    matmul_into(H, P, HP)
    for i in range(H.shape[0]):
        for j in range(i + 1):
            value = 1.0 if i == j else 0.0
            for l in range(H.shape[1]):
                value += HP[i, l] * H[j, l]
            S[i, j] = S[j, i] = value


@jit
def gate(
    tables: Tables,
    S: Array,
    r: Array,
    limit: Array,
    losses: Array,
    first: int,
    weight: Array,
    squares: Array,
) -> None:
    """Leave out each observation i with ``r_i^T S_ii^-1 r_i > limit_i``: its weight becomes 0.

    S (rows, rows): innovation covariance; r (rows,); limit, weight (observations,); losses
    (observations, 2). squares (observations,): gets ``r_i^T S_ii^-1 r_i / rows_i`` of the
    observations with a finite limit or a loss.
    """
    for i in range(weight.shape[0]):
        if weight[i] == 0.0 or not (np.isfinite(limit[i]) or losses[i, 0] != 0.0):
            continue
        start, rows = rows_of(tables.observations, tables.sensors, first, i)
        own, v = np.empty((rows, rows)), np.empty((rows, 1))
        for a in range(rows):
            v[a, 0] = r[start + a]
            for b in range(rows):
                own[a, b] = S[start + a, start + b]
        weight[i] = 0.0
        if cholesky(own):
            solve_lower(own, v)
            total = column_squares(v, 0, 0)
            squares[i] = total / rows
            if total <= limit[i]:
                weight[i] = 1.0


@jit
def misfit(H: Array, P: Array, r: Array) -> float:
    """``r^T (H P H^T + I)^-1 r``, for H (rows, n), P (n, n), r (rows,).

    The squared normalised innovation. NaN where P is not positive definite.
    """
    n = P.shape[0]
    scale, C = np.empty(n), np.empty((n, n))
    if not scaled_cholesky(P, scale, C):
        return np.nan
    for i in range(n):
        for j in range(n):
            C[i, j] *= scale[i]
    a = np.empty((n + H.shape[0], n + 1 + SPARE))
    least_squares(H, C, r, a)
    return column_squares(a, n, n)
