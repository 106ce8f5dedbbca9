"""A Gauss-Newton step over a whole pass: linearise and eliminate epoch by epoch, compiled.

The pass is a chain of epochs. Going forward in time, the rows of each epoch (what is known of
it from before, its measurements, the interval that follows) are brought to triangular form
by orthogonal reflections: a square-root information filter (Bierman 1977; Kaminski, Bryson,
Schmidt 1971). No normal equations are formed, so that any ratio of process to state noise will
do. With y_k the step of epoch k:

    Q^T [V, 0, v; H, 0, -r; A, B, -e] = [R, S, d; 0, V', v'; 0, 0, rest]

Here V y_k = v is what is known from before, r + H y_k the measurements, e + A y_k + B y_k+1
the interval, and V', v' what is known of the next epoch. R y_k + S y_k+1 = d is the
conditional of epoch k given the next one; `relnav_graph.linear.conditionals` goes back through
these.

Static blocks, which have one value for the pass, are a border: their columns come last, in all
rows. Rows that are left over when an epoch is eliminated tell of them alone; they are collected,
and folded into one triangle many at a time, which LAPACK does fast.

`relnav_graph.linear.gtsam_chain` has GTSAM do the same with the same rows, as the check.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import types
from scipy.linalg.lapack import dtpqrt

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import INDEX_MATRIX, INDICES, MATRIX, STACK, VECTOR
from relnav_graph.errors import EstimationError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Conditionals
from relnav_graph.linear.intervals import interval_row
from relnav_graph.linear.rows import observe, propagate
from relnav_graph.linear.tables import TABLES, Tables
from relnav_graph.maths import dense
from relnav_graph.maths.dense import SPARE, householder

__all__ = ["System", "linearize"]

#: Rows of the static blocks that are folded into their triangle at once.
FOLDED = 512


@jit
def _put_rows(a: Array, row: int, n: int, e: Array, A: Array) -> float:
    """Write the equations ``A y = -e`` into a, from `row` on; returns ``|e|^2``.

    e: (rows,); A: (rows, n + m); -e goes to column n of a, between the columns of A.
    """
    squares = 0.0
    for i in range(e.shape[0]):
        for j in range(n):
            a[row + i, j] = A[i, j]
        for j in range(n, A.shape[1]):
            a[row + i, j + 1] = A[i, j]
        a[row + i, n] = -e[i]
        squares += e[i] * e[i]
    return squares


@jit
def _largest(A: Array, n: int) -> float:
    """The largest magnitude in the first n rows and columns of A."""
    most = 0.0
    for i in range(n):
        for j in range(n):
            most = max(most, abs(A[i, j]))
    return most


#: Of a sweep that is under way: the next epoch, how many rows of `a` are known of it, and how many
#: rows of `left` are filled.
NEXT, CARRIED, FILLED = 0, 1, 2


@jit_loop(
    TABLES,
    *(INDICES, INDICES, INDEX_MATRIX, MATRIX, VECTOR, STACK, MATRIX, types.int64, INDICES),
    *(MATRIX, MATRIX, STACK, STACK, STACK, MATRIX, STACK, INDICES, VECTOR, INDICES),
)
def _sweep(
    tables: Tables,
    epoch_offsets: Indices,
    row_offsets: Indices,
    kinds: Indices,
    x: Array,
    weight: Array,
    whiten: Array,
    damping: Array,
    end: int,
    at: Indices,
    a: Array,
    left: Array,
    R: Array,
    S: Array,
    T: Array,
    d: Array,
    known: Array,
    status: Indices,
    cost: Array,
    failure: Indices,
) -> None:
    """Fill the conditionals R, S, T, d at the trajectory x (N, size): the head of this module.

    whiten (N - 1, n, n), weight (observations,): as of `linearize`; kinds: of the n states that
    move; damping (N, n): diagonals of further rows, or (0, n) for none. at (3,): where the sweep
    stands, see `NEXT`; it goes on to epoch `end`, or until `left` is full. a (rows, columns): the
    rows under way. left (rows, m + 1): rows of the static blocks and the right-hand side that are
    left over. Fills R (N, n, n), S (N - 1, n, n), T (N, n, m), d (N, n); known (N, n, n + m + 1):
    U, u, V of each epoch, see `System`, or (0, ...) for none; status (observations,). Adds half
    the sum of the squared residuals to cost (1,). failure (3,): interval, process, status.
    """
    count, n, m = d.shape[0], d.shape[1], T.shape[2]
    most, damped, width = 0, damping.shape[0] > 0, n + 1 + m
    for k in range(count):
        most = max(most, row_offsets[k + 1] - row_offsets[k])
    r_all, H_all = np.empty(most), np.empty((most, n + m))
    x_next, F, Q = x[0].copy(), np.empty((n, n + m)), np.empty((n, n))
    e, A, B = np.empty(n), np.empty((n, n + m)), np.empty((n, n))
    # Columns of a: this epoch, the right-hand side, static blocks, the next epoch.
    squares, carried, filled = 0.0, at[CARRIED], at[FILLED]
    for k in range(at[NEXT], end):
        give_way(0)
        first, last = epoch_offsets[k], epoch_offsets[k + 1]
        height = row_offsets[k + 1] - row_offsets[k]
        if m > 0 and filled + carried + height > left.shape[0]:
            at[NEXT], at[CARRIED], at[FILLED] = k, carried, filled
            cost[0] += 0.5 * squares
            return
        r, H = r_all[:height], H_all[:height]
        observe(tables, first, last, 0, x, weight[first:last], r, H, status[first:last])
        squares += _put_rows(a, carried, n, r, H)
        rows = carried + height
        if damped:
            for i in range(n):
                for j in range(width):
                    a[rows + i, j] = 0.0
                a[rows + i, i] = damping[k, i]
            rows += n
        householder(a, n, 0, rows, width)
        if m > 0:
            for i in range(n, rows):
                for j in range(m):
                    left[filled, j] = a[i, n + 1 + j]
                left[filled, m] = a[i, n]
                filled += 1
        if known.shape[0] > 0:
            for i in range(n):
                for j in range(i, width):
                    known[k, i, j] = a[i, j]
        if k < count - 1:
            process, code = propagate(tables, k, x[k], x_next, F, Q)
            if code != 0:
                failure[0], failure[1], failure[2] = k, process, code
                return
            interval_row(x_next, x[k + 1], F, whiten[k], kinds, e, A, B)
            for i in range(n):
                for j in range(width, n + width):
                    a[i, j] = 0.0
            dense.put_block(a, n, width, B, 1.0)
            squares += _put_rows(a, n, n, e, A)
            below = n
            # Reflections lose small rows that stand above large ones (Cox and Higham 1998), such
            # as those of an interval of microseconds: the larger rows come first.
            if _largest(A, n) > _largest(a, n):
                for i in range(n):
                    for j in range(n + width):
                        a[i, j], a[n + i, j] = a[n + i, j], a[i, j]
                below = 0
            householder(a, n, below, 2 * n, n + width)
        for i in range(n):
            d[k, i] = a[i, n]
            for j in range(m):
                T[k, i, j] = a[i, n + 1 + j]
            for j in range(n):
                R[k, i, j] = a[i, j] if j >= i else 0.0
                if k < count - 1:
                    S[k, i, j] = a[i, width + j]
                    a[i, j] = a[n + i, width + j]
            for j in range(n, width):
                a[i, j] = a[n + i, j]
        carried = n
    at[NEXT], at[CARRIED], at[FILLED] = end, carried, filled
    cost[0] += 0.5 * squares


@dataclass(frozen=True, eq=False)
class System:
    """A pass linearised at the trajectory x (N, size) and eliminated.

    cost: half the sum of all squared whitened residuals; status (observations,). known
    (N, n, n + m + 1) and statics (N, m + 1, m + 1), where asked for, otherwise without epochs:
    [U, u, V] and [W, w; 0, rest] of each epoch. All data up to an epoch tell of its step y, and
    that of the static blocks y_s, that U y + V y_s - u ~ N(0, I) and W y_s - w ~ N(0, I).
    """

    x: Array
    cost: float
    status: Indices
    conditionals: Conditionals
    known: Array
    statics: Array


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
    square roots of robust weights; damping (N, n + m): diagonals D_k of further rows D_k y_k = 0,
    those of the static blocks in the first row; keep: whether to fill `System.known`; into:
    conditionals of a pass of this length that are no longer needed, overwritten, since fresh
    memory costs a long pass a third of its time. Raises ModelError or GeometryError when a model
    cannot be evaluated, EstimationError when the system is not finite or does not determine every
    epoch and static block.
    """
    count, layout = len(x), assembly.layout
    n, m = layout.moving.dim, layout.statics.dim
    if into is None:
        into = Conditionals.empty(count, n, m)
    status, cost = np.zeros(assembly.observations, dtype=np.int64), np.zeros(1)
    known, failure = np.zeros((count * keep, n, n + m + 1)), np.zeros(3, dtype=np.int64)
    triangles = np.zeros((count * keep, m + 1, m + 1))
    moving = np.zeros((0, n)) if damping is None else np.ascontiguousarray(damping[:, :n])
    heights = np.diff(assembly.row_offsets)
    most = n + m + int(heights.max(initial=0)) + len(moving[:1]) * n
    a = np.zeros((max(most, 2 * n), 2 * n + 1 + m + SPARE))
    at, left = np.array([0, n + m, 0]), np.empty((max(FOLDED, most) if m else 0, m + 1))
    e, A = anchor.rows(layout, x[0])
    cost[0] = 0.5 * _put_rows(a, 0, n, e, np.ascontiguousarray(A))
    triangle = np.zeros((m + 1, m + 1), order="F")
    if damping is not None:
        triangle[np.arange(m), np.arange(m)] = damping[0, n:]
    while at[NEXT] < count and not failure[2]:
        begun = at[NEXT]
        _sweep(
            *(assembly.tables, assembly.epoch_offsets, assembly.row_offsets, layout.moving.kinds),
            *(x, weight, whiten, moving, begun + 1 if keep and m else count, at, a, left),
            *(into.R, into.S, into.T, into.d, known, status, cost, failure),
        )
        if m:
            triangle = _folded(triangle, left[: at[FILLED]])
            at[FILLED] = 0
            triangles[begun : at[NEXT] * keep] = triangle
    assembly.check(status)
    assembly.check_propagated(failure)
    into.R_s[:], into.d_s[:] = triangle[:m, :m], triangle[:m, m]
    _check(assembly, into)
    return System(x, float(cost[0]), status, into, known, triangles)


