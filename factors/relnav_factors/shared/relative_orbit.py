"""Steps of the relative motion about a target on its orbit, in its rotating axes o."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.maths import dense
from relnav_graph.maths.orbit import relative_transition


@jit
def relative_acceleration(motion: Array, mu: float, x: Array) -> tuple[Array, Array]:
    """Acceleration of the chaser relative to the target in rotating axes o, and its Jacobian.

    motion: (5,) of the target, see `relnav_graph.maths.orbit.chief_motion`; mu: m^3/s^2; x: (6,):
    r_tc_o (m), r_tc_o' in o (m/s), here r and r'. Returns r'' (3,), m/s^2, and its Jacobian (3, 6)
    to x, SI.

        r'' = g(r_t + r) - g(r_t) - 2 w x r' - w' x r - w x (w x r)

    w = w_oi_o along z. The difference of the two gravities is exact, in Battin's form
    (1999, eq. 8.61), which loses no digits however small the separation.
    """
    radius, rate, rate_dot = motion[0], motion[3], motion[4]
    rate2 = rate * rate
    q = (x[0] * (x[0] + 2 * radius) + x[1] * x[1] + x[2] * x[2]) / (radius * radius)
    stretch = q * (3 + 3 * q + q * q) / (1 + (1 + q) ** 1.5)
    distance = radius * np.sqrt(1 + q)
    pull = mu / distance**3
    out, n, jacobian = np.empty(3), np.empty(3), np.zeros((3, 6))
    for i in range(3):
        out[i] = -pull * x[i]
        n[i] = x[i] / distance
    out[0] += pull * stretch * radius + 2 * rate * x[4] + rate_dot * x[1] + rate2 * x[0]
    out[1] += -2 * rate * x[3] - rate_dot * x[0] + rate2 * x[1]
    n[0] += radius / distance
    for i in range(3):
        for j in range(3):
            jacobian[i, j] = 3 * pull * n[i] * n[j]
        jacobian[i, i] -= pull
    jacobian[0, 0] += rate2
    jacobian[1, 1] += rate2
    jacobian[0, 1] += rate_dot
    jacobian[1, 0] -= rate_dot
    jacobian[0, 4] = 2 * rate
    jacobian[1, 3] = -2 * rate
    return out, jacobian


@jit
def acceleration_to_orbit(motion: Array, mu: float, x: Array) -> Array:
    """Jacobian (3, 3) of `relative_acceleration` to the target's radius, rate and acceleration of
    its angle, m/s^2 per m, rad/s and rad/s^2.

    motion (5,), mu, x (6,): as there.
    """
    radius, rate = motion[0], motion[3]
    out, n = np.zeros((3, 3)), dense.vector_at(x, 0)
    n[0] += radius
    distance = dense.norm(n)
    pull = mu / distance**3
    for i in range(3):  # the gravity gradients at chaser and target, along the radius
        out[i, 0] = 3 * pull * (n[0] / distance) * (n[i] / distance)
    out[0, 0] -= pull + 2 * mu / radius**3
    out[0, 1], out[0, 2] = 2 * x[4] + 2 * rate * x[0], x[1]
    out[1, 1], out[1, 2] = -2 * x[3] + 2 * rate * x[1], -x[0]
    return out


@jit
def exact_step(
    motions: Array, slopes: Array, mu: float, h: float, x: Array, thrust: Array
) -> tuple[Array, Array]:
    """One Runge-Kutta step of `relative_acceleration` and thrust, of fourth order.

    motions (3, 5), slopes (3, 5, k): of the target at the start, the middle and the end of the
    step, see `relnav_factors.shared.planar_orbit.motions_over`, and their Jacobian to k numbers of
    its orbit; mu: m^3/s^2; h: length, s; x: (6,): r_tc_o (m), r_tc_o' (m/s); thrust: starts with
    the acceleration (3,), m/s^2, in o. Returns x after the step, (6,), and its Jacobian (6, 6 + k)
    to x and these, which is exact for the step as computed.
    """
    m = 6 + slopes.shape[2]
    one = np.zeros((6, m))
    for i in range(6):
        one[i, i] = 1.0
    at_x, at_d, end_x, end_d = x, one, x, one
    k, dk = np.empty(6), np.empty((6, m))
    for stage in range(4):
        when = (stage + 1) // 2  # the middle twice
        a, da = relative_acceleration(motions[when], mu, at_x)
        chained = dense.matmul(da, at_d)
        if m > 6:
            to_orbit = acceleration_to_orbit(motions[when], mu, at_x)
            for i in range(3):
                for j in range(6, m):
                    for l, of in enumerate((0, 3, 4)):
                        chained[i, j] += to_orbit[i, l] * slopes[when, of, j - 6]
        for i in range(3):
            k[i], k[3 + i] = at_x[3 + i], a[i] + thrust[i]
            for j in range(m):
                dk[i, j], dk[3 + i, j] = at_d[3 + i, j], chained[i, j]
        weight = h / 6 if stage in (0, 3) else h / 3
        end_x, end_d = (
            dense.add_scaled_vector(end_x, k, weight),
            dense.add_scaled(end_d, dk, weight),
        )
        ahead = h if stage == 2 else 0.5 * h
        at_x, at_d = dense.add_scaled_vector(x, k, ahead), dense.add_scaled(one, dk, ahead)
    return end_x, end_d


@jit
def linear_step(orbit: Array, t: float, h: float, x: Array, thrust: Array) -> tuple[Array, Array]:
    """One step of the motion under linear gravity: ``Phi x + int Phi(t + h, s) a ds``, and Phi.

    orbit: starts with the (5,) of `relnav_graph.maths.orbit.orbit_array`; t: start, s; h, x and
    thrust as of `exact_step`, and what is returned; Phi (6, 6): see
    `relnav_graph.maths.orbit.relative_transition`. The integral by Gauss's rule of two points,
    which leaves out the fifth order of h.
    """
    step = relative_transition(orbit, t, t + h)
    out = dense.matvec(step, x)
    if thrust[0] != 0.0 or thrust[1] != 0.0 or thrust[2] != 0.0:
        pushed = np.zeros(6)
        dense.put_vector(pushed, 3, 0.5 * h * thrust[:3])
        for place in (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)):
            later = relative_transition(orbit, t + place * h, t + h)
            out = dense.add_scaled_vector(out, dense.matvec(later, pushed), 1.0)
    return out, step
