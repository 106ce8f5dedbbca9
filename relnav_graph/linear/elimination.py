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

import math
from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.errors import EstimationError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Conditionals
from relnav_graph.linear.segments import LENGTH, MANY, Segmented, eliminate_segments
from relnav_graph.linear.sweep import CARRIED, FILLED, FOLDED, NEXT, folded, put_rows, sweep
from relnav_graph.maths.reflections import SPARE

__all__ = ["System", "linearize"]


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
    memory costs a long pass a third of its time. Raises InputError on x of another shape,
    ModelError or GeometryError when a model cannot be evaluated, EstimationError when the system is
    not finite or does not determine every epoch and static block.
    """
    count, layout = len(x), assembly.layout
    layout.check_states(x, len(assembly.times))
    n, m = layout.moving.dim, layout.statics.dim
    status, cost = np.zeros(assembly.observations, dtype=np.int64), np.zeros(1)
    known, failure = np.zeros((count * keep, n, n + m + 1)), np.zeros(3, dtype=np.int64)
    triangles = np.zeros((count * keep, m + 1, m + 1))
    moving = np.zeros((0, n)) if damping is None else np.ascontiguousarray(damping[:, :n])
    highest = int((assembly.row_offsets[1:] - assembly.row_offsets[:-1]).max(initial=0))
    most = n + m + highest + len(moving[:1]) * n
    a = np.zeros((max(most, 2 * n), 2 * n + 1 + m + SPARE))
    at, left = np.array([0, n + m, 0]), np.empty((max(FOLDED, most) if m else 0, m + 1))
    e, A = anchor.rows(layout, x[0])
    own = np.arange(m)
    cost[0] = 0.5 * put_rows(a, 0, n, m, own, e, np.ascontiguousarray(A))
    triangle = np.zeros((m + 1, m + 1), order="F")
    if damping is not None:
        triangle[np.arange(m), np.arange(m)] = damping[0, n:]
    elif m and not A[n:, :n].any() and not np.tril(A[n:, n:], -1).any():
        triangle[:m, :m], triangle[:m, m] = A[n:, n:], -e[n:]  # what is a triangle already
        at[CARRIED] = n
    if m > MANY and count > 2 * LENGTH and not keep:
        into = eliminate_segments(
            *(assembly, x, whiten, weight, moving, a, int(at[CARRIED]), triangle),
            *(status, cost, failure),
        )
        at[NEXT] = count
    elif into is None or isinstance(into, Segmented):
        into = Conditionals.empty(count, n, m)
    while at[NEXT] < count and not failure[2]:
        begun = at[NEXT]
        sweep(
            *(assembly.tables, assembly.epoch_offsets, assembly.row_offsets, layout.moving.kinds),
            *(x, weight, whiten, moving, own, m, 0, begun + 1 if keep and m else count),
            *(at, a, left, into.R, into.S, into.T, into.d, known, status, cost, failure),
        )
        if m:
            triangle = folded(triangle, left[: at[FILLED]])
            at[FILLED] = 0
            triangles[begun : at[NEXT] * keep] = triangle
            into.R_s[:], into.d_s[:] = triangle[:m, :m], triangle[:m, m]
    assembly.check(status)
    assembly.check_propagated(failure)
    _check(assembly, into)
    return System(x, float(cost[0]), status, into, known, triangles)


def _check(assembly: Assembly, c: Conditionals) -> None:
    """Raise EstimationError unless conditionals are finite and determine every state."""
    # A sum is finite where all is. A NaN in R spreads to the R of all later epochs: looking at the
    # last one is enough.
    sums = [a.sum() for a in (c.d, c.R[-1], c.R_s, c.d_s) if a.size]
    if not all(map(math.isfinite, sums)):
        raise EstimationError("the factor graph's linear system is not finite")
    diagonals = np.einsum("kii->ki", c.R)
    layout = assembly.layout.moving
    if not diagonals.all():
        k = int(np.nonzero(~diagonals.all(axis=1))[0][0])
        bad = [b.name for b in layout if not diagonals[k, layout.tangent(b.name)].all()]
        raise EstimationError(
            f"the factor graph does not determine {', '.join(bad)} at t = {assembly.times[k]} s"
        )
    if not len(c.d_s):
        return
    layout, diagonal = assembly.layout.statics, np.diag(c.R_s)
    if not diagonal.all():
        bad = [b.name for b in layout if not diagonal[layout.tangent(b.name)].all()]
        raise EstimationError(f"the factor graph does not determine the static {', '.join(bad)}")
