"""Unscented Kalman filters on the state manifold, plain and with iterated updates."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import block_diag

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.packing import packed_time, time_in
from relnav_graph.core.problem import Problem, padded
from relnav_graph.core.track import Track
from relnav_graph.estimators.ekf import (
    ITERATIONS,
    FilterState,
    FilterSweep,
    KalmanFilter,
    advanced,
    sweep,
)
from relnav_graph.estimators.rts import smoothed_of
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.filter import FilterInput
from relnav_graph.linear.unscented import unscented_epochs
from relnav_graph.maths.sigma_points import weights_of

__all__ = ["Ukf", "UnscentedState"]


@dataclass(frozen=True, eq=False)
class UnscentedState:
    """The filter at one epoch, see `relnav_graph.estimators.online.driver.EngineState`; R (n, n):
    the root of P = R^T R."""

    t: float | None
    x: Array
    P: Array
    R: Array
    done: FilterSweep | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class _Sweep(FilterSweep):
    """`FilterSweep` by sigma points: F is the regression of those after an interval on those
    before. r (R,), spreads, offsets (N + 1,): whitened innovations and their covariances, see
    `unscented_epochs`; R (n, n): root of the last covariance."""

    r: Array
    spreads: Array
    offsets: Indices
    R: Array

    def moments(self, weights: Array) -> Callable[[Indices, Indices], tuple[Array, Array]]:
        """See `FilterSweep.moments`; of an epoch that was updated as by the extended filter, its
        own."""
        extended = super().moments(weights)
        begins = self.assembly.row_offsets

        def of(epochs: Indices, rows: Indices) -> tuple[Array, Array]:
            S, r = extended(epochs, rows)
            for e, k in enumerate(epochs):
                whole = self.spreads[self.offsets[k] : self.offsets[k + 1]]
                if not np.isnan(whole).any():
                    own = rows[e] - begins[k]
                    count = int(begins[k + 1] - begins[k])
                    S[e] = whole.reshape(count, count)[np.ix_(own, own)]
                    r[e] = self.r[rows[e]]
            return S, r

        return of


def _root(P: Array) -> Array:
    """R (n, n), upper triangular, of P = R^T R (n, n)."""
    return np.ascontiguousarray(np.linalg.cholesky(P).T)


class UnscentedEngine:
    """The filter, driven online."""

    compact = True

    def __init__(self, problem: Problem, weights: Array, iterations: int) -> None:
        problem.expect_none_considered("an unscented filter")
        self.problem, self.weights, self.iterations = problem, weights, iterations

    def begin(self) -> UnscentedState:
        """At the prior, before the first epoch."""
        x, P = self.problem.prior.x, self.problem.prior.P
        return UnscentedState(None, x, P, _root(P))

    def through(
        self, assembly: Assembly, start: UnscentedState, seconds: list[float] | None = None
    ) -> _Sweep:
        """Filter the epochs of an assembly, or as many as the filter survives.

        seconds: gets the time of each epoch, s. Raises ModelError when a kernel breaks its
        contract.
        """
        rows = np.diff(assembly.row_offsets)
        offsets = np.concatenate(([0], np.cumsum(rows**2)))
        r, spreads = np.zeros(int(rows.sum())), np.zeros(int(offsets[-1]))
        x, R = start.x.copy(), start.R.copy()

        def steps(
            given: FilterInput, k: int, end: int, at: FilterState, ahead: Array, *rest: Any
        ) -> None:
            out, failure = rest
            unscented_epochs(
                *(assembly.tables, given, self.weights, self.iterations, k, end, x, R, ahead),
                *(out, r, spreads, offsets, failure),
            )

        at = FilterState(start.t, start.x, start.P)
        done = sweep(self.problem, assembly, steps, at, seconds=seconds)
        return _Sweep(**vars(done), r=r, spreads=spreads, offsets=offsets, R=R)

    def advance(
        self, state: UnscentedState, epoch: Epoch, assembly: Assembly | None = None
    ) -> UnscentedState:
        """Predict and update. Raises as `advanced`."""
        done = advanced(self.problem, state, epoch, assembly, self.through)
        return UnscentedState(*done.end, done.R, done)

    def grown(self, state: UnscentedState, before: UnscentedEngine) -> UnscentedState:
        """The state of an engine whose problem has fewer numbered blocks."""
        x, P = padded(self.problem.prior, state.x, state.P)
        known = len(state.R)
        R = block_diag(state.R, _root(P[known:, known:]))
        return UnscentedState(state.t, x, P, R, state.done)

    def save(self, state: UnscentedState) -> dict[str, Array]:
        """t (NaN before the first epoch), x, P, R."""
        return {"t": packed_time(state.t), "x": state.x, "P": state.P, "R": state.R}

    def load(self, arrays: Mapping[str, Array]) -> UnscentedState:
        """The state again."""
        t, x, P, R = (np.array(arrays[name]) for name in ("t", "x", "P", "R"))
        return UnscentedState(time_in(t), x, P, R)


@dataclass(frozen=True)
class Ukf(KalmanFilter):
    """Unscented Kalman filter: sigma points on the manifold, in square roots.

    Points drawn in the tangent of the estimate are carried by the processes and have a mean on the
    manifold; the process noise, that of the interval at the central point, is added, and points are
    drawn anew from the prediction before they are measured (Crassidis and Markley 2003; Julier and
    Uhlmann 2004; in square roots, van der Merwe 2004). As `smoothed`, the pass back over the
    regressions of the points (Sarkka 2008). alpha, beta, kappa: see
    `relnav_graph.maths.sigma_points.weights_of`; iterations: updates of each epoch.
    The spread grows with the number of states, unknown points among them. Where such points are
    first seen, the epoch is updated as by the extended filter, see
    `relnav_graph.linear.unscented.unscented_epochs`.

    The spread is the best of five over sixteen tumbles of `experiments/tumbling_rates.py`, by the
    median ANEES, 164. Untuned it does worse: 80,000 with the usual alpha = 1e-3, which is nearly an
    extended filter, and 2e7 with alpha = 1, kappa = 3 - n, points as far apart as a Gaussian's
    fourth moment wants them, but a negative central weight. With the noise drawn as well
    (augmented, not drawn anew) the median over six tumbles of 60 epochs was 1,300,000 where it is
    4,900 so. A first update far from linear is too much for any of them; the iterated filter
    (`iukf`) goes without most of that: 3.4.
    """

    kind: ClassVar[str] = "ukf"
    iterations: int = 1
    alpha: float = 0.3
    beta: float = 2.0
    kappa: float = 0.0

    def engine(self, problem: Problem) -> UnscentedEngine:
        """For use online. Raises InputError on a spread that is not one."""
        weights = weights_of(problem.layout.dim, self.alpha, self.beta, self.kappa)
        return UnscentedEngine(problem, weights, self.iterations)

    def run(self, problem: Problem) -> Track:
        """Filter the whole pass, and smooth it."""
        begun = time.perf_counter()
        track, done = self.filtered(problem)
        found: dict[str, Any] = {
            "kind": "smoothed",
            "step_s": None,
            "innovations": {},
            **smoothed_of(done, problem),
        }
        smoothed = replace(track, name=f"{self.kind}_smoothed", **found)
        smoothed = replace(smoothed, runtime_s=time.perf_counter() - begun)
        return replace(track, smoothed=smoothed)


@dataclass(frozen=True)
class IteratedUkf(Ukf):
    """Unscented Kalman filter with its updates iterated: points drawn anew from each result.

    Posterior linearisation: the points of what an update has found give the rows of the next one,
    of the same prediction (Garcia-Fernandez, Svensson, Morelande, Sarkka 2015), `iterations` times
    at most, or until a step is short. It is to `ukf` what `iekf` is to `ekf`.
    """

    kind: ClassVar[str] = "iukf"
    iterations: int = ITERATIONS
