"""A pass as a chain of epochs in GTSAM: one variable per epoch, its whole error state.

The linear system of one Gauss-Newton step is a `gtsam.GaussianFactorGraph` with a prior,
one factor per interval and one per epoch with measurements, eliminated in order of time.
One variable per epoch is about three times cheaper than one per block.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from relnav_graph import so3
from relnav_graph.assembly import Assembly, MeasurementRows, ProcessRows, inverse_cholesky
from relnav_graph.compiled import jit
from relnav_graph.errors import EstimationError
from relnav_graph.problem import Prior
from relnav_graph.state import Layout

__all__ = ["Chain", "Conditionals", "PriorRows", "chain_factors", "epoch_factor", "prior_rows"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PriorRows:
    """Whitened rows of the prior at the first epoch: e + A d. (n,), (n, n)."""

    e: Array
    A: Array


def prior_rows(layout: Layout, prior: Prior, x: Array) -> PriorRows:
    """The prior, ``local(prior, x_0)``, at x (size,)."""
    whiten = inverse_cholesky("the prior", prior.P)
    e = layout.local(prior.x, x)
    return PriorRows(whiten @ e, whiten @ layout.right_jacobian_inverse(e))


def epoch_factor(key: int, A: Array, error: Array) -> gtsam.JacobianFactor:
    """The factor of whitened rows ``error + A d`` on one epoch."""
    return gtsam.JacobianFactor(key, A, -error, gtsam.noiseModel.Unit.Create(len(error)))


def interval_factor(key: int, A: Array, B: Array, error: Array) -> gtsam.JacobianFactor:
    """The factor of whitened rows ``error + A d_key + B d_key+1``."""
    model = gtsam.noiseModel.Unit.Create(len(error))
    return gtsam.JacobianFactor(key, A, key + 1, B, -error, model)


@dataclass(frozen=True, eq=False)
class Chain:
    """The linear system of a pass at one trajectory; weights: of its observations."""

    prior: PriorRows
    process: ProcessRows
    measurements: MeasurementRows
    row_offsets: NDArray[np.int64]
    weights: Array

    @property
    def cost(self) -> float:
        """Half the sum of all squared whitened residuals."""
        p, q, r = self.prior.e, self.process.e, self.measurements.r
        return 0.5 * float(p @ p + np.sum(q * q) + r @ r)


def chain_factors(chain: Chain) -> list[gtsam.JacobianFactor]:
    """All factors, in order of time."""
    m, offsets = chain.measurements, chain.row_offsets
    factors = [epoch_factor(0, chain.prior.A, chain.prior.e)]
    for k in range(len(offsets) - 1):
        rows = slice(offsets[k], offsets[k + 1])
        if offsets[k + 1] > offsets[k]:
            factors.append(epoch_factor(k, m.H[rows], m.r[rows]))
        if k < len(chain.process.e):
            p = chain.process
            factors.append(interval_factor(k, p.A[k], p.B[k], p.e[k]))
    return factors


@jit
def _back_substitute(R: Array, S: Array, d: Array) -> Array:
    count, n = d.shape
    delta = np.empty((count, n))
    for k in range(count - 1, -1, -1):
        for i in range(n - 1, -1, -1):
            value = d[k, i]
            if k < count - 1:
                for j in range(n):
                    value -= S[k, i, j] * delta[k + 1, j]
            for j in range(i + 1, n):
                value -= R[k, i, j] * delta[k, j]
            delta[k, i] = value / R[k, i, i]
    return delta


@jit
def _inverse_upper(R: Array) -> Array:
    """Inverse of an upper triangular matrix."""
    n = R.shape[0]
    out = np.zeros((n, n))
    for j in range(n):
        out[j, j] = 1 / R[j, j]
        for i in range(j - 1, -1, -1):
            value = 0.0
            for l in range(i + 1, j + 1):
                value -= R[i, l] * out[l, j]
            out[i, j] = value / R[i, i]
    return out


@jit
def _covariances(R: Array, S: Array) -> Array:
    """P_k = R^-1 (I + S P_k+1 S^T) R^-T, backwards from P_N = (R^T R)^-1."""
    count, n = R.shape[0], R.shape[1]
    P = np.empty((count, n, n))
    for k in range(count - 1, -1, -1):
        inner = so3.identity(n)
        if k < count - 1:
            inner = so3.add(inner, so3.propagate_covariance(S[k], P[k + 1]), 1.0)
        full = so3.propagate_covariance(_inverse_upper(R[k]), inner)
        for i in range(n):
            for j in range(n):
                P[k, i, j] = 0.5 * (full[i, j] + full[j, i])
    return P


@dataclass(frozen=True, eq=False)
class Conditionals:
    """R_k d_k + S_k d_k+1 = d_k of every epoch: (N, n, n), (N - 1, n, n), (N, n)."""

    R: Array
    S: Array
    d: Array

    def solution(self) -> Array:
        """The Gauss-Newton step (N, n)."""
        return _back_substitute(self.R, self.S, self.d)

    def covariances(self) -> Array:
        """Marginal covariances (N, n, n) of all epochs."""
        return _covariances(self.R, self.S)

    def decrease(self) -> float:
        """By how much the linear system's cost falls: half the squared length of the
        step in units of sigma."""
        return 0.5 * float(np.sum(self.d**2))


def eliminate(factors: list[gtsam.JacobianFactor], count: int, n: int) -> Conditionals:
    """Eliminate the epochs in order of time, by QR.

    Cholesky would reject ordinary ratios of process to state noise. Raises
    EstimationError when the system does not determine every epoch.
    """
    graph, ordering = gtsam.GaussianFactorGraph(), gtsam.Ordering()
    for factor in factors:
        graph.push_back(factor)
    for k in range(count):
        ordering.push_back(k)
    try:
        net = graph.eliminateSequential(ordering, gtsam.EliminateQR)
    except RuntimeError as error:
        raise EstimationError(f"the factor graph is indeterminate: {str(error)[:200]}") from error
    R, S, d = np.zeros((count, n, n)), np.zeros((count - 1, n, n)), np.empty((count, n))
    for k in range(count):
        conditional = net.at(k)
        R[k], d[k] = conditional.R(), conditional.d()
        if k < count - 1:
            S[k] = conditional.S()
    if not (np.isfinite(R).all() and np.isfinite(d).all()):
        raise EstimationError("the factor graph's linear system is not finite")
    if not np.einsum("kii->ki", R).all():
        k = int(np.nonzero(~np.einsum("kii->ki", R).all(axis=1))[0][0])
        raise EstimationError(f"the factor graph does not determine epoch {k}")
    return Conditionals(R, S, d)


def linearize(assembly: Assembly, prior: Prior, x: Array, whiten: Array, weight: Array) -> Chain:
    """The linear system at the trajectory x (N, size)."""
    return Chain(
        prior_rows(assembly.layout, prior, x[0]),
        assembly.process(x, whiten),
        assembly.measure(x, weight),
        assembly.row_offsets,
        weight,
    )
