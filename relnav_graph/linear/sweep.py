"""The compiled loop that linearises a chain of epochs and eliminates them, one after the other.

The rows of an epoch and of the interval that follows stand in one array `a`, whose columns are:
this epoch's n states, the right-hand side, the border's m states, the next epoch's n states. The
border is eliminated by somebody else: static blocks, and maybe an earlier epoch.
"""

from __future__ import annotations

import numpy as np
from numba import types
from scipy.linalg.lapack import dtpqrt

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import give_way, jit, jit_loop
from relnav_graph.compiled.contracts import INDEX_MATRIX, INDICES, MATRIX, STACK, VECTOR
from relnav_graph.linear.intervals import interval_row
from relnav_graph.linear.rows import observe, propagate
from relnav_graph.linear.tables import TABLES, Tables
from relnav_graph.maths import dense
from relnav_graph.maths.reflections import WIDE, householder, householder_blocked, room

__all__ = [
    "CARRIED",
    "FILLED",
    "FOLDED",
    "NEXT",
    "advance",
    "close_epoch",
    "folded",
    "hand_over",
    "put_rows",
    "sweep",
    "work_of",
]

#: Of a sweep that is under way: the next epoch, how many rows of `a` are known of it, and how many
#: rows of `left` are filled.
NEXT, CARRIED, FILLED = 0, 1, 2
#: Rows of the border that are folded into their triangle at once.
FOLDED = 512


@jit
def put_rows(a: Array, row: int, n: int, m: int, own: Indices, e: Array, A: Array) -> float:
    """Write the equations ``A y = -e`` into a, from `row` on; returns ``|e|^2``.

    e: (rows,); A: (rows, n + statics), of which those in `own` are the first in the border, of m
    columns.
    """
    squares, few = 0.0, own.shape[0]
    for i in range(e.shape[0]):
        for j in range(n):
            a[row + i, j] = A[i, j]
        a[row + i, n] = -e[i]
        for j in range(few):
            a[row + i, n + 1 + j] = A[i, n + own[j]]
        for j in range(few, m):
            a[row + i, n + 1 + j] = 0.0
        squares += e[i] * e[i]
    return squares


@jit
def _put_held(a: Array, row: int, n: int, own: Indices, e: Array, A: Array) -> float:
    """:func:`put_rows` of an epoch in the border, into rows of the border and the right-hand side:
    columns of `own`, then the epoch's n, then -e."""
    squares, few = 0.0, own.shape[0]
    for i in range(e.shape[0]):
        for j in range(few):
            a[row + i, j] = A[i, n + own[j]]
        for j in range(n):
            a[row + i, few + j] = A[i, j]
        a[row + i, few + n] = -e[i]
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


@jit(from_python=True)
def work_of(n: int, m: int, rows: int) -> Array:
    """What `close_epoch` of so many rows, and `advance`, want to work with."""
    return np.empty(room(n, max(rows, 2 * n), 2 * n + 1 + m) if m >= WIDE else 0)


@jit
def close_epoch(a: Array, n: int, m: int, rows: int, left: Array, filled: int, work: Array) -> int:
    """Bring the rows known of an epoch to triangular form; what is left over of them, rows of the
    border and the right-hand side, goes to `left` (rows, m + 1) from `filled` on. Returns how many
    rows of that are filled then.

    work: see `work_of`.
    """
    if m < WIDE:
        householder(a, n, 0, rows, n + 1 + m)
    else:
        householder_blocked(a, n, 0, rows, n + 1 + m, work)
    if m == 0:
        return filled
    for i in range(n, rows):
        for j in range(m):
            left[filled, j] = a[i, n + 1 + j]
        left[filled, m] = a[i, n]
        filled += 1
    return filled


@jit
def advance(
    a: Array, n: int, m: int, own: Indices, e: Array, A: Array, B: Array, work: Array
) -> float:
    """Eliminate an epoch, closed, with the interval ``e + A y + B y_next`` to the next one.

    e (n,); A (n, n + statics); B (n, n); work: see `work_of`. Returns ``|e|^2``.
    """
    width = n + 1 + m
    for i in range(n):
        for j in range(width, n + width):
            a[i, j] = 0.0
    dense.put_block(a, n, width, B, 1.0)
    squares, below = put_rows(a, n, n, m, own, e, A), n
    # Reflections lose small rows that stand above large ones (Cox and Higham 1998), such as those
    # of an interval of microseconds: the larger rows come first.
    if _largest(A, n) > _largest(a, n):
        for i in range(n):
            for j in range(n + width):
                a[i, j], a[n + i, j] = a[n + i, j], a[i, j]
        below = 0
    if m < WIDE:
        householder(a, n, below, 2 * n, n + width)
    else:
        householder_blocked(a, n, below, 2 * n, n + width, work)
    return squares


