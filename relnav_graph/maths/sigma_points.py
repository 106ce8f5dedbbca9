"""Sigma points on the state manifold, and square roots of covariances made of them.

Points x (+) (+-c r_i), r_i the rows of R, P = R^T R upper triangular (the columns of the lower
Cholesky factor), and x itself, have the weights of `weights_of`. Of values y_i, one for each point:

    mean = sum w_i y_i,   cov = sum v_i (y_i - mean) (y_i - mean)^T,   w_i = v_i but for i = 0

A triangle of the differences, times sqrt(v_i), and of the noise's root, one below the other, is
that covariance's root (van der Merwe 2004); a central point of negative weight is taken out of it
by a downdate. Means of attitudes are sought by steps on the manifold, differences are tangent to it
(Crassidis and Markley 2003).
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.errors import InputError
from relnav_graph.maths import dense
from relnav_graph.maths.dense import cholesky, sum_of_squares
from relnav_graph.maths.manifold import local, retract
from relnav_graph.maths.reflections import SPARE, householder

__all__ = [
    "CENTRE",
    "EACH",
    "MEAN",
    "SPREAD",
    "draw",
    "factor",
    "mean_of",
    "moments",
    "regress",
    "root_of",
    "triangle",
    "upper",
    "weights_of",
]

#: Steps towards a mean, at most, and the length of the last one, rad or SI of its tangent.
STEPS, SHORT = 20, 1e-12
#: A pivot of Q below this fraction of its diagonal is rounding.
ROUNDING = 1e-14
# Places among the weights: c, w_0, v_0, and w_i = v_i of all others.
SPREAD, MEAN, CENTRE, EACH = 0, 1, 2, 3


def weights_of(n: int, alpha: float, beta: float, kappa: float) -> Array:
    """Weights (4,) of n states: c = alpha sqrt(n + kappa), w_0, v_0, w_i = 1 / (2 c^2).

        w_0 = 1 - n / c^2,  v_0 = w_0 + 1 - alpha^2 + beta

    The scaled transformation: Julier 2002; van der Merwe 2004, eqs. 3.11 and 3.12. Without unit.
    Raises InputError on a c that is not real.
    """
    c2 = alpha**2 * (n + kappa)
    if not c2 > 0:
        raise InputError(
            f"sigma points: found alpha = {alpha}, kappa = {kappa} for {n} states,"
            " expected alpha^2 (n + kappa) > 0"
        )
    return np.array([np.sqrt(c2), 1 - n / c2, 2 - n / c2 - alpha**2 + beta, 0.5 / c2])


@jit
def draw(x: Array, R: Array, c: float, kinds: Indices, points: Array) -> None:
    """Sigma points (1 + 2 n, size) of x (size,) and R (n, n): x, then those at +c, then at -c."""
    n = R.shape[0]
    dense.put_vector(points[0], 0, x)
    d = np.empty(n)
    for i in range(n):
        for sign in range(2):
            for j in range(n):
                d[j] = (1.0 - 2.0 * sign) * c * R[i, j]
            dense.put_vector(points[1 + i + sign * n], 0, retract(x, d, kinds))


@jit
def mean_of(points: Array, n: int, weights: Array, kinds: Indices) -> Array:
    """The state (size,) about which the weighted differences of points (count, size) add up to
    none."""
    x: Array = points[0].copy()
    for _ in range(STEPS):
        step = np.zeros(n)
        for i in range(points.shape[0]):
            w = weights[MEAN] if i == 0 else weights[EACH]
            d = local(x, points[i], kinds, n)
            for j in range(n):
                step[j] += w * d[j]
        x = retract(x, step, kinds)
        curved = 0.0
        for k in range(kinds.shape[0]):
            if kinds[k, 0]:
                curved += sum_of_squares(step[kinds[k, 2] : kinds[k, 2] + 3])
        if not curved > SHORT * SHORT:  # vectors are there after one step
            break
    return x


@jit
def root_of(Q: Array, out: Array) -> None:
    """Rows ``out^T out = Q`` for a positive semi-definite Q (q, q), out (q, q): states without
    noise have none."""
    q = Q.shape[0]
    for j in range(q):
        for i in range(q):
            out[j, i] = Q[j, i] if i >= j else 0.0
    for j in range(q):
        if not out[j, j] > ROUNDING * Q[j, j]:
            for i in range(j, q):
                out[j, i] = 0.0
            continue
        pivot = np.sqrt(out[j, j])
        for i in range(j, q):
            out[j, i] /= pivot
        for l in range(j + 1, q):
            f = out[j, l]
            if f != 0.0:
                for i in range(l, q):
                    out[l, i] -= f * out[j, i]


@jit
def triangle(a: Array, rows: int, centre: Array, v: float) -> bool:
    """Bring ``a[:rows, :m]`` (.., m + SPARE) to a triangle with ``R^T R = a^T a + v centre
    centre^T``, in place; centre (m,). False where there is none: v is negative, and too large."""
    m = centre.shape[0]
    root, x = np.sqrt(abs(v)), np.empty(m)
    for j in range(m):
        x[j] = root * centre[j]
    if v > 0.0:
        dense.put_vector(a[rows], 0, x)
        rows += 1
    householder(a, m, 0, rows, m)
    if v >= 0.0:
        return True
    for k in range(m):  # the downdate, by hyperbolic rotations
        square = (a[k, k] - x[k]) * (a[k, k] + x[k])
        if not square > 0.0:
            return False
        r = np.sqrt(square)
        c, s = r / a[k, k], x[k] / a[k, k]
        a[k, k] = r
        for j in range(k + 1, m):
            a[k, j] = (a[k, j] - s * x[j]) / c
            x[j] = c * x[j] - s * a[k, j]
    return True


@jit
def upper(a: Array, first: int, out: Array) -> None:
    """The triangle (n, n) that stands in `a` from (first, first) on, into out (n, n)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[0]):
            out[i, j] = a[first + i, first + j] if j >= i else 0.0


