"""A pass as a chain of epochs in GTSAM: one variable per epoch, its whole error state.

GTSAM's own elimination of the rows of `relnav_graph.linear.assembly`, in order of time: slower than
`relnav_graph.linear.elimination`, and its check. One variable per epoch is about three times
cheaper than one per block.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.linear.assembly import Assembly, MeasurementRows
from relnav_graph.linear.elimination import Anchor, Conditionals
from relnav_graph.linear.intervals import ProcessRows

__all__ = [
    "Rows",
    "chain_factors",
    "chain_rows",
    "eliminate",
    "epoch_factor",
    "interval_factor",
]


def epoch_factor(key: int, A: Array, error: Array) -> gtsam.JacobianFactor:
    """The factor ``|error + A d|^2 / 2`` of whitened rows on one epoch's step d.

    A: (rows, n); error: (rows,). key: number of the epoch.
    """
    return gtsam.JacobianFactor(key, A, -error, gtsam.noiseModel.Unit.Create(len(error)))


def interval_factor(key: int, A: Array, B: Array, error: Array) -> gtsam.JacobianFactor:
    """The factor ``|error + A d_key + B d_key+1|^2 / 2`` of whitened rows on two epochs' steps.

    A, B: (rows, n); error: (rows,). key: number of the earlier epoch.
    """
    model = gtsam.noiseModel.Unit.Create(len(error))
    return gtsam.JacobianFactor(key, A, key + 1, B, -error, model)


@dataclass(frozen=True, eq=False)
class Rows:
    """The whitened rows of a pass at one trajectory.

    e (n,), A (n, n): rows e + A d_0 of the anchor; process: of the intervals; measurements: of
    the observations; offsets (N + 1,): where each epoch's measurement rows begin.
    """

    e: Array
    A: Array
    process: ProcessRows
    measurements: MeasurementRows
    offsets: Indices


def chain_rows(assembly: Assembly, anchor: Anchor, x: Array, whiten: Array, weight: Array) -> Rows:
    """The whitened rows of a pass at the trajectory x (N, size).

    whiten: (N - 1, n, n); weight: (observations,). Arguments and errors as of
    `relnav_graph.linear.elimination.linearize`.
    """
    e, A = anchor.rows(assembly.layout, x[0])
    measurements, process = assembly.measure(x, weight), assembly.process(x, whiten)
    return Rows(e, A, process, measurements, assembly.row_offsets)


def chain_factors(rows: Rows) -> list[gtsam.JacobianFactor]:
    """All factors, in order of time."""
    m, p, offsets = rows.measurements, rows.process, rows.offsets
    factors = [epoch_factor(0, rows.A, rows.e)]
    for k in range(len(offsets) - 1):
        own = slice(offsets[k], offsets[k + 1])
        if offsets[k + 1] > offsets[k]:
            factors.append(epoch_factor(k, m.H[own], m.r[own]))
        if k < len(p.e):
            factors.append(interval_factor(k, p.A[k], p.B[k], p.e[k]))
    return factors


def eliminate(factors: list[gtsam.JacobianFactor], count: int, n: int) -> Conditionals:
    """Eliminate the epochs in order of time, by QR.

    count: number N of epochs; n: dimension of an epoch's tangent. GTSAM's Cholesky would reject
    ordinary ratios of process to state noise. Raises RuntimeError when the factors do not
    determine every epoch.
    """
    graph, ordering = gtsam.GaussianFactorGraph(), gtsam.Ordering()
    for factor in factors:
        graph.push_back(factor)
    for k in range(count):
        ordering.push_back(k)
    net = graph.eliminateSequential(ordering, gtsam.EliminateQR)
    R, S, d = np.zeros((count, n, n)), np.zeros((count - 1, n, n)), np.empty((count, n))
    for k in range(count):
        conditional = net.at(k)
        R[k], d[k] = conditional.R(), conditional.d()
        if k < count - 1:
            S[k] = conditional.S()
    return Conditionals(R, S, d)