@jit
def hand_over(a: Array, last: bool, R: Array, S: Array, T: Array, d: Array) -> None:
    """Take the conditional R (n, n), T (n, m), d (n,) of the epoch out of `a`, S (n, n) too, and
    make what is known of the next one the first rows. last: there is no next one, nor S."""
    n, m = T.shape
    width = n + 1 + m
    for i in range(n):
        d[i] = a[i, n]
        for j in range(m):
            T[i, j] = a[i, n + 1 + j]
        for j in range(n):
            R[i, j] = a[i, j] if j >= i else 0.0
            if not last:
                S[i, j] = a[i, width + j]
                a[i, j] = a[n + i, width + j]
        for j in range(n, width):
            a[i, j] = a[n + i, j]


@jit_loop(
    TABLES,
    *(INDICES, INDICES, INDEX_MATRIX, MATRIX, VECTOR, STACK, MATRIX, INDICES, types.int64),
    *(types.int64, types.int64, INDICES, MATRIX, MATRIX, STACK, STACK, STACK, MATRIX, STACK),
    *(INDICES, VECTOR, INDICES),
)
def sweep(
    tables: Tables,
    epoch_offsets: Indices,
    row_offsets: Indices,
    kinds: Indices,
    x: Array,
    weight: Array,
    whiten: Array,
    damping: Array,
    own: Indices,
    statics: int,
    held: int,
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
    """Fill the conditionals R, S, T, d at the trajectory x (N, size).

    whiten (N - 1, n, n), weight (observations,): as of
    `relnav_graph.linear.elimination.linearize`; kinds: of the n states that move; damping (N, n):
    diagonals of further rows, or (0, n) for none; own: those of all static columns, `statics` in
    number, that are in the border; held: 1 where the epoch at which the sweep begins is in the
    border too, after these, else 0. at (3,): where the sweep stands, see `NEXT`; it goes on to
    epoch `end`, or until `left` is full. a (rows, columns), left (rows, m + 1): see
    `close_epoch`. Fills R (N, n, n), S (N - 1, n, n), d (N, n), and T (N, n, m) or, with an epoch
    held, (epochs of the sweep, n, m) from that one on; known (N, n, n + m + 1): U, u, V of each
    epoch, or (0, ...) for none; status (observations,). Adds half the sum of the squared residuals
    to cost (1,). failure (3,): interval, process, status.
    """
    count, n, m = d.shape[0], d.shape[1], T.shape[2]
    most, damped, width, begin = 0, damping.shape[0] > 0, n + 1 + m, at[NEXT]
    for k in range(begin, end):
        most = max(most, row_offsets[k + 1] - row_offsets[k])
    r_all, H_all = np.empty(most), np.empty((most, n + statics))
    work = work_of(n, m, max(at[CARRIED], n) + most + n)
    x_next, F, Q = x[0].copy(), np.empty((n, n + statics)), np.empty((0, 0))
    e, A, B = np.empty(n), np.empty((n, n + statics)), np.empty((n, n))
    squares, carried, filled = 0.0, at[CARRIED], at[FILLED]
    for k in range(begin, end):
        give_way(0)
        first, last = epoch_offsets[k], epoch_offsets[k + 1]
        height = row_offsets[k + 1] - row_offsets[k]
        if m > 0 and filled + carried + height > left.shape[0]:
            at[NEXT], at[CARRIED], at[FILLED] = k, carried, filled
            cost[0] += 0.5 * squares
            return
        r, H = r_all[:height], H_all[:height]
        observe(tables, first, last, 0, x, weight[first:last], r, H, status[first:last])
        if k < count - 1:
            process, code = propagate(tables, k, x[k], x_next, F, Q)
            if code != 0:
                failure[0], failure[1], failure[2] = k, process, code
                return
            interval_row(x_next, x[k + 1], F, whiten[k], kinds, e, A, B)
        if held != 0 and k == begin:
            squares += _put_held(left, filled, n, own, r, H)
            filled += height
            for i in range(n if damped else 0):
                for j in range(m + 1):
                    left[filled, j] = 0.0
                left[filled, m - n + i] = damping[k, i]
                filled += 1
            if k < count - 1:
                squares += put_rows(a, 0, n, m, own, e, A)
                for i in range(n):
                    for j in range(n):
                        a[i, width - n + j], a[i, j] = A[i, j], B[i, j]
            carried = n
            continue
        squares += put_rows(a, carried, n, m, own, r, H)
        rows = carried + height
        if damped:
            for i in range(n):
                for j in range(width):
                    a[rows + i, j] = 0.0
                a[rows + i, i] = damping[k, i]
            rows += n
        filled = close_epoch(a, n, m, rows, left, filled, work)
        if known.shape[0] > 0:
            for i in range(n):
                for j in range(i, width):
                    known[k, i, j] = a[i, j]
        if k < count - 1:
            squares += advance(a, n, m, own, e, A, B, work)
        place = k - held * begin
        hand_over(a, k == count - 1, R[k], S[min(k, count - 2)], T[place], d[k])
        carried = n
    at[NEXT], at[CARRIED], at[FILLED] = end, carried, filled
    cost[0] += 0.5 * squares


def folded(triangle: Array, rows: Array) -> Array:
    """The triangle (m + 1, m + 1) of a triangle and further rows (k, m + 1).

    triangle: in Fortran's order, overwritten.
    """
    out, _, _, info = dtpqrt(0, min(24, len(triangle)), triangle, rows, overwrite_a=True)
    assert info == 0
    return np.asarray(out)
