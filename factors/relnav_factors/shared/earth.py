"""The pull of the Earth as it turns, and of Sun and Moon, in inertial axes: what is added to the
gravity of a sphere.

It travels to the kernels as an array (`earth_numbers`), empty where there is none: `HEAD` numbers,
nodes of the Earth's orientation and of the places of Sun and Moon, COLUMNS each, `NODE` seconds
apart, and the table of the field (`relnav_factors.shared.harmonics`). Between nodes a cubic: 0.6
microarcsec of the fastest nutation, 3e-7 of the Moon's distance.
"""

from __future__ import annotations

import numpy as np

from relnav_factors.shared.harmonics import harmonic_pull, harmonic_table
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.constants import MU_THIRD
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.errors import InputError
from relnav_graph.maths import dense
from relnav_graph.maths import earth as orientation
from relnav_graph.maths.geopotential import geopotential

#: Seconds from node to node, and from which t, s, on to which they are laid at most.
NODE, FIRST, LAST = 21600.0, -86400.0, 32 * 86400.0
#: GM and R of the field, degree and order of its table, angle of the Earth at t = 0, its rate,
#: time of the first node, how many, GM of Sun and Moon or 0.
HEAD = 10
#: X, Y of the pole, the angle but for its steady turn, the pole's motion, Sun (3,), Moon (3,).
COLUMNS = 11
#: Status: a time without nodes.
UNKNOWN_TIME = 40
FAILURES = {
    UNKNOWN_TIME: "the Earth's orientation is known from 1 day before [time] epoch to 32 days after"
    " it, and within the file of [time] orientation, if there is one: this time is outside"
}


def earth_numbers(
    degree: int, order: int, third_bodies: tuple[str, ...], clock: AbsoluteTime
) -> Array:
    """The Earth as kernels take it (HEAD + COLUMNS * nodes + table,), SI.

    degree, order: of the field; third_bodies: of "sun", "moon"; clock: the time of t = 0, s, and
    how the Earth turns. Raises InputError on a field that there is not, or where the file of
    the Earth's orientation does not cover half a day about t = 0.
    """
    field, begin, table = geopotential(), clock.begin, clock.table
    numbers, top, most = harmonic_table(*field.upto(degree, order))
    t = np.arange(FIRST - NODE, LAST + 1.5 * NODE, NODE)
    if table is not None:
        low, high = table.covers(begin)
        t = t[(t >= low) & (t <= high)]
        if len(t) < 4 or not t[1] <= 0.0 < t[-2]:
            found = f"found days {table.mjd[0]:g} to {table.mjd[-1]:g}"
            raise InputError(f"{table.source}: {found}, expected {begin} well within")
    ut1_tt, xp, yp = orientation.orientation(begin, t, table)
    angle = np.unwrap(orientation.rotation_angle(begin, t, ut1_tt))
    x, y, s = orientation.celestial_pole(begin, t)
    zero = int(np.argmin(np.abs(t)))
    start = angle[zero] - orientation.EARTH_RATE * t[zero]
    rest = angle - start - orientation.EARTH_RATE * t
    rest += orientation.origin_offset(begin, t) - s - 2 * np.pi * np.round(rest / (2 * np.pi))
    bodies = [orientation.third_body(name, begin, t) for name in MU_THIRD]
    nodes = np.column_stack([x, y, rest, xp, yp, *bodies])
    pulls = [mu if name in third_bodies else 0.0 for name, mu in MU_THIRD.items()]
    head = [field.gm, field.radius, top, most, start, orientation.EARTH_RATE, t[0], len(t), *pulls]
    out = np.concatenate([head, nodes.ravel(), numbers])
    out.flags.writeable = False
    return out


@jit
def time_known(earth: Array, t: float) -> bool:
    """Whether there are nodes about time t, s; earth: see `earth_numbers`, (n,), or empty."""
    if earth.shape[0] == 0:
        return True
    first = earth[6] + NODE
    return bool(first <= t <= first + (earth[7] - 3.0) * NODE)


