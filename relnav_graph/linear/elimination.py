"""A Gauss-Newton step over a whole pass: linearise and eliminate epoch by epoch, compiled.

The pass is a chain of epochs. Going forward in time, the rows of each epoch (what is known of
it from before, its measurements, the interval that follows) are brought to triangular form
by orthogonal reflections: a square-root information filter (Bierman 1977; Kaminski, Bryson,
Schmidt 1971). No normal equations are formed, so that any ratio of process to state noise will
do. With y_k the step of epoch k:

    Q^T [V, 0, v; H, 0, -r; A, B, -e] = [R, S, d; 0, V', v'; 0, 0, rest]

Here V y_k = v is what is known from before, r + H y_k the measurements, e + A y_k + B y_k+1
the interval, and V', v' what is known of the next epoch. R y_k + S y_k+1 = d is the
conditional of epoch k given the next one. Back substitution gives the step and all marginal
covariances. `relnav_graph.linear.gtsam_chain` has GTSAM do the same with the same rows, as the
check.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import types

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import INDEX_MATRIX, INDICES, MATRIX, STACK, VECTOR
from relnav_graph.core.problem import Prior
from relnav_graph.core.state import Layout
from relnav_graph.errors import EstimationError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.intervals import interval_row
from relnav_graph.linear.rows import observe, propagate
from relnav_graph.linear.tables import TABLES, Tables
from relnav_graph.linear.whitening import inverse_cholesky
from relnav_graph.maths import dense
from relnav_graph.maths.dense import SPARE, householder, inverse_upper, sandwich

__all__ = ["Anchor", "Conditionals", "System", "anchor_of", "linearize"]


@dataclass(frozen=True, eq=False)
class Anchor:
    """What is known of the first epoch beforehand: W local(x, x_0) - d ~ N(0, I).

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


@jit
def _put_rows(a: Array, row: int, e: Array, A: Array) -> float:
    """Write the equations ``A y = -e`` into a, from `row` on; returns ``|e|^2``.

    e: (rows,); A: (rows, n); -e goes to column n of a, A to the columns before it.
    """
    squares, n = 0.0, A.shape[1]
    dense.put_block(a, row, 0, A, 1.0)
    for i in range(e.shape[0]):
        a[row + i, n] = -e[i]
        squares += e[i] * e[i]
    return squares


@jit
def _largest(A: Array) -> float:
    """The largest magnitude in A (rows, columns)."""
    most = 0.0
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            most = max(most, abs(A[i, j]))
    return most


@jit_loop(
    TABLES,
    *(INDICES, INDICES, INDEX_MATRIX, MATRIX, VECTOR, STACK, VECTOR, MATRIX, MATRIX),
    *(STACK, STACK, MATRIX, STACK, INDICES, VECTOR, INDICES),
)
def _sweep(
    tables: Tables,
    epoch_offsets: Indices,
    row_offsets: Indices,
    kinds: Indices,
    x: Array,
    weight: Array,
    whiten: Array,
    prior_e: Array,
    prior_A: Array,
    damping: Array,
    R: Array,
    S: Array,
    d: Array,
    known: Array,
    status: Indices,
    cost: Array,
    failure: Indices,
) -> None:
    """Fill the conditionals R, S, d at the trajectory x (N, size): the head of this module.

    whiten (N - 1, n, n), weight (observations,): as of `linearize`; prior_e (n,), prior_A
    (n, n): rows of the anchor; damping (N, n): diagonals of further rows, or (0, n) for none.
    Fills R (N, n, n), S (N - 1, n, n), d (N, n); known (N, n, n + 1): U, u of each epoch, see
    `System`, or (0, n, n + 1) for none; status (observations,); cost (1,): half the sum of the
    squared residuals; failure (3,): interval, process, status.
    """
    count, n = d.shape
    most, damped = 0, damping.shape[0] > 0
    for k in range(count):
        most = max(most, row_offsets[k + 1] - row_offsets[k])
    a = np.zeros((n + max(n, most + (n if damped else 0)), 2 * n + 1 + SPARE))
    r_all, H_all = np.empty(most), np.empty((most, n))
    x_next, F, Q = np.zeros(x.shape[1]), np.empty((n, n)), np.empty((n, n))
    e, A, B = np.empty(n), np.empty((n, n)), np.empty((n, n))
    # Columns of a: this epoch, the right-hand side, the next epoch.
    squares = _put_rows(a, 0, prior_e, prior_A)
    for k in range(count):
        give_way(0)
        first, last = epoch_offsets[k], epoch_offsets[k + 1]
        m = row_offsets[k + 1] - row_offsets[k]
        r, H = r_all[:m], H_all[:m]
        observe(tables, first, last, 0, x, weight[first:last], r, H, status[first:last])
        squares += _put_rows(a, n, r, H)
        rows = n + m
        if damped:
            for i in range(n):
                for j in range(n + 1):
                    a[rows + i, j] = 0.0
                a[rows + i, i] = damping[k, i]
            rows += n
        householder(a, n, 0, rows, n + 1)
        if known.shape[0] > 0:
            for i in range(n):
                for j in range(i, n + 1):
                    known[k, i, j] = a[i, j]
        if k < count - 1:
            process, code = propagate(tables, k, x[k], x_next, F, Q)
            if code != 0:
                failure[0], failure[1], failure[2] = k, process, code
                return
            interval_row(x_next, x[k + 1], F, whiten[k], kinds, e, A, B)
            for i in range(n):
                for j in range(n + 1, 2 * n + 1):
                    a[i, j] = 0.0
            dense.put_block(a, n, n + 1, B, 1.0)
            squares += _put_rows(a, n, e, A)
            below = n
            # Reflections lose small rows that stand above large ones (Cox and Higham 1998), such
            # as those of an interval of microseconds: the larger rows come first.
            if _largest(A) > _largest(a[:n, :n]):
                for i in range(n):
                    for j in range(2 * n + 1):
                        a[i, j], a[n + i, j] = a[n + i, j], a[i, j]
                below = 0
            householder(a, n, below, 2 * n, 2 * n + 1)
        for i in range(n):
            d[k, i] = a[i, n]
            for j in range(n):
                R[k, i, j] = a[i, j] if j >= i else 0.0
                if k < count - 1:
                    S[k, i, j] = a[i, n + 1 + j]
                    a[i, j] = a[n + i, n + 1 + j]
            a[i, n] = a[n + i, n]
    cost[0] = 0.5 * squares


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
class Conditionals:
    """``R_k y_k + S_k y_k+1 = d_k`` of every epoch, y_k its step.

    R (N, n, n), upper triangular; S (N - 1, n, n); d (N, n).
    """

    R: Array
    S: Array
    d: Array

    def solution(self, end: Array | None = None) -> Array:
        """The Gauss-Newton step ``y_k = R_k^-1 (d_k - S_k y_k+1)``, (N, n).

        end (n,): the step of the last epoch, where data beyond this part determine it.
        """
        out = np.empty_like(self.d)
        last = self.d[-1] if end is None else np.ascontiguousarray(end)
        _back_substitute(self.R, self.S, self.d, last, int(end is not None), out)
        return out

    def covariances(self, end: Array | None = None) -> Array:
        """Marginal covariances ``P_k = R_k^-1 (I + S_k P_k+1 S_k^T) R_k^-T``, (N, n, n).

        end (n, n): that of the last epoch, where data beyond this part determine it.
        """
        P = np.empty_like(self.R)
        if end is not None:
            P[-1] = end
        _covariances(self.R, self.S, P, int(end is not None))
        return P

    def anchor(self, x: Array) -> Anchor:
        """What all data up to the last epoch say of it, at x (size,), where it was linearised."""
        return Anchor(x, self.R[-1], self.d[-1])

    def last_covariance(self) -> Array:
        """``(R_N^T R_N)^-1`` (n, n), of the last epoch."""
        inverse = np.linalg.inv(self.R[-1])
        return inverse @ inverse.T

    def decrease(self) -> float:
        """``|d|^2 / 2``: by how much the step lowers the cost of the linear system."""
        return 0.5 * float(np.sum(self.d**2))


