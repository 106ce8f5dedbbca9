"""Lower bounds of the covariances, from the information of the data along a trajectory.

Linearised at the truth, they are the posterior Cramer-Rao bounds of filter and smoother
(Van Trees 1968; Tichavsky, Muravchik, Nehorai 1998, eq. 21): no unbiased estimator's mean
squared error lies below, and a consistent one comes close.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track, Truth, estimates
from relnav_graph.errors import InputError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.rows import MeasurementRows
from relnav_graph.linear.whitening import inverse_cholesky

__all__ = ["Bounds", "bounds", "true_trajectory"]


@dataclass(frozen=True, eq=False)
class Bounds:
    """Tracks whose covariances (N, n, n), those of static blocks too, are the bounds: filtered, for
    any filter; smoothed, for any smoother of the whole pass. Their states are the trajectory
    itself."""

    filtered: Track
    smoothed: Track


def true_trajectory(problem: Problem, truth: Truth | None) -> Array:
    """The true states (N, size) at the problem's epochs.

    Raises InputError when truth does not know all of them.
    """
    layout, times = problem.layout, problem.times
    if truth is None:
        raise InputError("there is no truth")
    missing = [b.name for b in layout if b.name not in truth.values]
    if missing:
        raise InputError(f"the truth does not know {missing}")
    k, known = truth.at(times)
    if not known.all():
        raise InputError("the truth does not know every epoch")
    parts = [truth.values[b.name][k].reshape(len(times), b.size) for b in layout]
    x = np.ascontiguousarray(np.hstack(parts))
    if not np.isfinite(x).all():
        raise InputError("the truth is not known at every epoch")
    return x


def _filtered(P: Array, F: Array, Q: Array, rows: MeasurementRows, offsets: Indices) -> Array:
    """The covariance recursion of the Kalman filter at fixed linearisation, (N, n, n).

    P_k|k-1 = F P F^T + Q; with whitened rows H (R = I): K = P H^T (H P H^T + I)^-1 and
    P_k = (I - K H) P (I - K H)^T + K K^T (Joseph's form). P (n, n): of the prior; F (N - 1, m, n),
    Q (N - 1, m, m): of the m moving columns, before the static ones, which stay as they are;
    offsets (N + 1,): where the rows of each epoch begin.
    """
    one, out, m = np.eye(len(P)), [], F.shape[1]
    for k in range(len(offsets) - 1):
        if k:
            whole = one.copy()
            whole[:m] = F[k - 1]
            P = whole @ P @ whole.T
            P[:m, :m] += Q[k - 1]
        H = rows.H[offsets[k] : offsets[k + 1]]
        if len(H):
            gain = np.linalg.solve(H @ P @ H.T + np.eye(len(H)), H @ P).T
            left = one - gain @ H
            P = left @ P @ left.T + gain @ gain.T
        P = 0.5 * (P + P.T)
        out.append(P)
    return np.array(out)


def bounds(problem: Problem, x: Array) -> Bounds:
    """The bounds at the trajectory x (N, size), for the problem's prior covariance.

    Raises InputError, ModelError and GeometryError as `Assembly` does, EstimationError on
    a system that does not determine every epoch.
    """
    layout = problem.layout
    assembly = Assembly.of(problem)
    weights = np.ones(assembly.observations)
    rows = assembly.measure(x, weights)
    x_next, F, Q = assembly.transition(x[:-1])
    # The prior is put about the trajectory itself: its mean must not move the bound.
    whiten = inverse_cholesky("the prior", problem.prior.P)
    anchor = Anchor(x[0], whiten, np.zeros(layout.dim))
    system = linearize(assembly, anchor, x, assembly.whitening_of(x_next, Q), weights)
    smoothed = system.conditionals.marginals().whole()
    filtered = _filtered(problem.prior.P, F, Q, rows, assembly.row_offsets)
    return Bounds(
        Track("filter_bound", "filtered", t=problem.times, **estimates(layout, x, filtered)),
        Track("smoother_bound", "smoothed", t=problem.times, **estimates(layout, x, smoothed)),
    )