@jit
def factor(P: Array, R: Array) -> bool:
    """``R^T R = P``, both (n, n), R upper triangular; False unless P is positive definite."""
    L = P.copy()
    if not cholesky(L):
        return False
    for i in range(P.shape[0]):
        for j in range(P.shape[0]):
            R[i, j] = L[j, i]
    return True


@jit
def _average(Y: Array, weights: Array, mean: Array) -> None:
    """Fill mean (rows,) with the weighted mean of Y (1 + 2 n, rows)."""
    for a in range(mean.shape[0]):
        mean[a] = 0.0
        for i in range(Y.shape[0]):
            mean[a] += (weights[MEAN] if i == 0 else weights[EACH]) * Y[i, a]


@jit
def moments(Y: Array, weights: Array, mean: Array, S: Array) -> None:
    """Mean (rows,) and covariance S (rows, rows) of Y (1 + 2 n, rows), the measurement's in it."""
    rows, count = mean.shape[0], Y.shape[0]
    _average(Y, weights, mean)
    for a in range(rows):
        for b in range(a + 1):
            value = 1.0 if a == b else 0.0
            for i in range(count):
                w = weights[CENTRE] if i == 0 else weights[EACH]
                value += w * (Y[i, a] - mean[a]) * (Y[i, b] - mean[b])
            S[a, b] = S[b, a] = value


@jit
def regress(Y: Array, R: Array, weights: Array, roots: Array, mean: Array, H: Array) -> bool:
    """The rows ``mean + H d + e`` that points make of residuals, whitened.

    Y (1 + 2 n, rows): whitened residuals at the points drawn with R (n, n); roots (rows,): square
    roots of the rows' weights. Fills mean (rows,), H (rows, n). e has the covariance of the
    measurement, the unit matrix, and of what of the points is not linear:

        [R, R H^T; 0, W],  W^T W = I + sum v_i (y_i - mean) (y_i - mean)^T - H P H^T

    is the triangle of both together, by which the rows are whitened once more. False when it is not
    positive definite.
    """
    n, rows = R.shape[0], mean.shape[0]
    root, spread = np.sqrt(weights[EACH]), weights[SPREAD]
    _average(Y, weights, mean)
    joint, centre = np.zeros((rows + 2 * n + 1, rows + n + SPARE)), np.zeros(rows + n)
    for a in range(rows):
        joint[2 * n + a, n + a] = 1.0
        centre[n + a] = roots[a] * (Y[0, a] - mean[a])
        for i in range(2 * n):
            joint[i, n + a] = root * roots[a] * (Y[1 + i, a] - mean[a])
    for i in range(2 * n):
        f = root * spread if i < n else -root * spread
        for j in range(n):
            joint[i, j] = f * R[i % n, j]
    if not triangle(joint, rows + 2 * n, centre, weights[CENTRE]):
        return False
    for a in range(rows):
        mean[a] *= roots[a]
        for i in range(n - 1, -1, -1):
            H[a, i] = joint[i, n + a]
            for l in range(i + 1, n):
                H[a, i] -= joint[i, l] * H[a, l]
            H[a, i] /= joint[i, i]
    for a in range(rows):  # W^-T
        for b in range(a):
            f = joint[n + b, n + a]
            mean[a] -= f * mean[b]
            for j in range(n):
                H[a, j] -= f * H[b, j]
        mean[a] /= joint[n + a, n + a]
        for j in range(n):
            H[a, j] /= joint[n + a, n + a]
    return True