@dataclass(frozen=True, eq=False)
class System:
    """A pass linearised at the trajectory x (N, size) and eliminated.

    cost: half the sum of all squared whitened residuals; status (observations,). known
    (N, n, n + 1), where asked for, otherwise (0, n, n + 1): U, u of each epoch. All data up to
    an epoch tell of its step y that U y - u ~ N(0, I).
    """

    x: Array
    cost: float
    status: Indices
    conditionals: Conditionals
    known: Array


def linearize(
    assembly: Assembly,
    anchor: Anchor,
    x: Array,
    whiten: Array,
    weight: Array,
    damping: Array | None = None,
    keep: bool = False,
    into: Conditionals | None = None,
) -> System:
    """Linearise at the trajectory x (N, size) and eliminate.

    whiten (N - 1, n, n): whitening matrices of the process noise; weight (observations,):
    square roots of robust weights; damping (N, n): diagonals D_k of further rows D_k y_k = 0;
    keep: whether to fill `System.known`; into: conditionals of a pass of this length that are
    no longer needed, overwritten, since fresh memory costs a long pass a third of its time.
    Raises ModelError or GeometryError when a model cannot be evaluated, EstimationError when
    the system is not finite or does not determine every epoch.
    """
    count, n = len(x), assembly.layout.dim
    if into is None:
        R, S = np.empty((count, n, n)), np.empty((count - 1, n, n))
        into = Conditionals(R, S, np.empty((count, n)))
    R, S, d = into.R, into.S, into.d
    status, cost = np.zeros(assembly.observations, dtype=np.int64), np.zeros(1)
    known, failure = np.zeros((count * keep, n, n + 1)), np.zeros(3, dtype=np.int64)
    _sweep(
        *(assembly.tables, assembly.epoch_offsets, assembly.row_offsets),
        *(assembly.layout.kinds, x, weight, whiten, *anchor.rows(assembly.layout, x[0])),
        *(np.zeros((0, n)) if damping is None else damping, R, S, d),
        *(known, status, cost, failure),
    )
    assembly.check(status)
    assembly.check_propagated(failure)
    diagonals = np.einsum("kii->ki", R)
    # A NaN in R spreads to the R of all later epochs: looking at the last one is enough.
    if not (np.isfinite(d).all() and np.isfinite(R[-1]).all()):
        raise EstimationError("the factor graph's linear system is not finite")
    if not diagonals.all():
        k = int(np.nonzero(~diagonals.all(axis=1))[0][0])
        layout = assembly.layout
        bad = [b.name for b in layout if not diagonals[k, layout.tangent(b.name)].all()]
        raise EstimationError(
            f"the factor graph does not determine {', '.join(bad)} at t = {assembly.times[k]} s"
        )
    return System(x, float(cost[0]), status, into, known)
