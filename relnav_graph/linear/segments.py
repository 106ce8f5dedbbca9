"""Elimination in two levels, for passes with hundreds of static states.

As a border of every epoch, hundreds of columns would be carried through all reflections. A
segment of a few dozen epochs reads few of them. So each segment is eliminated first, but for its
first epoch, with those alone and that epoch as its border; what is left says how the first epochs
of two segments hang together, and with which static blocks. These epochs are a chain again, far
shorter, with all static blocks as its border.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Conditionals, Marginals, go_back
from relnav_graph.linear.sweep import (
    FILLED,
    FOLDED,
    advance,
    close_epoch,
    folded,
    hand_over,
    put_rows,
    sweep,
    work_of,
)
from relnav_graph.linear.tables import COLUMNS, NUMBERED, OWN_COLUMN
from relnav_graph.maths.reflections import SPARE

__all__ = ["LENGTH", "MANY", "Segmented", "eliminate_segments"]

#: Epochs of a segment, and the number of static states from which on two levels are faster.
LENGTH, MANY = 20, 100


@dataclass(frozen=True, eq=False)
class Segmented(Conditionals):
    """The conditionals of a pass in segments.

    R, S, d: of all epochs, given the next one of the same segment; T (N, n, 0): nothing. top: of
    the first epochs of the segments, and of the last epoch, which `begins` (K,) numbers. borders:
    by segment, (epochs, n, own + n), to its border: the static states `own` and its first epoch.
    """

    top: Conditionals
    begins: Indices
    borders: list[Array]
    own: list[Indices]

    def solution(self, end: Array | None = None) -> Array:
        """The Gauss-Newton step (N, n + m); see `Conditionals.solution`."""
        n = self.d.shape[1]
        y = self.top.solution(end)
        out = np.tile(y[0], (len(self.d), 1))
        out[self.begins] = y
        for i, (begin, after) in enumerate(pairwise(self.begins)):
            border = np.concatenate([y[i, n + self.own[i]], y[i, :n]])
            inside = self._inside(i)
            out[begin + 1 : after, :n] = inside.solution(np.concatenate([y[i + 1, :n], border]))[
                :-1, :n
            ]
        return out

    def _inside(self, i: int) -> Conditionals:
        """A segment's epochs but the first, and the first of the next one, with the border as
        static states."""
        part = slice(self.begins[i] + 1, self.begins[i + 1] + 1)
        T = np.concatenate([self.borders[i][1:], self.borders[i][:1]])  # the last one's is not used
        m = T.shape[2]
        S = self.S[part.start : part.stop - 1]
        return Conditionals(self.R[part], S, self.d[part], T, np.eye(m), np.zeros(m))

    def marginals(self, end: Array | None = None) -> Marginals:
        """Marginal covariances of all epochs and of the static blocks; see
        `Conditionals.marginals`."""
        top, found = self.top, self.top.marginals(end)
        count, n = self.d.shape
        m = len(self.d_s)
        P, cross = np.empty((count, n, n)), np.empty((count, n, m))
        P[self.begins], cross[self.begins] = found.P, found.cross
        for i, (begin, after) in enumerate(pairwise(self.begins)):
            # The border, with all static states: these, then the segment's first epoch.
            border = np.block([[found.statics, found.cross[i].T], [found.cross[i], found.P[i]]])
            other = top.S[i] @ found.P[i + 1] + top.T[i] @ found.cross[i + 1].T
            to_first = -np.linalg.solve(top.R[i], other).T
            inside, own = self._inside(i), np.concatenate([self.own[i], m + np.arange(n)])
            P_part, cross_part = go_back(
                *(inside.R, inside.S, inside.T, own, found.P[i + 1]),
                *(np.hstack([found.cross[i + 1], to_first]), border),
            )
            P[begin + 1 : after], cross[begin + 1 : after] = P_part[:-1], cross_part[:-1, :, :m]
        return Marginals(P, found.statics, cross)

    def anchor(self, x: Array) -> Anchor:
        """As `Conditionals.anchor`."""
        return self.top.anchor(x)

    def last_covariance(self) -> Array:
        """As `Conditionals.last_covariance`."""
        return self.top.last_covariance()


def static_columns(assembly: Assembly, first: int, last: int) -> Indices:
    """The columns of the static blocks, counted from their first, that the observations of epochs
    first to last - 1 read, and the intervals after them."""
    tables, n = assembly.tables, assembly.layout.moving.dim
    seen = slice(*assembly.epoch_offsets[[first, last]])
    sensors = tables.sensors[np.unique(assembly.sensor_of[seen])]
    places = [
        tables.places[model[COLUMNS] : model[COLUMNS + 1]]
        for model in (*sensors, *tables.processes)
    ]
    own, dims = tables.observations[seen, OWN_COLUMN], tables.sensors[assembly.sensor_of[seen]]
    dims = dims[:, NUMBERED]
    places += [own[dims > j] + j for j in range(dims.max(initial=0))]
    columns: Indices = np.unique(np.concatenate(places)) - n
    return columns[columns >= 0]


def eliminate_segments(
    assembly: Assembly,
    x: Array,
    whiten: Array,
    weight: Array,
    damping: Array,
    start: Array,
    carried: int,
    triangle: Array,
    status: Indices,
    cost: Array,
    failure: Indices,
) -> Segmented:
    """Eliminate a pass in two levels.

    damping: (N, n) or (0, n); start (rows, columns): `a` of a sweep, with the `carried` rows that
    are known of the first epoch; triangle (m + 1, m + 1): of the static blocks. The rest as of
    `relnav_graph.linear.sweep.sweep`.
    """
    count, n, m = len(x), assembly.layout.moving.dim, assembly.layout.statics.dim
    begins = np.append(np.arange(0, count - 1, LENGTH), count - 1)
    R, S, d = np.zeros((count, n, n)), np.zeros((count - 1, n, n)), np.zeros((count, n))
    known = np.zeros((0, n, n + m + 1))
    top, every = Conditionals.empty(len(begins), n, m), np.arange(m)
    spans = list(pairwise([*begins.tolist(), count]))
    parts, reads = list[Array](), [static_columns(assembly, *span) for span in spans]
    room = max(FOLDED, n + m) + n + m + 1
    a, left, filled = np.zeros((n + m + room, start.shape[1])), np.empty((2 * room, m + 1)), 0
    a[:carried], work = start[:carried], work_of(n, m, len(a))
    for i, (begin, after) in enumerate(spans):
        own = reads[i]
        width = len(own) + n
        height = int(assembly.row_offsets[after] - assembly.row_offsets[begin])
        rows = height + (after - begin) * n * min(1, len(damping)) + n
        at, one = np.array([begin, 0, 0]), np.zeros((rows + 2 * n, 2 * n + 1 + width + SPARE))
        rest, T = np.empty((rows + n, width + 1)), np.zeros((after - begin, n, width))
        sweep(
            *(assembly.tables, assembly.epoch_offsets, assembly.row_offsets),
            *(assembly.layout.moving.kinds, x, weight, whiten, damping, own, m, 1, after),
            *(at, one, rest, R, S, T, d, known, status, cost, failure),
        )
        if failure[2]:
            break
        parts.append(T)
        tri = folded(np.zeros((width + 1, width + 1), order="F"), rest[: at[FILLED]])[:width]
        H = np.zeros((width, n + m))
        H[:, n + own], H[:, :n] = tri[:, : len(own)], tri[:, len(own) : width]
        put_rows(a, carried, n, m, every, -tri[:, width], H)
        filled = close_epoch(a, n, m, carried + width, left, filled, work)
        last = i == len(begins) - 1
        if not last:
            A = np.zeros((n, n + m))
            A[:, n + own] = one[:n, n + 1 : n + 1 + len(own)]
            A[:, :n] = one[:n, n + 1 + len(own) : n + 1 + width]
            advance(a, n, m, every, -one[:n, n], A, np.ascontiguousarray(one[:n, :n]), work)
        hand_over(a, last, top.R[i], top.S[min(i, len(top.S) - 1)], top.T[i], top.d[i])
        carried = n
        if filled > FOLDED or last:
            triangle, filled = folded(triangle, left[:filled]), 0
    top.R_s[:], top.d_s[:] = triangle[:m, :m], triangle[:m, m]
    R[begins], d[begins] = top.R, top.d
    nothing = np.empty((count, n, 0))
    return Segmented(R, S, d, nothing, top.R_s, top.d_s, top, begins, parts, reads)
