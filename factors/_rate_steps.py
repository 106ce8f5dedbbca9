"""Steps of a free body's rate and attitude, with their own exact Jacobians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.compiled import jit

Array = NDArray[np.float64]


@jit
def euler_acceleration(w: Array, A: Array, dA: Array, dw: Array) -> tuple[Array, Array]:
    """w' (3,) of a torque-free body and its Jacobian (3, 3 + n) to (w0, k), with dw that
    of w itself. A, dA: see `euler_coefficients`; of principal axes only the products
    w_y w_z and cyclic count."""
    x, y, z = w[0], w[1], w[2]
    n, out, to_w = dA.shape[0], np.zeros(3), np.zeros((3, 3))
    principal = n == 2
    for i in range(3):
        C = A[i]
        if principal:
            to_w[i, (i + 1) % 3] = C[3 + i] * w[(i + 2) % 3]
            to_w[i, (i + 2) % 3] = C[3 + i] * w[(i + 1) % 3]
        else:
            to_w[i, 0] = 2 * C[0] * x + C[4] * z + C[5] * y
            to_w[i, 1] = 2 * C[1] * y + C[3] * z + C[5] * x
            to_w[i, 2] = 2 * C[2] * z + C[3] * y + C[4] * x
        # Of second degree in w: Euler's theorem on homogeneous functions.
        out[i] = 0.5 * (to_w[i, 0] * x + to_w[i, 1] * y + to_w[i, 2] * z)
    jacobian = so3.multiply(to_w, dw)
    for m in range(n):
        for i in range(3):
            C = dA[m, i]
            if principal:
                jacobian[i, 3 + m] += C[3 + i] * w[(i + 1) % 3] * w[(i + 2) % 3]
            else:
                squares = C[0] * x * x + C[1] * y * y + C[2] * z * z
                jacobian[i, 3 + m] += squares + C[3] * y * z + C[4] * z * x + C[5] * x * y
    return out, jacobian


@jit
def rate_step(w: Array, A: Array, dA: Array, h: float) -> tuple[Array, Array, Array, Array]:
    """One Runge-Kutta step of the rate: w (3,) and turn (3,) over h seconds, with their
    Jacobians to (w, k), (3, 3 + n) each, which are exact for the step as computed.

    The turn is Magnus' series to fourth order: the mean rate, with the midpoint from the
    Hermite polynomial, and the coning term (w0 x w1) h^2 / 12.
    """
    n = 3 + dA.shape[0]
    start = np.zeros((3, n))
    start[0, 0] = start[1, 1] = start[2, 2] = 1.0
    first, dfirst = euler_acceleration(w, A, dA, start)
    w1, dw1 = so3.add_vector(w, first, h / 6), so3.add(start, dfirst, h / 6)
    a, da = first, dfirst
    for stage in range(1, 4):
        ahead = h if stage == 3 else 0.5 * h
        rate, drate = so3.add_vector(w, a, ahead), so3.add(start, da, ahead)
        a, da = euler_acceleration(rate, A, dA, drate)
        weight = h / 6 if stage == 3 else h / 3
        w1, dw1 = so3.add_vector(w1, a, weight), so3.add(dw1, da, weight)
    last, dlast = euler_acceleration(w1, A, dA, dw1)
    coning = so3.cross(w, w1)
    dconing = so3.add(so3.multiply(so3.skew(w), dw1), so3.multiply(so3.skew(w1), start), -1.0)
    turn, dturn = np.empty(3), np.empty((3, n))
    for i in range(3):
        turn[i] = h / 2 * (w[i] + w1[i]) + h * h / 12 * (first[i] - last[i] + coning[i])
        for j in range(n):
            bent = dfirst[i, j] - dlast[i, j] + dconing[i, j]
            dturn[i, j] = h / 2 * (start[i, j] + dw1[i, j]) + h * h / 12 * bent
    return w1, turn, dw1, dturn


@jit
def published_step(w: Array, A: Array, dA: Array, h: float) -> tuple[Array, Array, Array, Array]:
    """One Euler step, as Hu et al. 2019 predict; gives what `rate_step` gives.

    Their q + q' h, made a unit quaternion again, turns by 2 atan(|w| h / 2) about w.
    """
    start = np.zeros((3, 3 + dA.shape[0]))
    start[0, 0] = start[1, 1] = start[2, 2] = 1.0
    a, da = euler_acceleration(w, A, dA, start)
    half2 = 0.25 * h * h * (w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    half = np.sqrt(half2)
    stretch, slope = 1 - half2 / 3 * (1 - 0.6 * half2), -2 / 3.0 + 0.8 * half2
    if half > 1e-2:
        stretch = np.arctan(half) / half
        slope = (1 / (1 + half2) - stretch) / half2
    turn, dturn = np.empty(3), np.zeros((3, 3 + dA.shape[0]))
    for i in range(3):
        turn[i] = stretch * h * w[i]
        dturn[i, i] = stretch * h
        for j in range(3):  # d(half2) = h^2 w_j / 2, and d(stretch) = slope d(half2) / 2
            dturn[i, j] += 0.25 * slope * h**3 * w[i] * w[j]
    return so3.add_vector(w, a, h), turn, so3.add(start, da, h), dturn
