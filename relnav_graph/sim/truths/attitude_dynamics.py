"""Compiled integration of two rigid bodies on one orbit, with their torques.

Nothing here is shared with the models of the estimators. The state y (14,), SI: of the target
q_it as q_wxyz (0:4) and w_ti_t (4:7), of the chaser the same (7:14).
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import MATRIX, VECTOR
from relnav_graph.constants import MU_EARTH
from relnav_graph.maths import dense, so3

__all__ = ["BODY", "ORBIT", "advance", "circular_orbit", "gravity_gradient"]


#: Numbers of an orbit: radius (m), rate (rad/s), unit vectors in i at t = 0: radial out (3)
#: and transverse (3); density of the air times drag coefficient (kg/m^3).
ORBIT = 9
#: Numbers of a body: J (9) and its inverse (9), faces across its axes (3) m^2, centre of
#: pressure from the centre of mass (3) m.
BODY = 24


def circular_orbit(
    radius: float, inclination: float, raan: float, latitude: float, epoch: float, drag: float
) -> Array:
    """The numbers of a circular orbit, (9,); latitude: its argument at the epoch, s, rad; drag:
    density of the air times drag coefficient, kg/m^3."""
    rate = np.sqrt(MU_EARTH / radius**3)
    latitude -= np.remainder(rate * epoch, 2 * np.pi)
    c, s = np.cos(raan), np.sin(raan)
    node, up = np.array([c, s, 0.0]), np.cos(inclination) * np.array([-s, c, 0.0])
    up[2] = np.sin(inclination)
    radial = np.cos(latitude) * node + np.sin(latitude) * up
    ahead = np.cos(latitude) * up - np.sin(latitude) * node
    return np.array([radius, rate, *radial, *ahead, drag])


@jit
def gravity_gradient(orbit: Array, J: Array, t: float, q_ib: Array) -> Array:
    """Torque of a central field on a body of inertia J (3, 3) at time t, s, in body axes,
    N m: 3 n^2 u x J u with u the unit vector outwards (Hughes 1986, eq. 8.1.13)."""
    turn, out = orbit[1] * t, np.empty(3)
    for i in range(3):
        out[i] = np.cos(turn) * orbit[2 + i] + np.sin(turn) * orbit[5 + i]
    u = dense.transposed_matvec(so3.from_quaternion(q_ib), out)
    torque = so3.cross(u, dense.matvec(J, u))
    for i in range(3):
        torque[i] *= 3 * orbit[1] ** 2
    return torque


@jit
def _drag_torque(orbit: Array, body: Array, t: float, q_ib: Array) -> Array:
    """Torque of free molecular drag along the velocity on three faces, about the centre of
    mass, in body axes, N m. The air does not turn with the Earth."""
    turn, ahead = orbit[1] * t, np.empty(3)
    for i in range(3):
        ahead[i] = np.cos(turn) * orbit[5 + i] - np.sin(turn) * orbit[2 + i]
    v = dense.transposed_matvec(so3.from_quaternion(q_ib), ahead)
    area = 0.0
    for i in range(3):
        area += body[18 + i] * abs(v[i])
    speed = orbit[0] * orbit[1]
    for i in range(3):
        v[i] *= -0.5 * orbit[8] * speed * speed * area
    return so3.cross(dense.vector_at(body, 21), v)


@jit
def _derivative(orbit: Array, body: Array, t: float, y: Array, command: Array, out: Array) -> None:
    """y' (7,) of one body under gravity gradient, drag and a commanded torque."""
    J = dense.matrix_at(body, 0)
    w = dense.vector_at(y, 4)
    out[0] = -0.5 * (y[1] * w[0] + y[2] * w[1] + y[3] * w[2])
    out[1] = 0.5 * (y[0] * w[0] + y[2] * w[2] - y[3] * w[1])
    out[2] = 0.5 * (y[0] * w[1] + y[3] * w[0] - y[1] * w[2])
    out[3] = 0.5 * (y[0] * w[2] + y[1] * w[1] - y[2] * w[0])
    torque = gravity_gradient(orbit, J, t, y[0:4])
    drag = _drag_torque(orbit, body, t, y[0:4])
    gyration = so3.cross(w, dense.matvec(J, w))
    for i in range(3):
        torque[i] += drag[i] + command[i] - gyration[i]
    dense.put_vector(out, 4, dense.matvec(dense.matrix_at(body, 9), torque))


@jit_loop(VECTOR, MATRIX, VECTOR, VECTOR, VECTOR, ahead=False)
def advance(orbit: Array, bodies: Array, span: Array, command: Array, y: Array) -> None:
    """Move y (14,) on in place by the classical Runge-Kutta method.

    orbit (9,), bodies (2, 24): target and chaser; span (3,): start (s), length of a step (s)
    and number of steps; command (3,): torque on the chaser in its axes, N m, held.
    """
    k, stage, none = np.empty((4, 7)), np.empty(7), np.zeros(3)
    h = span[1]
    for n in range(int(span[2])):
        give_way(n)
        t = span[0] + n * h
        for b in range(2):
            torque = command if b == 1 else none
            for s in range(4):
                ahead = 0.0 if s == 0 else h if s == 3 else 0.5 * h
                for i in range(7):
                    stage[i] = y[7 * b + i] + (ahead * k[s - 1, i] if s > 0 else 0.0)
                _derivative(orbit, bodies[b], t + ahead, stage, torque, k[s])
            for i in range(7):
                y[7 * b + i] += h / 6 * (k[0, i] + 2 * k[1, i] + 2 * k[2, i] + k[3, i])
            size = 0.0
            for i in range(4):
                size += y[7 * b + i] ** 2
            for i in range(4):
                y[7 * b + i] /= np.sqrt(size)
