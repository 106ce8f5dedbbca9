"""Where a filter stands, and what it leaves behind on its way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Innovations, LeftOut, Status, Track, estimates
from relnav_graph.estimators.considered import considered_caution
from relnav_graph.estimators.trust import judge
from relnav_graph.estimators.weights import count_downweighted, count_rejected, left_out, lost
from relnav_graph.linear.assembly import Assembly

__all__ = ["FilterState", "FilterSweep"]


class FilterState(NamedTuple):
    """Where a filter stands: t, s, of its newest epoch, None before the first; the estimate
    x (size,) and its covariance P (n, n), in the tangent of x."""

    t: float | None
    x: Array
    P: Array

    @classmethod
    def at_prior(cls, problem: Problem) -> FilterState:
        """Before the first epoch of a problem."""
        return cls(None, problem.prior.x, problem.prior.P)


@dataclass(frozen=True, eq=False)
class FilterSweep:
    """A filter's way through epochs.

    By epoch: x_predicted (N, size) and P_predicted (N, n, n); F since the epoch before, zero
    at the first (or the last epoch's only); Q of the last epoch (1, q, q), q of the blocks that
    move; x, P; nis and
    used: the squared normalised innovation of the rows used, and their number. weights: of
    the observations, 1 or 0 for one left out. end: where the
    filter stood last. reached: epochs filtered; stopped: why it
    stopped early, or "".
    """

    assembly: Assembly
    x_predicted: Array
    P_predicted: Array
    F: Array
    Q: Array
    x: Array
    P: Array
    weights: Array
    nis: Array
    used: Indices
    end: FilterState
    reached: int = 0
    stopped: str = ""

    @property
    def rejected(self) -> dict[str, int]:
        """Observations left out in the epochs reached, by sensor."""
        return count_rejected(self.assembly, self.reached_weights)

    @property
    def left_out(self) -> dict[str, LeftOut]:
        """The same observations, of each sensor that has any."""
        return left_out(self.assembly, self.reached_weights)

    @property
    def downweighted(self) -> dict[str, int]:
        """Observations in the epochs reached that a robust loss lets count for less."""
        return count_downweighted(self.assembly, self.reached_weights)

    @property
    def reached_weights(self) -> Array:
        """The weights (observations,), 1 in the epochs that were not reached."""
        weights = self.weights.copy()
        weights[self.assembly.epoch_offsets[self.reached] :] = 1.0
        return weights

    def verdict(self, problem: Problem) -> tuple[Status, str]:
        """Whether to trust what the filter found, by its innovations."""
        if self.stopped:
            return "diverged", self.stopped
        away = lost(self.assembly, self.reached_weights)
        return judge(away, problem, float(self.nis.sum()), int(self.used.sum()))

    def track(self, kind: str, problem: Problem, seconds: Sequence[float]) -> Track:
        """What was found of a whole pass, by an estimator of a kind; seconds: of each epoch, s."""
        status, message = self.verdict(problem)
        return Track(
            name=kind,
            kind="filtered",
            t=problem.times,
            **estimates(problem.layout, self.x, self.P),
            status=status,
            message=message,
            runtime_s=float(sum(seconds)),
            step_s=np.array(seconds),
            rejected=self.rejected,
            left_out=self.left_out,
            downweighted=self.downweighted,
            innovations=self.innovations(),
            cautions=considered_caution(problem),
        )

    def innovations(self) -> dict[str, Innovations]:
        """Those of each sensor that saw anything, one epoch after the other, each epoch's
        whitened by the symmetric root of their covariance S."""
        a, found = self.assembly, dict[str, Innovations]()
        weights = self.weights.copy()
        weights[a.epoch_offsets[self.reached] :] = 0.0
        moments = self.moments(weights)
        sensor = np.where(a.rows_of(weights > 0), np.repeat(a.sensor_of, a.heights), -1)
        epoch = np.repeat(np.arange(len(a.times)), np.diff(a.row_offsets))
        for i, name in enumerate(a.sensor_names):
            own = np.flatnonzero(sensor == i)
            if not len(own):
                continue
            begin = np.flatnonzero(np.diff(epoch[own], prepend=-1))
            at, counts = epoch[own][begin], np.diff(begin, append=len(own))
            v = np.empty(len(own))
            for count in set(counts.tolist()):  # epochs of one size at once
                chosen = counts == count
                places = begin[chosen, None] + np.arange(count)
                v[places] = _whitened(*moments(at[chosen], own[places]))
            found[name] = Innovations(a.times[at], v, np.concatenate(([0], np.cumsum(counts))))
        return found

    def moments(self, weights: Array) -> Callable[[Indices, Indices], tuple[Array, Array]]:
        """Covariances S (e, rows, rows) and whitened innovations r (e, rows) of epochs (e,) and
        rows (e, rows); weights (observations,): 0 for one that is not asked for."""
        found = self.assembly.measure(self.x_predicted, weights)

        def of(epochs: Indices, rows: Indices) -> tuple[Array, Array]:
            H = found.H[rows]
            S = H @ self.P_predicted[epochs] @ H.transpose(0, 2, 1) + np.eye(rows.shape[1])
            return S, found.r[rows]

        return of


def _whitened(S: Array, r: Array) -> Array:
    """S^-1/2 r (N, rows), by the symmetric root, which turns no axis from epoch to epoch.

    S has no eigenvalue below 1, that of the measurement's noise, whatever rounding makes of it.
    """
    w, V = np.linalg.eigh(S)
    along = (r[:, None, :] @ V) / np.sqrt(np.maximum(w, 1.0))[:, None, :]
    white: Array = (V @ along.transpose(0, 2, 1))[:, :, 0]
    return white
