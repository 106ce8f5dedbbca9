"""The target's orbit where it stands in the state: planar two-body motion, in closed form.

    r'' = r th'^2 - mu / r^2,   th'' = -2 r' th' / r

y (4,): radius r, m, r', m/s, angle th, rad, of the radius from a direction at rest in the orbit's
plane, th', rad/s: the blocks `relnav_graph.core.catalogue.ORBIT`, which a model reads last. Its
constants then begin with the array of an estimated orbit (`relnav_graph.maths.orbit`).
"""

from __future__ import annotations

import numpy as np

from relnav_factors.shared.statuses import LOST_ORBIT, NO_ORBIT, finite
from relnav_factors.shared.white_noise import duration
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import ORBIT
from relnav_graph.core.state import Block
from relnav_graph.maths import dense, so3
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion, frame_rotation, two_body

#: Numbers of an orbit in the state.
SIZE = len(ORBIT)


def orbit_blocks(orbit: KeplerOrbit | None) -> tuple[Block, ...]:
    """What a model with this orbit reads of the state: its blocks where it is estimated."""
    return ORBIT if orbit is not None and orbit.estimated else ()


@jit
def in_state(orbit: Array) -> int:
    """How many numbers a kernel reads of the state for an orbit (5,): 4 of an estimated one."""
    return SIZE if orbit[0] == 0.0 and orbit[3] > 0.0 else 0


@jit
def planar_motion(mu: float, y: Array, dt: float) -> tuple[Array, Array]:
    """y (4,) after dt seconds, and its Jacobian (4, 4) to y, SI; NaN unless the radius is positive.

    mu: m^3/s^2. Exact for any conic, see `relnav_graph.maths.orbit.two_body`; th counts no whole
    turns that dt may have.
    """
    out, slope = np.full(SIZE, np.nan), np.full((SIZE, SIZE), np.nan)
    if not y[0] > 0.0:
        return out, slope
    across = y[0] * y[3]
    r, v, phi = two_body(np.array([y[0], 0.0, 0.0]), np.array([y[1], across, 0.0]), mu, dt)
    n = dense.norm(r)
    c, s = r[0] / n, r[1] / n
    radial, across = c * v[0] + s * v[1], c * v[1] - s * v[0]
    out[0], out[1], out[2], out[3] = n, radial, y[2] + np.arctan2(r[1], r[0]), across / n
    for j in range(SIZE):
        # The column of (x, y, v_x, v_y) at the end, seen along the radius and across it.
        if j == 2:
            for i in range(SIZE):
                slope[i, j] = 1.0 if i == j else 0.0
            continue
        d = np.empty(4)
        for i in range(4):
            row = i if i < 2 else i + 1
            if j == 0:  # r: also through v_y = r th'
                d[i] = phi[row, 0] + phi[row, 4] * y[3]
            else:
                d[i] = phi[row, 3] if j == 1 else phi[row, 4] * y[0]
        turn = (c * d[1] - s * d[0]) / n
        slope[0, j], slope[2, j] = c * d[0] + s * d[1], turn
        slope[1, j] = c * d[2] + s * d[3] + across * turn
        slope[3, j] = (c * d[3] - s * d[2] - radial * turn - out[3] * slope[0, j]) / n
    return out, slope


@jit
def motion_of(y: Array, slope: Array) -> tuple[Array, Array]:
    """The motion (5,) of `relnav_graph.maths.orbit.chief_motion` of an orbit y (4,), SI.

    slope: (4, k), Jacobian of y. Returns that of the motion, (5, k), too.
    """
    motion, out = np.empty(5), np.empty((5, slope.shape[1]))
    dense.put_vector(motion, 0, y)
    dense.put_block(out, 0, 0, slope, 1.0)
    motion[4] = -2 * y[1] * y[3] / y[0]
    for j in range(slope.shape[1]):
        swing = slope[1, j] * y[3] + y[1] * slope[3, j]
        out[4, j] = -(2 * swing + motion[4] * slope[0, j]) / y[0]
    return motion, out


@jit
def motions_over(orbit: Array, t: float, h: float, y: Array) -> tuple[Array, Array]:
    """The target's motion at the start, the middle and the end of a step: (3, 5), SI.

    orbit: starts with the (5,) of `relnav_graph.maths.orbit.orbit_array`; t: start, s; h: length,
    s; y: (4,) at the start, or (0,) where the orbit is known. Returns also their Jacobians to y,
    (3, 5, 4) or (3, 5, 0).
    """
    k = y.shape[0]
    motions, slopes = np.empty((3, 5)), np.empty((3, 5, k))
    for n in range(3):
        later = 0.5 * n * h
        if k == 0:
            dense.put_vector(motions[n], 0, chief_motion(orbit, t + later))
        else:
            at, to_y = planar_motion(orbit[3], y, later)
            motion, slope = motion_of(at, to_y)
            dense.put_vector(motions[n], 0, motion)
            dense.put_block(slopes[n], 0, 0, slope, 1.0)
    return motions, slopes


@jit
def put_turned(p: Array, t: float, u: Array, x: Array, R: Array, x_next: Array, F: Array) -> int:
    """``R_o1a = R_o1o0 R_o0a``: an attitude a in o, over an interval in which o turns.

    p: starts with the orbit (5,); t: start, s; u: (rows, n), see `duration`; x: ends with the orbit
    (4,), where that is estimated; R: R_o0a (3, 3). Fills the first nine of x_next, row by row, and
    then the last four columns of F, SI. Returns 0, or the status `LOST_ORBIT` or `NO_ORBIT`.
    """
    length = duration(u)
    k = in_state(p)
    if k == 0:
        ahead = frame_rotation(p, t, t + length)
        if not finite(ahead):
            return LOST_ORBIT
    else:
        y = x[x.shape[0] - k :].copy()
        y[2] = 0.0  # only its change counts
        later, slope = planar_motion(p[3], y, length)
        if not finite(slope):
            return NO_ORBIT
        ahead, first = so3.exp(np.array([0.0, 0.0, -later[2]])), F.shape[1] - k
        for j in range(k):
            for i in range(F.shape[0]):  # a turn d of o about z turns a by -R^T z d
                turn = slope[2, j] - (1.0 if j == 2 else 0.0)
                F[i, first + j] = -R[2, i] * turn if i < 3 else 0.0
    dense.put_matrix(x_next, 0, so3.project(dense.matmul(ahead, R)))
    return 0
