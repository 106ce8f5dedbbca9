"""Gauss-Newton with Levenberg damping over the whole graph; gates and robust losses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Layout
from relnav_graph.core.track import estimates_in_parts
from relnav_graph.errors import EstimationError, GeometryError, ModelError
from relnav_graph.estimators.first_sights import has_map
from relnav_graph.estimators.weights import contested, residual_weights, thresholds
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Conditionals, Marginals, anchor_of
from relnav_graph.linear.elimination import System, linearize
from relnav_graph.maths.losses import Loss

__all__ = ["Solution", "at_rounding", "is_small", "smoothed", "solve", "solve_gated"]

#: A step of fewer sigmas is none. Where rounding is more than that, as on long passes far from
#: the target, it shows in steps that are small, in sigmas of a state, and stay as long.
ROUNDING, SMALL, STALLED = 1e-7, 1e-3, 0.9
#: The cost is a sum of many squares, each rounded: no reason to stop, or to prefer one before.
COST_ROUNDING = 1e-10
#: Rounds of reweighting, at most, and the change of a weight's root that ends them.
ROUNDS, WEIGHT_TOLERANCE = 50, 1e-3


@dataclass(frozen=True, eq=False)
class Solution:
    """Trajectory x (N, size), the conditionals there, the final cost and step.

    status (observations,): not 0 for one impossible there; weights (observations,): square
    roots of their weights; distance: length of the last Gauss-Newton step,
    in sigmas over all states.
    """

    x: Array
    conditionals: Conditionals
    cost: float
    status: Indices
    weights: Array
    distance: float
    iterations: int


def smoothed(
    layout: Layout, x: Array, found: Marginals, part: slice = slice(None)
) -> dict[str, Any]:
    """layout, x, P and statics of a smoothed track: states x (K, size) of some epochs, all by
    default, and their covariances."""
    P_s = np.broadcast_to(found.statics, (len(x), *found.statics.shape))
    return estimates_in_parts(layout, x, found.P[part], P_s, found.cross[part])


@dataclass(frozen=True, eq=False)
class _Linearisation:
    """A pass with everything fixed but the trajectory.

    made: the conditionals of all systems so far, memory that is used again.
    """

    assembly: Assembly
    anchor: Anchor
    whiten: Array
    weights: Array
    made: list[Conditionals] = field(default_factory=list)

    def at(self, x: Array, needed: Sequence[System] = (), damping: Array | None = None) -> System:
        """The system at x (N, size); overwrites all earlier systems but the `needed` ones.

        damping: (N, n), see `linearize`.
        """
        kept = [system.conditionals for system in needed]
        free = [c for c in self.made if all(c is not one for one in kept)]
        models = self.assembly, self.anchor
        system = linearize(
            *(*models, x, self.whiten, self.weights, damping), into=free[0] if free else None
        )
        if not free:
            self.made.append(system.conditionals)
        return system

    def damped(self, system: System, damping: float) -> Conditionals:
        """The same system with Levenberg's damping, in units of each state's own sigma.

        Scaled by the diagonal of the information, as is usual, damping would freeze the weak
        directions, which many states share: there a state's own sigma is large.
        """
        found = system.conditionals.marginals()
        statics = np.tile(np.diag(found.statics), (len(system.x), 1))
        variances = np.hstack([np.einsum("kii->ki", found.P), statics])
        return self.at(system.x, [system], np.sqrt(damping / variances)).conditionals

    def moved(self, system: System, step: Array, best: System) -> System | None:
        """The system after a step; None where it cannot be. Leaves system and best alone.

        An observation that the step makes impossible must not pass for one that fits.
        """
        x = self.assembly.layout.retract(system.x, step)
        try:
            after = self.at(x, [system, best])
        except (GeometryError, ModelError, EstimationError):
            return None
        lost = (after.status > 0) & (system.status == 0)
        return None if lost.any() or not np.isfinite(after.cost) else after


def at_rounding(distance: float, before: float, states: int) -> bool:
    """Whether a Gauss-Newton step is mere rounding, by its length, in sigmas over all states.

    before: the length of the step before.
    """
    stalled = distance > STALLED * before and is_small(distance, states)
    return distance < ROUNDING or stalled


def is_small(distance: float, states: int) -> bool:
    """Whether a step of that length over all states together is small for each."""
    return distance < SMALL * float(np.sqrt(states))


def solve(
    assembly: Assembly,
    prior: Prior | Anchor,
    x: Array,
    weights: Array,
    *,
    tolerance: float = 1e-3,
    max_iterations: int = 50,
) -> Solution:
    """Minimise the whole cost from the trajectory x (N, size), stored vectors; static blocks from
    those of its last row.

    weights: (observations,), square roots of the weights, held fixed.

    Steps are Gauss-Newton's. In a narrow, bent valley a good one may raise the cost
    before the next lowers it, so two may (the watchdog of Chamberlain et al. 1982);
    then the best point so far is taken up again, with damping. tolerance: the length of
    the last step, in sigmas over all states together, where rounding allows it. Noise that
    depends on the state is taken at the first trajectory, so that the cost stays one
    function. Raises EstimationError on a system without a solution.
    """
    anchor, x = prior if isinstance(prior, Anchor) else anchor_of(prior), assembly.layout.held(x)
    whiten = assembly.whitening(x[:-1])
    the_pass = _Linearisation(assembly, anchor, whiten, weights)
    best = system = the_pass.at(x)
    conditionals = system.conditionals
    damping, ventured, distance, iteration = 0.0, 0, np.inf, 0
    while iteration < max_iterations:
        iteration += 1
        before, distance = distance, np.sqrt(2 * system.conditionals.decrease())
        if damping == 0.0 and at_rounding(distance, before, system.conditionals.states):
            break
        after = the_pass.moved(system, conditionals.solution(), best)
        better = after is not None and after.cost <= best.cost * (1 + COST_ROUNDING)
        if after is not None and (better or (damping == 0.0 and ventured < 2)):
            system = after
            ventured = 0 if better else ventured + 1
            if better:
                best = system
                converged = distance < tolerance and damping == 0.0
                damping = damping / 10 if damping > 1e-3 else 0.0
                if converged:
                    break
        elif distance < tolerance or damping > 1e8:
            break
        else:
            system = best
            damping, ventured = max(10 * damping, 1e-2), 0
        conditionals = the_pass.damped(system, damping) if damping else system.conditionals
    return Solution(
        *(best.x, best.conditionals, best.cost, best.status),
        *(weights, float(distance), iteration),
    )


def solve_gated(
    assembly: Assembly,
    problem: Problem,
    x: Array,
    weights: Array,
    tolerance: float = 1e-3,
    anchor: Anchor | None = None,
) -> Solution:
    """`solve`, with the weights of gates and robust losses renewed until they stay the same.

    x (N, size): trajectory to start from; weights (observations,): square roots of the weights
    to start with; anchor: instead of the problem's prior.

    Where something was rejected, or a loss redescends, there are many minima. Then the problem
    is solved with Huber's loss first, which has one minimum, so that what to leave out is decided
    at a robust estimate. With gates alone it is also solved without that detour, and the better
    of the two results is taken.

    Of a numbered block, such as a point of a map, whose first sight was wrong, a gate leaves out
    all right ones. So where a block is `contested`, and only there, with numbered blocks, the
    gates are decided anew: Huber's loss is followed by Cauchy's, which at last lets no wrong sight
    pull. What is contested even then is retired: all its observations are left out, and it stays
    at its prior until it is seen again.
    """
    prior = problem.prior if anchor is None else anchor
    solution = solve(assembly, prior, x, weights, tolerance=tolerance)
    if not (problem.gates or problem.losses) and (solution.status == 0).all():
        return solution
    losses, numbered = problem.losses, has_map(assembly.layout)
    doubtful = {name for name, loss in losses.items() if loss.redescends}
    straight = None
    if not doubtful:  # a gate alone: as good a way is the one without a detour
        straight = _reweighted(
            *(assembly, prior, solution, problem.gates, losses), tolerance, WEIGHT_TOLERANCE
        )
    if straight is not None and numbered and not contested(assembly, straight.weights).any():
        return straight
    if (solution.weights == 0).any() or numbered:
        doubtful |= set(problem.gates)
    if straight is not None and not doubtful:
        return straight
    kept = {name: gate for name, gate in problem.gates.items() if name not in doubtful}
    convex = {**losses, **dict.fromkeys(doubtful, Loss("huber"))}
    rough = _reweighted(assembly, prior, solution, kept, convex, 0.1, 0.05)
    if numbered and problem.gates:
        last = {**losses, **dict.fromkeys(problem.gates, Loss("cauchy"))}
        rough = _reweighted(assembly, prior, rough, kept, last, 0.1, 0.05)
    found = _reweighted(
        *(assembly, prior, rough, problem.gates, losses), tolerance, WEIGHT_TOLERANCE
    )
    limits = thresholds(assembly, problem.gates)
    if straight is not None:
        found = min(straight, found, key=lambda s: _truncated(s, limits))
    retired = contested(assembly, found.weights) & np.isfinite(limits) & (found.weights > 0)
    if not retired.any():
        return found
    kept_weights = np.where(retired, 0.0, found.weights)
    return solve(assembly, prior, found.x, kept_weights, tolerance=tolerance)


def _truncated(solution: Solution, limits: Array) -> float:
    """The cost that a gate minimises: what is beyond it counts as much as at its edge."""
    out = solution.weights == 0
    return solution.cost + 0.5 * float(np.where(np.isfinite(limits), limits, 0.0)[out].sum())


def _reweighted(
    assembly: Assembly,
    prior: Prior | Anchor,
    solution: Solution,
    gates: Mapping[str, float],
    losses: Mapping[str, Loss],
    tolerance: float,
    settled: float,
) -> Solution:
    """The solution with weights that its own residuals give, within `settled`."""
    everything, rounds = np.ones(assembly.observations), ROUNDS if losses else 10
    for _ in range(rounds):
        rows = assembly.measure(solution.x, everything)
        weights = residual_weights(assembly, rows, gates, losses)
        if np.abs(weights - solution.weights).max(initial=0.0) <= settled:
            break
        # While the weights still change, two steps at a time are enough.
        solution = solve(
            *(assembly, prior, solution.x, weights), tolerance=tolerance, max_iterations=2
        )
    if solution.distance < tolerance:
        return solution
    return solve(assembly, prior, solution.x, solution.weights, tolerance=tolerance)
