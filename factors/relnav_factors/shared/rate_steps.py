"""Steps of a free body's rate and attitude, with their own exact Jacobians.

A vector and its Jacobian to (w, k), n = 3 + dim(k) columns, stand side by side: (3, 1 + n).
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit


@jit
def start_of(w: Array, n: int) -> Array:
    """The rate w (3,), rad/s, at the start of a step, with its Jacobian to itself.

    Returns (3, 1 + n): w, then the columns to (w, k).
    """
    out = np.zeros((3, 1 + n))
    for i in range(3):
        out[i, 0], out[i, 1 + i] = w[i], 1.0
    return out


@jit
def euler_acceleration(w: Array, A: Array, dA: Array, out: Array) -> None:
    """``w' = A (w_x^2, w_y^2, w_z^2, w_y w_z, w_z w_x, w_x w_y)``: a body without torque.

    w: (3, 1 + n), rad/s, with its Jacobian; A: (3, 6) and dA: (dim k, 3, 6), see
    `relnav_factors.shared.inertia.principal_coefficients`; out: (3, 1 + n), filled with w',
    rad/s^2, and its Jacobian.
    """
    x, y, z = w[0, 0], w[1, 0], w[2, 0]
    for i in range(3):
        C = A[i]
        to_x = 2 * C[0] * x + C[4] * z + C[5] * y
        to_y = 2 * C[1] * y + C[3] * z + C[5] * x
        to_z = 2 * C[2] * z + C[3] * y + C[4] * x
        # Of second degree in w: Euler's theorem on homogeneous functions.
        out[i, 0] = 0.5 * (to_x * x + to_y * y + to_z * z)
        for j in range(1, w.shape[1]):
            out[i, j] = to_x * w[0, j] + to_y * w[1, j] + to_z * w[2, j]
        for m in range(dA.shape[0]):
            C = dA[m, i]
            squares = C[0] * x * x + C[1] * y * y + C[2] * z * z
            out[i, 4 + m] += squares + C[3] * y * z + C[4] * z * x + C[5] * x * y


@jit
def rate_step(w: Array, A: Array, dA: Array, h: float) -> tuple[Array, Array]:
    """One Runge-Kutta step of the rate, and the turn over it, with their Jacobians.

    w: (3, 1 + n), rad/s, see `start_of`; A, dA: see `euler_acceleration`; h: s. Returns the rate,
    rad/s, in t and the rotation vector, rad, over h seconds, both (3, 1 + n); the Jacobians are
    exact for the step as computed.

    The turn is Magnus' series to fourth order: the mean rate, with the midpoint from the Hermite
    polynomial, and the coning term (w0 x w1) h^2 / 12.
    """
    n = w.shape[1]
    first, at, w1 = np.empty((3, n)), np.empty((3, n)), np.empty((3, n))
    euler_acceleration(w, A, dA, first)
    a, turn = first.copy(), np.empty((3, n))
    for i in range(3):
        for j in range(n):
            w1[i, j] = w[i, j] + h / 6 * first[i, j]
    for stage in range(1, 4):
        ahead, weight = (h, h / 6) if stage == 3 else (0.5 * h, h / 3)
        for i in range(3):
            for j in range(n):
                at[i, j] = w[i, j] + ahead * a[i, j]
        euler_acceleration(at, A, dA, a)
        for i in range(3):
            for j in range(n):
                w1[i, j] += weight * a[i, j]
    last = a
    euler_acceleration(w1, A, dA, last)
    for i in range(3):
        b, c = (i + 1) % 3, (i + 2) % 3
        for j in range(n):
            coning = w[b, j] * w1[c, 0] - w[c, j] * w1[b, 0]
            if j > 0:
                coning += w[b, 0] * w1[c, j] - w[c, 0] * w1[b, j]
            bent = first[i, j] - last[i, j] + coning
            turn[i, j] = h / 2 * (w[i, j] + w1[i, j]) + h * h / 12 * bent
    return w1, turn


@jit
def published_step(w: Array, A: Array, dA: Array, h: float) -> tuple[Array, Array]:
    """One Euler step, as Hu et al. 2019 predict.

    w, A, dA, h: as of `rate_step`. Returns rate (rad/s) and turn (rad), (3, 1 + n) each.

    Their q + q' h, made a unit quaternion again, turns by 2 atan(|w| h / 2) about w.
    """
    w1, turn = np.empty((3, w.shape[1])), np.zeros((3, w.shape[1]))
    euler_acceleration(w, A, dA, w1)
    half2 = 0.25 * h * h * (w[0, 0] ** 2 + w[1, 0] ** 2 + w[2, 0] ** 2)
    half = np.sqrt(half2)
    stretch, slope = 1 - half2 / 3 * (1 - 0.6 * half2), -2 / 3.0 + 0.8 * half2
    if half > 1e-2:
        stretch = np.arctan(half) / half
        slope = (1 / (1 + half2) - stretch) / half2
    for i in range(3):
        for j in range(w.shape[1]):
            w1[i, j] = w[i, j] + h * w1[i, j]
        turn[i, 0] = stretch * h * w[i, 0]
        turn[i, 1 + i] = stretch * h
        for j in range(3):  # d(half2) = h^2 w_j / 2, and d(stretch) = slope d(half2) / 2
            turn[i, 1 + j] += 0.25 * slope * h**3 * w[i, 0] * w[j, 0]
    return w1, turn
