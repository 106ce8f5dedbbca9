"""Orbits integrated in inertial axes, of one craft or of two."""

from __future__ import annotations

import numpy as np

from relnav_factors.shared.earth import FAILURES as EARTH_FAILURES
from relnav_factors.shared.earth import earth_pull
from relnav_factors.shared.gravity import gravity_difference, zonal_gravity
from relnav_factors.shared.statuses import degenerate, finite, length_status
from relnav_factors.shared.thrust import add_thrust_noise, thrust_of
from relnav_factors.shared.white_noise import add_integrated_white_noise, step_count
from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit
from relnav_graph.maths import dense


@jit
def _add_earth(earth: Array, t: float, y: Array, out: Array, jacobian: Array) -> None:
    """Add what the Earth, Sun and Moon pull besides a sphere, see `earth_pull`, to y' and its
    Jacobian, as of `_derivative`."""
    n = y.shape[0]
    at = n - 6
    r_c = dense.vector_at(y, at)
    g, G = earth_pull(earth, t, r_c)
    for i in range(3):
        out[at + 3 + i] += g[i]
        for j in range(3):
            jacobian[at + 3 + i, at + j] += G[i, j]
    if at > 0:
        g_t, G_t = earth_pull(earth, t, dense.add_scaled_vector(r_c, dense.vector_at(y, 0), -1.0))
        for i in range(3):
            out[3 + i] += g[i] - g_t[i]
            for j in range(3):
                jacobian[3 + i, j] += G_t[i, j]
                jacobian[3 + i, at + j] += G[i, j] - G_t[i, j]


@jit
def _derivative(p: Array, earth: Array, t: float, y: Array, thrust: Array) -> tuple[Array, Array]:
    """y' and its Jacobian. y ends with (r_c, v_c) of one craft, which has the thrust; (r_tc, v_tc),
    its position and velocity relative to another, may stand before."""
    n = y.shape[0]
    out, jacobian = np.empty(n), np.zeros((n, n))
    at = n - 6
    g, G = zonal_gravity(p, dense.vector_at(y, at), 0)
    dense.put_vector(out, at + 3, g)
    dense.put_block(jacobian, at + 3, at, G, 1.0)
    if at > 0:
        g, to_r, to_c = gravity_difference(p, dense.vector_at(y, at), dense.vector_at(y, 0))
        dense.put_vector(out, 3, g)
        dense.put_block(jacobian, 3, 0, to_r, 1.0)
        dense.put_block(jacobian, 3, at, to_c, 1.0)
    if earth.shape[0] > 0:
        _add_earth(earth, t, y, out, jacobian)
    for first in range(0, n, 6):
        for i in range(first, first + 3):
            out[i] = y[i + 3]
            out[i + 3] += thrust[i - first]
            jacobian[i, i + 3] = 1.0
    return out, jacobian


@jit
def orbit_step(
    p: Array, earth: Array, t: float, y: Array, h: float, thrust: Array
) -> tuple[Array, Array]:
    """y after one Runge-Kutta step of h seconds from t on, and the step's own Jacobian.

    p: starts with the field (5,); earth: (n,), see `earth_numbers`, or empty; t: s; y: (6,): r_c
    (m), v_c (m/s), or (12,): r_tc, v_tc, r_c, v_c, in i; thrust: starts
    with the acceleration (3,), m/s^2, in i. Returns y (n,) and the Jacobian (n, n), SI.
    """
    one = dense.identity(y.shape[0])
    at_y, at_d, end_y, end_d = y, one, y, one
    for stage in range(4):
        since = 0.0 if stage == 0 else h if stage == 3 else 0.5 * h
        k, slope = _derivative(p, earth, t + since, at_y, thrust)
        dk = dense.matmul(slope, at_d)
        weight = h / 6 if stage in (0, 3) else h / 3
        end_y, end_d = (
            dense.add_scaled_vector(end_y, k, weight),
            dense.add_scaled(end_d, dk, weight),
        )
        ahead = h if stage == 2 else 0.5 * h
        at_y, at_d = dense.add_scaled_vector(y, k, ahead), dense.add_scaled(one, dk, ahead)
    return end_y, end_d


#: Status: an orbit leaves what floats hold.
_LEFT = 1
FAILURES = {
    _LEFT: "an orbit is beyond what floats hold",
    **EARTH_FAILURES,
    **degenerate(
        "the distance of the chaser from the Earth's centre",
        "the distance of the target from the Earth's centre",
    ),
}


@jit
def orbit_status(y0: Array, y: Array, S: Array) -> int:
    """0 where an orbit stayed finite over an interval, else a status of `FAILURES`.

    y0, y: (n,), as of `orbit_step`, at its start and end; S: (n, m), its sensitivity.
    """
    n = y.shape[0]
    if finite(y.reshape(1, n)) and finite(S):
        return 0
    r_c = dense.vector_at(y0, n - 6)
    status = length_status(dense.norm(r_c), 0)
    if status == 0 and n > 6:
        r_t = dense.add_scaled_vector(r_c, dense.vector_at(y0, 0), -1.0)
        status = length_status(dense.norm(r_t), 1)
    return max(status, _LEFT)


@jit
def coast(
    p: Array,
    earth: Array,
    t: float,
    y: Array,
    S: Array,
    Q: Array,
    length: float,
    longest: float,
    walk: float,
    white: float,
    thrust: Array,
) -> tuple[Array, Array, Array]:
    """y after `length` seconds of gravity and thrust, its sensitivity and the noise of its first
    six.

    p: starts with the field (5,); earth, t and y (n,): as of `orbit_step`, whose steps take at
    most `longest` seconds; S: (n, m) and Q: (6, 6), from before; walk: density of a random walk of
    the position, m/sqrt(s); white: of the acceleration's white noise, m/s^1.5; thrust: (9,), of the
    chaser in i, see `relnav_factors.shared.thrust.thrust_of`. Returns y, S and Q at the end.
    """
    steps = step_count(length, longest)
    h, own = length / steps, np.empty((6, 6))
    for n in range(steps):
        give_way(n)
        y, step = orbit_step(p, earth, t + n * h, y, h, thrust)
        for i in range(6):
            for j in range(6):
                own[i, j] = step[i, j]
        S, Q = dense.matmul(step, S), dense.propagate_covariance(own, Q)
        add_integrated_white_noise(Q, 0, white**2, h)
        add_thrust_noise(Q, thrust, h)
        for i in range(3):
            Q[i, i] += walk**2 * h
    return y, S, Q


@jit
def fly(
    p: Array, earth: Array, t: float, u: Array, y: Array, longest: float, walk: float, white: float
) -> tuple[Array, Array, Array]:
    """As `coast`, from t on over the rows of u (rows, 1), or (rows, 10) with thrust: y (n,) at the
    end, its sensitivity (n, n) and the covariance (6, 6) of the noise of its first six."""
    S, Q = dense.identity(y.shape[0]), np.zeros((6, 6))
    for row in range(u.shape[0]):
        y, S, Q = coast(p, earth, t, y, S, Q, u[row, 0], longest, walk, white, thrust_of(u, row))
        t += u[row, 0]
    return y, S, Q