def _folded(triangle: Array, rows: Array) -> Array:
    """The triangle (m + 1, m + 1) of a triangle and further rows (k, m + 1)."""
    out, _, _, info = dtpqrt(0, min(32, len(triangle)), triangle, rows, overwrite_a=True)
    assert info == 0
    return np.asarray(out)


def _check(assembly: Assembly, c: Conditionals) -> None:
    """Raise EstimationError unless conditionals are finite and determine every state."""
    # A NaN in R spreads to the R of all later epochs: looking at the last one is enough.
    if not all(np.isfinite(part).all() for part in (c.d, c.R[-1], c.R_s, c.d_s)):
        raise EstimationError("the factor graph's linear system is not finite")
    diagonals = np.einsum("kii->ki", c.R)
    layout = assembly.layout.moving
    if not diagonals.all():
        k = int(np.nonzero(~diagonals.all(axis=1))[0][0])
        bad = [b.name for b in layout if not diagonals[k, layout.tangent(b.name)].all()]
        raise EstimationError(
            f"the factor graph does not determine {', '.join(bad)} at t = {assembly.times[k]} s"
        )
    layout, diagonal = assembly.layout.statics, np.diag(c.R_s)
    if not diagonal.all():
        bad = [b.name for b in layout if not diagonal[layout.tangent(b.name)].all()]
        raise EstimationError(f"the factor graph does not determine the static {', '.join(bad)}")
