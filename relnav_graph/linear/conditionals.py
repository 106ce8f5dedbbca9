"""What elimination leaves: each epoch given the next one and the static blocks.

With y_k the step of epoch k and y_s that of the static blocks,

    R_k y_k + S_k y_k+1 + T_k y_s = d_k,   R_s y_s = d_s

are solved from the last row up: the step of the whole pass and, by the same recursion, all
marginal covariances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import types
from scipy.linalg import block_diag, solve_triangular
from scipy.linalg.lapack import dtrtri

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit_loop
from relnav_graph.compiled.contracts import MATRIX, STACK, VECTOR
from relnav_graph.core.problem import Prior
from relnav_graph.core.state import Layout
from relnav_graph.linear.whitening import inverse_cholesky
from relnav_graph.maths import dense
from relnav_graph.maths.dense import inverse_upper, sandwich

__all__ = ["Anchor", "Conditionals", "Marginals", "anchor_of", "go_back", "grown"]


@dataclass(frozen=True, eq=False)
class Anchor:
    """What is known beforehand of the first epoch and the static blocks: W local(x, x_0) - d ~
    N(0, I).

    x (size,); W (n, n); d (n,). A prior, or the exact linear summary of an earlier part.
    """

    x: Array
    W: Array
    d: Array

    def rows(self, layout: Layout, x: Array) -> tuple[Array, Array]:
        """Whitened rows e + A y at x (size,), y the step: e (n,), A (n, n)."""
        if np.array_equal(x, self.x):
            return -self.d, self.W
        e = layout.local(self.x, x)
        return self.W @ e - self.d, self.W @ layout.right_jacobian_inverse(e)


def anchor_of(prior: Prior) -> Anchor:
    """The prior as an anchor: W the inverse Cholesky factor of its P, d = 0."""
    return Anchor(prior.x, inverse_cholesky("the prior", prior.P), np.zeros(len(prior.P)))


def grown(anchor: Anchor, prior: Prior) -> Anchor:
    """An anchor of the first blocks of a prior, with what the prior says of the blocks after these,
    which it correlates with nothing."""
    n, size = len(anchor.d), len(anchor.x)
    W = inverse_cholesky("the prior", prior.P[n:, n:])
    x, d = np.concatenate([anchor.x, prior.x[size:]]), np.concatenate([anchor.d, np.zeros(len(W))])
    return Anchor(x, block_diag(anchor.W, W), d)


@jit_loop(STACK, STACK, MATRIX, VECTOR, types.int64, MATRIX)
def _back_substitute(R: Array, S: Array, d: Array, end: Array, known: int, out: Array) -> None:
    """``y_k = R_k^-1 (d_k - S_k y_k+1)``, backwards, into out (N, n).

    known: 1 when `end` (n,) gives the step of the last epoch, 0 when R and d do.
    """
    count, n = d.shape
    for k in range(count - 1, -1, -1):
        give_way(k)
        for i in range(n - 1, -1, -1):
            value = d[k, i]
            if k < count - 1:
                for j in range(n):
                    value -= S[k, i, j] * out[k + 1, j]
            for j in range(i + 1, n):
                value -= R[k, i, j] * out[k, j]
            out[k, i] = value / R[k, i, i]
        if known and k == count - 1:
            for i in range(n):
                out[k, i] = end[i]


@jit_loop(STACK, STACK, STACK, types.int64)
def _covariances(R: Array, S: Array, P: Array, known: int) -> None:
    """``P_k = R_k^-1 (I + S_k P_k+1 S_k^T) R_k^-T``, backwards, into P (N, n, n).

    known: 1 when P holds that of the last epoch already, 0 to start from ``(R^T R)^-1``.
    """
    count, n = R.shape[0], R.shape[1]
    inner = dense.identity(n)
    if not known:
        sandwich(inverse_upper(R[count - 1]), inner, P[count - 1])
    for k in range(count - 2, -1, -1):
        give_way(0)
        sandwich(S[k], P[k + 1], inner)
        for i in range(n):
            inner[i, i] += 1.0
        sandwich(inverse_upper(R[k]), inner, P[k])


@dataclass(frozen=True, eq=False)
class Marginals:
    """Covariances: P (N, n, n) of the epochs; statics (m, m); cross (N, n, m) of both."""

    P: Array
    statics: Array
    cross: Array

    def whole(self, part: slice = slice(None)) -> Array:
        """Of each epoch, or some of them, and the static blocks together, (N, n + m, n + m)."""
        if not len(self.statics):
            return self.P[part]
        P, cross = self.P[part], self.cross[part]
        statics = np.broadcast_to(self.statics, (len(P), *self.statics.shape))
        return np.block([[P, cross], [cross.transpose(0, 2, 1), statics]])


def go_back(
    R: Array, S: Array, T: Array, own: Indices, P_end: Array, cross_end: Array, P_b: Array
) -> tuple[Array, Array]:
    """Covariances P (N, n, n) of epochs with a border b, and cross (N, n, m) of both, backwards.

        P_kb = -R_k^-1 (S_k P_k+1,b + T_k P_bb)
        P_k  =  R_k^-1 (I + [S T] P_(k+1,b) [S T]^T) R_k^-T

    R (N, n, n), S (N - 1, n, n), T (N, n, columns): their conditionals, given the states `own`
    (columns,) of the border; P_end (n, n), cross_end (n, m): of the last epoch; P_b (m, m): of the
    border.
    """
    count, n = R.shape[:2]
    P, cross = np.empty_like(R), np.empty((count, n, len(P_b)))
    P[-1], cross[-1] = P_end, cross_end
    rows, inside = P_b[own], P_b[np.ix_(own, own)]
    for k in range(count - 2, -1, -1):
        inverse = inverse_upper(R[k])
        to_next, to_border = inverse @ S[k], inverse @ T[k]
        mixed = to_next @ cross[k + 1][:, own] @ to_border.T
        P[k] = inverse @ inverse.T + to_next @ P[k + 1] @ to_next.T + mixed + mixed.T
        P[k] += to_border @ inside @ to_border.T
        cross[k] = -(to_next @ cross[k + 1] + to_border @ rows)
    return 0.5 * (P + P.transpose(0, 2, 1)), cross


@dataclass(frozen=True, eq=False)
class Conditionals:
    """``R_k y_k + S_k y_k+1 + T_k y_s = d_k`` of every epoch, and ``R_s y_s = d_s``.

    R (N, n, n), R_s (m, m), upper triangular; S (N - 1, n, n); T (N, n, m); d (N, n), d_s (m,).
    Arrays are filled by `relnav_graph.linear.elimination.linearize`.
    """

    R: Array
    S: Array
    d: Array
    T: Array
    R_s: Array
    d_s: Array

    @classmethod
    def empty(cls, count: int, n: int, m: int) -> Conditionals:
        """Memory for those of `count` epochs of n states and m static ones."""
        R, S, d = np.empty((count, n, n)), np.empty((count - 1, n, n)), np.empty((count, n))
        return cls(R, S, d, np.empty((count, n, m)), np.empty((m, m)), np.empty(m))

    @property
    def states(self) -> int:
        """Number of all states: of all epochs, and static ones."""
        return self.d.size + self.d_s.size

    def solution(self, end: Array | None = None) -> Array:
        """The Gauss-Newton step (N, n + m): y_k and, in each row again, y_s.

        end (n + m,): that of the last epoch, where data beyond this part determine it.
        """
        count, n = self.d.shape
        out, last = np.empty_like(self.d), self.d[-1]
        if end is not None:
            last = np.ascontiguousarray(end[:n])
        if not len(self.d_s):
            _back_substitute(self.R, self.S, self.d, last, int(end is not None), out)
            return out
        y_s = solve_triangular(self.R_s, self.d_s) if end is None else end[n:]
        _back_substitute(self.R, self.S, self.d - self.T @ y_s, last, int(end is not None), out)
        return np.hstack([out, np.broadcast_to(y_s, (count, len(y_s)))])

    def marginals(self, end: Array | None = None) -> Marginals:
        """Marginal covariances of all epochs and of the static blocks.

        end (n + m, n + m): that of the last epoch, where data beyond this part determine it.
        """
        count, n = self.d.shape
        m, P = len(self.d_s), np.empty_like(self.R)
        if not m:
            if end is not None:
                P[-1] = end
            _covariances(self.R, self.S, P, int(end is not None))
            return Marginals(P, np.empty((0, 0)), np.empty((count, n, 0)))
        if end is None:
            end = self.last_covariance()
        P_s = end[n:, n:]
        P, cross = go_back(*(self.R, self.S, self.T, np.arange(m), end[:n, :n], end[:n, n:], P_s))
        return Marginals(P, P_s, cross)

    def covariances(self, end: Array | None = None) -> Array:
        """Marginal covariances of the epochs alone, (N, n, n); see `marginals`."""
        return self.marginals(end).P

    def since(self, k: int) -> Conditionals:
        """Those without the first k epochs."""
        return Conditionals(self.R[k:], self.S[k:], self.d[k:], self.T[k:], self.R_s, self.d_s)

    def after(self, before: Conditionals, keep: int) -> Conditionals:
        """These after the first `keep` epochs of others."""
        pairs = (before.R, self.R), (before.S, self.S), (before.d, self.d), (before.T, self.T)
        R, S, d, T = (np.concatenate([old[:keep], new]) for old, new in pairs)
        return Conditionals(R, S, d, T, self.R_s, self.d_s)

    def anchor(self, x: Array) -> Anchor:
        """What all data up to the last epoch say of it and of the static blocks, at x (size,),
        where it was linearised."""
        return Anchor(x, self._last(), np.concatenate([self.d[-1], self.d_s]))

    def _last(self) -> Array:
        """``[R_N, T_N; 0, R_s]``."""
        n, m = self.d.shape[1], len(self.d_s)
        out = np.zeros((n + m, n + m))
        out[:n, :n], out[:n, n:], out[n:, n:] = self.R[-1], self.T[-1], self.R_s
        return out

    def last_covariance(self) -> Array:
        """Of the last epoch and the static blocks, (n + m, n + m)."""
        triangle = self._last()
        inverse = dtrtri(triangle)[0] if len(self.d_s) else np.linalg.inv(triangle)
        return inverse @ inverse.T

    def decrease(self) -> float:
        """``|d|^2 / 2``: by how much the step lowers the cost of the linear system."""
        return 0.5 * float(np.sum(self.d**2) + np.sum(self.d_s**2))
