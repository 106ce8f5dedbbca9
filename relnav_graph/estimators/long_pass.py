"""The batch smoother for passes whose matrices do not fit into memory.

The same optimum and the same covariances as `relnav_graph.estimators.batch`, in parts: going
forward, each part leaves only the exact linear summary of all before it; going back, each is
eliminated once more from the summary that it began with. What stays of an epoch is its
trajectory and what was measured, a few hundred numbers instead of some thousands.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import ITERATIONS, FilterState, run_filter
from relnav_graph.estimators.gauss_newton import at_rounding, smoothed
from relnav_graph.estimators.rts import smooth
from relnav_graph.estimators.weights import count_downweighted, count_rejected, left_out
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Conditionals, anchor_of
from relnav_graph.linear.elimination import System, linearize

__all__ = ["smooth_long_pass"]


@dataclass(eq=False)
class _Part:
    """Consecutive epochs of the pass. Before them stands the last epoch of the part before,
    without its measurements, which are in the anchor.

    x (N, size): trajectory; first (N, size): the one at which the process noise is evaluated;
    weights (observations,); anchor: all that is known of the first epoch from those before.
    """

    assembly: Assembly
    weights: Array
    x: Array
    first: Array
    anchor: Anchor

    def system(self, into: Conditionals | None) -> System:
        """The part linearised and eliminated; into: memory that may be filled, of any length."""
        whiten = self.assembly.whitening(self.first[:-1])
        if into is not None and len(into.d) != len(self.x):
            into = None
        models = self.assembly, self.anchor
        return linearize(*models, self.x, whiten, self.weights, into=into)


def _systems(parts: Iterable[_Part]) -> Iterator[System]:
    """The system of each part, made on demand; the next one overwrites it."""
    made = None
    for part in parts:
        system = part.system(made)
        made = system.conditionals
        yield system


def _parts(problem: Problem, epochs: Iterator[Epoch], size: int) -> Iterator[_Part]:
    """The pass in parts, with trajectories from the iterated filter, each smoothed alone."""
    at, layout = FilterState.at_prior(problem), problem.layout
    models, anchor = (layout, problem.processes, problem.sensors), anchor_of(problem.prior)
    while own := list(islice(epochs, size)):
        assembly, before = Assembly(*models, own, at.t), at.x
        done = run_filter(problem, ITERATIONS, assembly, at)
        at = done.end
        if done.stopped:
            raise EstimationError(done.stopped)
        x = smooth(done, covariances=False)[0]
        if len(assembly.tables.starts) == len(x):
            assembly, x = assembly.preceded(), np.concatenate([before[None], x])
        yield _Part(assembly, done.weights, x, x.copy(), anchor)


def _forward(parts: list[_Part]) -> tuple[float, float]:
    """Give each part its anchor; the whole cost, and the length of the Gauss-Newton step in
    sigmas."""
    cost = squared = 0.0
    for part, system, after in zip(parts, _systems(parts), [*parts[1:], None], strict=True):
        c = system.conditionals
        squared += 2 * c.decrease()
        cost += system.cost
        if after is not None:  # its first row repeats this one's last
            after.x[0] = after.first[0] = part.x[-1]
            after.anchor = c.anchor(part.x[-1].copy())
            squared -= float(after.anchor.d @ after.anchor.d)
            cost -= 0.5 * float(after.anchor.d @ after.anchor.d)
    return cost, float(np.sqrt(squared))


def _step(parts: list[_Part]) -> None:
    """Move all trajectories by one Gauss-Newton step."""
    end = None
    for part, system in zip(parts[::-1], _systems(parts[::-1]), strict=True):
        step = system.conditionals.solution(end)
        # In place: new arrays that stay, among large ones that go, would tear the memory up.
        part.x[:], end = part.assembly.layout.retract(system.x, step), step[0]


def smooth_long_pass(
    problem: Problem,
    more: Iterable[Epoch] = (),
    *,
    part: int = 1000,
    tolerance: float = 1e-3,
    max_iterations: int = 20,
) -> Iterator[Track]:
    """Smooth a pass of any length; tracks of adjoining parts, the last one first.

    problem: with the first epochs; more: all that follow, read once and not kept. part:
    epochs of each part; tolerance: as of `relnav_graph.estimators.batch.solve`. Observations
    that the filter's gates leave out stay left out. Raises EstimationError when the filter
    cannot go through, or when Gauss-Newton does not converge.
    """
    parts = list(_parts(problem, chain(problem.epochs, more), part))
    layout = problem.layout
    # One value for the pass: where the last part's filter ended, which has seen all of it.
    for one in parts:
        one.x[:, layout.moving.size :] = parts[-1].x[-1, layout.moving.size :]
        one.first[:] = one.x
    states = layout.moving.dim * sum(len(one.x) for one in parts) + layout.statics.dim
    (cost, distance), before = _forward(parts), np.inf
    for _ in range(max_iterations):
        if distance < tolerance or at_rounding(distance, before, states):
            break
        _step(parts)
        before, (cost, distance) = distance, _forward(parts)
    else:
        raise EstimationError(f"not converged: last step {distance:.2g} sigma")
    if not np.isfinite(cost):
        raise EstimationError("the cost is not finite")
    P_end: Array | None = None
    for one, system in zip(parts[::-1], _systems(parts[::-1]), strict=True):
        found = system.conditionals.marginals(P_end)
        own = slice(0 if one is parts[0] else 1, None)
        yield Track(
            name="batch",
            kind="smoothed",
            t=one.assembly.times[own],
            **smoothed(layout, one.x[own], found, own),
            rejected=count_rejected(one.assembly, one.weights),
            left_out=left_out(one.assembly, one.weights),
            downweighted=count_downweighted(one.assembly, one.weights),
        )
        P_end = found.whole(slice(1))[0]
