"""What spherical harmonics add to the gravity of a sphere, with its gradient, anywhere: at the
poles, too.

With Z_nm the solid harmonics (R / r)^(n+1) Pn(m) exp(i m lon), R / r times those of the force
function, each derivative of a sum of c_nm Z_nm, c = C - i S, is such a sum again, of one degree
more, with numbers that depend on n and m alone (Cunningham 1970; Montenbruck and Gill 2000, eq.
3.33). So acceleration and gradient are sums over the same Z_nm, whose numbers stand in a table, and
nothing divides by the distance from the axis. All is fully normalised.

The table (TERMS * k,) holds, for each order m its degrees n = m, m + 1, ... one after the other,
two factors of the recursion of Z_nm, then the real parts C' and S' of eight sums: acceleration in
x, y, z, gradient in xx, xy, xz, yz, zz.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit

#: Numbers of one term.
TERMS = 18


def _weight(m: int) -> int:
    return 1 if m == 0 else 2


def _derivatives(c: Array) -> tuple[Array, Array, Array]:
    """The sums that are the derivatives in x, y and z, times R, of one with c (n + 1, n + 1)."""
    size = len(c)
    out = np.zeros((3, size + 1, size + 1), dtype=np.complex128)
    for n in range(size):
        for m in range(n + 1):
            ratio = (2 * n + 1) / (2 * n + 3)
            up = np.sqrt(ratio * _weight(m) / _weight(m + 1) * (n + m + 1) * (n + m + 2))
            half = 1.0 if m == 0 else 0.5
            out[0, n + 1, m + 1] -= half * up * c[n, m]
            out[1, n + 1, m + 1] += half * up * 1j * c[n, m]
            out[2, n + 1, m] -= np.sqrt(ratio * (n + m + 1) * (n - m + 1)) * c[n, m]
            if m > 0:
                down = ratio * _weight(m) / _weight(m - 1) * (n - m + 1) * (n - m + 2)
                out[0, n + 1, m - 1] += 0.5 * np.sqrt(down) * c[n, m]
                out[1, n + 1, m - 1] += 0.5 * np.sqrt(down) * 1j * c[n, m]
    out[:, :, 0].imag = 0.0  # of order 0 there is no sine
    return out[0], out[1], out[2]


def harmonic_table(C: Array, S: Array) -> tuple[Array, int, int]:
    """The table (TERMS * k,) of a field without its sphere, and the highest n and m in it.

    C, S: (n + 1, n + 1), fully normalised, by degree and order; those of degree 0 are left out.
    """
    c = C - 1j * S
    c[0, 0] = 0.0
    x, y, z = _derivatives(c)
    xx, xy, xz = _derivatives(x)
    _, _, yz = _derivatives(y)
    _, _, zz = _derivatives(z)
    degree = len(zz) - 1
    order = min(int(np.nonzero(np.abs(c).sum(axis=0))[0].max(initial=0)) + 2, degree)
    rows = []
    for m in range(order + 1):
        for n in range(m, degree + 1):
            first, second = np.sqrt((2 * m + 1) / max(2 * m, 1)) * (np.sqrt(2.0) ** (m == 1)), 0.0
            if n > m:
                first = np.sqrt((2 * n + 1) * (2 * n - 1) / ((n - m) * (n + m)))
            if n > m + 1:
                second = (2 * n + 1) * (n + m - 1) * (n - m - 1)
                second = np.sqrt(second / ((2 * n - 3) * (n - m) * (n + m)))
            sums = [s[n, m] if n < len(s) else 0j for s in (x, y, z, xx, xy, xz, yz, zz)]
            rows.append([first, second, *(part for s in sums for part in (s.real, -s.imag))])
    return np.array(rows).ravel(), degree, order


@jit
def harmonic_pull(
    table: Array, degree: int, order: int, gm: float, radius: float, r: Array
) -> tuple[Array, Array]:
    """Acceleration (3,), m/s^2, and its gradient (3, 3), 1/s^2, of the harmonics of a table.

    table, degree, order: see `harmonic_table`; gm: m^3/s^2; radius: m; r: (3,), m, from the Earth's
    centre; all in Earth-fixed axes.
    """
    r2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    scale = radius / r2
    x, y, z, near = r[0] * scale, r[1] * scale, r[2] * scale, radius * scale
    sums = np.zeros(8)
    v_m, w_m = np.sqrt(near), 0.0  # of n = m
    k = 0
    for m in range(order + 1):
        if m > 0:
            v_m, w_m = table[k] * (x * v_m - y * w_m), table[k] * (x * w_m + y * v_m)
        v, w, v_before, w_before = v_m, w_m, 0.0, 0.0
        for n in range(m, degree + 1):
            if n > m:
                a, b = table[k] * z, table[k + 1] * near
                v, v_before = a * v - b * v_before, v
                w, w_before = a * w - b * w_before, w
            for i in range(8):
                sums[i] += table[k + 2 + 2 * i] * v + table[k + 3 + 2 * i] * w
            k += TERMS
    g, G = np.empty(3), np.empty((3, 3))
    each = gm / (radius * radius)
    for i in range(3):
        g[i] = each * sums[i]
    each /= radius
    G[0, 0], G[0, 1], G[0, 2] = each * sums[3], each * sums[4], each * sums[5]
    G[1, 0], G[1, 1], G[1, 2] = G[0, 1], -each * (sums[3] + sums[7]), each * sums[6]
    G[2, 0], G[2, 1], G[2, 2] = G[0, 2], G[1, 2], each * sums[7]
    return g, G
