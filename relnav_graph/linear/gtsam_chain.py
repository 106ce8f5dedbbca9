"""A pass as a chain of epochs in GTSAM: one variable per epoch, its whole error state, and one for
all static blocks.

GTSAM's own elimination of the rows of `relnav_graph.linear.assembly`, in order of time: slower than
`relnav_graph.linear.elimination`, and its check. One variable per epoch is about three times
cheaper than one per block.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import gtsam

from relnav_graph.arrays import Array, Indices
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Conditionals
from relnav_graph.linear.intervals import ProcessRows
from relnav_graph.linear.rows import MeasurementRows

__all__ = [
    "STATICS",
    "Rows",
    "chain_factors",
    "chain_rows",
    "eliminate",
    "row_factor",
]


#: The key of the static blocks' step.
STATICS = gtsam.symbol("s", 0)


def row_factor(parts: Mapping[int, Array], error: Array) -> gtsam.JacobianFactor:
    """The factor ``|error + sum of A d|^2 / 2`` of whitened rows on steps d.

    parts: A (rows, dim) by key, the number of an epoch or `STATICS`; error: (rows,).
    """
    terms: list[Any] = [term for key, A in parts.items() if A.shape[1] for term in (key, A)]
    make: Any = gtsam.JacobianFactor  # its stubs know lists of up to three keys only
    made: gtsam.JacobianFactor = make(*terms, -error, gtsam.noiseModel.Unit.Create(len(error)))
    return made


@dataclass(frozen=True, eq=False)
class Rows:
    """The whitened rows of a pass at one trajectory.

    e (n + m,), A (n + m, n + m): rows e + A d of the anchor; process: of the intervals;
    measurements: of the observations; offsets (N + 1,): where each epoch's measurement rows begin.
    """

    e: Array
    A: Array
    process: ProcessRows
    measurements: MeasurementRows
    offsets: Indices

    @property
    def states(self) -> int:
        """n: states of an epoch, without the static ones, whose columns are the last of A."""
        return int(self.process.B.shape[-1])


def chain_rows(assembly: Assembly, anchor: Anchor, x: Array, whiten: Array, weight: Array) -> Rows:
    """The whitened rows of a pass at the trajectory x (N, size).

    whiten: (N - 1, n, n); weight: (observations,). Arguments and errors as of
    `relnav_graph.linear.elimination.linearize`.
    """
    e, A = anchor.rows(assembly.layout, x[0])
    measurements, process = assembly.measure(x, weight), assembly.process(x, whiten)
    return Rows(e, A, process, measurements, assembly.row_offsets)


def chain_factors(rows: Rows) -> list[gtsam.JacobianFactor]:
    """All factors, in order of time; keys are the numbers of epochs, and `STATICS`."""
    m, p, offsets, n = rows.measurements, rows.process, rows.offsets, rows.states
    factors = [row_factor({0: rows.A[:, :n], STATICS: rows.A[:, n:]}, rows.e)]
    for k in range(len(offsets) - 1):
        own = slice(offsets[k], offsets[k + 1])
        if offsets[k + 1] > offsets[k]:
            factors.append(row_factor({k: m.H[own, :n], STATICS: m.H[own, n:]}, m.r[own]))
        if k < len(p.e):
            A = p.A[k]
            factors.append(row_factor({k: A[:, :n], k + 1: p.B[k], STATICS: A[:, n:]}, p.e[k]))
    return factors


def eliminate(factors: list[gtsam.JacobianFactor], count: int, n: int, m: int = 0) -> Conditionals:
    """Eliminate the epochs in order of time, then the static blocks, by QR.

    count: number N of epochs; n, m: dimensions of an epoch's tangent, and of the static one.
    GTSAM's Cholesky would reject ordinary ratios of process to state noise. Raises RuntimeError
    when the factors do not determine every epoch.
    """
    graph, ordering = gtsam.GaussianFactorGraph(), gtsam.Ordering()
    for factor in factors:
        graph.push_back(factor)
    for key in [*range(count), *([STATICS] if m else [])]:
        ordering.push_back(key)
    net = graph.eliminateSequential(ordering, gtsam.EliminateQR)
    out = Conditionals.empty(count, n, m)
    for k in range(count):
        conditional = net.at(k)
        out.R[k], out.d[k] = conditional.R(), conditional.d()
        parents = conditional.S()
        out.T[k] = parents[:, parents.shape[1] - m :]
        if k < count - 1:
            out.S[k] = parents[:, :n]
    if m:
        out.R_s[:], out.d_s[:] = net.at(count).R(), net.at(count).d()
    return out
