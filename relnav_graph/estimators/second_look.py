"""A second look at a smoothed estimate, without truth: whether its covariance describes it.

A covariance holds where the cost is quadratic. Far targets and coarse lines of sight leave a
posterior that is bent, or has several modes, within a sigma of the estimate: then a solution may
fit best, say so with a small covariance, and be wrong.

The look displaces the first epoch by a draw d of its smoothed covariance P_0 and optimises the rest
anew. Were the posterior Gaussian, the cost would rise by |d|^2 / 2, |d|^2 = d^T P_0^-1 d, and no
epoch k would end further from the estimate than that: its displacement is P_k0 P_0^-1 d, and
P_k0 P_0^-1 P_0k is at most P_k. Where one does, or the cost rises otherwise, there are
trajectories, as likely as the covariance says that they are not.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Layout
from relnav_graph.errors import InputError
from relnav_graph.estimators.gauss_newton import Solution, smoothed, solve
from relnav_graph.estimators.source import UNSOLVED
from relnav_graph.estimators.trust import examine
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Marginals, anchor_of
from relnav_graph.linear.whitening import inverse_cholesky

__all__ = ["SECOND_LOOK", "conclude", "second_look"]

#: Name of the caution.
SECOND_LOOK = "bent posterior"
#: Draws, each with its opposite. Iterations of each: a posterior that needs more is bent.
DRAWS, ITERATIONS = 2, 4
#: Sigmas to which the first epoch is held where it was put, of its own.
HELD = 1e-4
#: How many times as far as the first epoch another may end, and bounds of the rise in cost, in
#: parts of what it should be.
FAR, RISES = 2.0, (0.6, 1.6)


def second_look(
    assembly: Assembly, prior: Prior, solution: Solution, found: Marginals
) -> tuple[Caution, ...]:
    """A caution where the covariances of a solution do not describe it, else none.

    Takes one to two times as long as the batch estimate. The draws
    are the same each time. Covariances that rounding has left not positive definite are doubted
    too: the estimate stands, and nothing can be drawn from them.
    """
    try:
        return _look(assembly, prior, solution, found)
    except (np.linalg.LinAlgError, InputError) as error:
        return (Caution(SECOND_LOOK, f"no second look could be taken: {error}"),)


def _look(
    assembly: Assembly, prior: Prior, solution: Solution, found: Marginals
) -> tuple[Caution, ...]:
    """`second_look` of covariances that are positive definite; else raises."""
    layout, x, rng = assembly.layout, solution.x, np.random.default_rng(np.random.SeedSequence(0))
    first, moving, P = found.whole(slice(1))[0], layout.moving, found.P
    L, W, own = np.linalg.cholesky(first), inverse_cholesky("the estimate", first), anchor_of(prior)
    for z in rng.standard_normal((DRAWS, layout.dim)):
        for d in (L @ z, -(L @ z)):
            start, length = x.copy(), float(np.linalg.norm(z))
            start[0] = layout.retract(x[0], d)
            start[:, moving.size :] = start[0, moving.size :]
            held = Anchor(start[0], W / HELD, np.zeros(layout.dim))
            try:
                other = solve(
                    *(assembly, held, start, solution.weights),
                    tolerance=0.3,
                    max_iterations=ITERATIONS,
                )
            except UNSOLVED as error:
                return (_caution(length, f"there is no trajectory from there: {error}"),)
            e, _ = own.rows(layout, other.x[0])
            rise = (other.cost + 0.5 * float(e @ e) - solution.cost) / (0.5 * length**2)
            far = _distances(moving, x[:, : moving.size], P, other.x[:, : moving.size])
            k = int(far.argmax())
            if far[k] > FAR * length:
                moved = _most_moved(moving, x[k], P[k], other.x[k])
                return (
                    _caution(
                        length,
                        f"the best trajectory from there is {far[k]:.3g} sigma off at"
                        f" t = {assembly.times[k]:.6g} s, most in {moved}; in a posterior that the"
                        f" covariance describes, it is at most {length:.2g}",
                        moved,
                    ),
                )
            if not RISES[0] < rise < RISES[1]:
                return (
                    _caution(length, f"the cost rises by {rise:.3g} times what it should then"),
                )
    return ()


def _caution(length: float, what: str, which: str = "a direction of the state") -> Caution:
    """What was found at so many sigmas, and what to do; which: block or direction is to blame."""
    return Caution(
        SECOND_LOOK,
        f"with the first epoch displaced by {length:.2g} sigma, {what}. So {which} is hardly known:"
        " a tighter prior or a sensor of it helps; else judge derived quantities",
    )


def _distances(layout: Layout, x: Array, P: Array, other: Array) -> Array:
    """How far each epoch of `other` is from x (N, size), (N,), in sigmas of P (N, n, n), over all
    its states together."""
    d, out, step = layout.local(x, other), np.empty(len(x)), 4096
    for k in range(0, len(x), step):  # in parts: a long pass has no room for another P
        part = slice(k, k + step)
        white = np.linalg.solve(np.linalg.cholesky(P[part]), d[part, :, None])
        out[part] = np.sqrt(np.square(white).sum(axis=(1, 2)))
    return out


def _most_moved(layout: Layout, x: Array, P: Array, other: Array) -> str:
    """The block of x (size,) that has moved most, in its sigmas of P (n, n)."""
    d = np.abs(layout.local(x, other)) / np.sqrt(np.diag(P))
    return max((b.name for b in layout), key=lambda name: float(d[layout.tangent(name)].max()))


def conclude(
    problem: Problem,
    assembly: Assembly,
    solution: Solution,
    begun: float,
    unconverged: float | None = None,
) -> tuple[dict[str, Any], dict[str, Any], float]:
    """What a track has of a solution over the whole pass: its states and covariances, as of
    `smoothed`; its status and what goes with it, as of `examine`, with a second look where it is
    ok; and how long the estimate took since `begun` (of `time.perf_counter`), s, without that.

    unconverged: see `relnav_graph.estimators.trust.examine`.
    """
    marginals = solution.conditionals.marginals()
    ended = smoothed(problem.layout, solution.x, marginals)
    found = examine(problem, assembly, solution.weights, solution.cost, unconverged)
    seconds = time.perf_counter() - begun
    if found["status"] == "ok":
        found["cautions"] = second_look(assembly, problem.prior, solution, marginals)
    return ended, found, seconds
