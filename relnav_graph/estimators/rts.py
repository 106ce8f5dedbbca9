"""Rauch-Tung-Striebel smoother on the iterated filter."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from relnav_graph.estimators.ekf import (
    ITERATIONS,
    FilterStep,
    add_counts,
    filter_pass,
    nan_tail,
    symmetric,
)
from relnav_graph.problem import Problem
from relnav_graph.state import Layout
from relnav_graph.track import Track

__all__ = ["Rts", "smooth"]

Array = NDArray[np.float64]


def smooth(layout: Layout, steps: Sequence[FilterStep]) -> tuple[Array, Array]:
    """Smoothed states (N, size) and covariances (N, n, n) from a filter's steps.

    Rauch, Tung, Striebel 1965; the differences are tangent vectors and covariances move
    between tangents by the right Jacobian.
    """
    xs, Ps = [steps[-1].x], [steps[-1].P]
    for step, after in zip(steps[-2::-1], steps[:0:-1], strict=True):
        assert after.F is not None
        scale = np.sqrt(np.diag(after.P_predicted))
        factor = cho_factor(after.P_predicted / np.outer(scale, scale), lower=True)
        gain = cho_solve(factor, (after.F @ step.P) / scale[:, None]).T / scale
        d = layout.local(after.x_predicted, xs[-1])
        to_predicted = layout.right_jacobian_inverse(d)
        P_after = to_predicted @ Ps[-1] @ to_predicted.T
        move = gain @ d
        J = layout.right_jacobian(move)
        P = step.P + gain @ (P_after - after.P_predicted) @ gain.T
        xs.append(layout.retract(step.x, move))
        Ps.append(symmetric(J @ P @ J.T))
    return np.array(xs[::-1]), np.array(Ps[::-1])


@dataclass(frozen=True)
class Rts:
    """Forward iterated filter, backward smoother; each update is linearised once only,
    at what the filter knew."""

    kind: ClassVar[str] = "rts"
    iterations: int = ITERATIONS

    def run(self, problem: Problem) -> Track:
        """Smooth the whole pass."""
        start = time.perf_counter()
        done = filter_pass(problem, self.iterations)
        steps, stopped = done.steps, done.stopped
        count, n, size = len(problem.epochs), problem.layout.dim, problem.layout.size
        x, P = nan_tail([], count, (size,)), nan_tail([], count, (n, n))
        rejected = add_counts([s.rejected for s in steps], problem.sensors)
        status, message = done.verdict(rejected, problem)
        if not stopped:
            try:
                x, P = smooth(problem.layout, steps)
            except (np.linalg.LinAlgError, ValueError) as error:
                status, message = "diverged", f"backward pass: {error}"
        return Track(
            name=self.kind,
            kind="smoothed",
            layout=problem.layout,
            t=problem.times,
            x=x,
            P=P,
            status=status,
            message=message,
            runtime_s=time.perf_counter() - start,
            rejected=rejected,
        )