@jit
def _between(earth: Array, t: float) -> Array:
    """The columns (COLUMNS,) of the nodes at time t, s."""
    place = (t - earth[6]) / NODE
    k = min(max(int(place), 1), int(earth[7]) - 3)
    u = place - k
    a, b = -u * (u - 1) * (u - 2) / 6, (u + 1) * (u - 1) * (u - 2) / 2
    c, d = -(u + 1) * u * (u - 2) / 2, (u + 1) * u * (u - 1) / 6
    out, at = np.empty(COLUMNS), HEAD + COLUMNS * (k - 1)
    for i in range(COLUMNS):
        j = at + i
        out[i] = a * earth[j] + b * earth[j + COLUMNS]
        out[i] += c * earth[j + 2 * COLUMNS] + d * earth[j + 3 * COLUMNS]
    return out


@jit
def _earth_axes(x: float, y: float, angle: float, xp: float, yp: float) -> Array:
    """``R_ie`` (3, 3): Q(X, Y) R3(-angle) R2(xp) R1(yp); IERS Conventions 2010, eqs. 5.3 to 5.10,
    with s and s' in the angle, all rad."""
    a = 1.0 / (1.0 + np.sqrt(1.0 - x * x - y * y))
    celestial = np.array(
        [[1 - a * x * x, -a * x * y, x], [-a * x * y, 1 - a * y * y, y], [-x, -y, 0.0]]
    )
    celestial[2, 2] = 1 - a * (x * x + y * y)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    cx, sx, cy, sy = np.cos(xp), np.sin(xp), np.cos(yp), np.sin(yp)
    polar = np.array([[cx, sx * sy, -sx * cy], [0.0, cy, sy], [sx, -cx * sy, cx * cy]])
    return dense.matmul(dense.matmul(celestial, turn), polar)


@jit
def _add_tide(mu: float, s: Array, r: Array, g: Array, G: Array) -> None:
    """Add to g (3,) and G (3, 3) the pull of a body of mu at s (3,) on r (3,), less that on the
    Earth, in Battin's form (1999, eq. 8.61)."""
    q, s2, d2 = 0.0, 0.0, 0.0
    for i in range(3):
        q += r[i] * (r[i] - 2 * s[i])
        s2 += s[i] * s[i]
        d2 += (r[i] - s[i]) ** 2
    q /= s2
    stretch, pull = q * (3 + q * (3 + q)) / (1 + (1 + q) ** 1.5), mu / (d2 * np.sqrt(d2))
    for i in range(3):
        g[i] -= pull * (r[i] + stretch * s[i])
        G[i, i] -= pull
        for j in range(3):
            G[i, j] += 3 * pull * (r[i] - s[i]) * (r[j] - s[j]) / d2


@jit
def earth_pull(earth: Array, t: float, r_i: Array) -> tuple[Array, Array]:
    """Acceleration (3,), m/s^2, and its gradient (3, 3), 1/s^2, besides a sphere's, in i.

    earth: (n,), see `earth_numbers`; t: s, with nodes about it, see `time_known`; r_i: (3,), m,
    from the Earth's centre.
    """
    now = _between(earth, t)
    R_ie = _earth_axes(now[0], now[1], earth[4] + earth[5] * t + now[2], now[3], now[4])
    r_e = dense.transposed_matvec(R_ie, r_i)
    table = earth[HEAD + COLUMNS * int(earth[7]) :]
    g_e, G_e = harmonic_pull(table, int(earth[2]), int(earth[3]), earth[0], earth[1], r_e)
    g = dense.matvec(R_ie, g_e)
    G = dense.propagate_covariance(R_ie, G_e)  # R G R^T
    for body in range(2):
        if earth[8 + body] > 0.0:
            _add_tide(earth[8 + body], dense.vector_at(now, 5 + 3 * body), r_i, g, G)
    return g, G
