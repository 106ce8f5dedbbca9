"""Static blocks that a smoother counts and does not estimate: held at their prior mean, with what
their uncertainty does to all others in the covariance (consider-covariance).

    P = P_x|p + S P_p S^T,  S = dx/dp

What the estimate x does when the held value p moves is the regression of x on p, whatever the
prior of p is. So a smoother holds p by a prior `HELD` times as wide, and S and P_x|p are in its
joint covariance (Schmidt 1966; Bierman 1977, chapter VIII; Woodbury and Junkins 2010).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.cautions import Caution
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError

__all__ = ["CONSIDERED", "considered_caution", "considering"]

#: Name of the caution of a track that counts what it does not estimate.
CONSIDERED = "consider-covariance"
#: What is left of a prior's sigmas that holds a block: small enough to be nothing beside them, and
#: large enough to keep the digits of S.
HELD = 1e-4


def considered_caution(problem: Problem) -> tuple[Caution, ...]:
    """What a track of a problem with considered blocks says of itself."""
    if not problem.considered:
        return ()
    text = f"{', '.join(problem.considered)}: counted, not estimated; covariances count them"
    return (Caution(CONSIDERED, text),)


def considering(problem: Problem, run: Callable[[Problem], Track], who: str) -> Track:
    """The track that `run` makes of a problem with its considered blocks held, and counted.

    who: the estimator, for the message. Raises InputError when a considered block is not static, or
    a variable of the user's is in the graph, of which no covariance with it is known.
    """
    columns, moving = problem.considered_columns, problem.layout.moving
    if not len(columns):
        return run(problem)
    driven = [name for name in problem.considered if name in moving]
    if driven:
        raise InputError(
            f"considered: found {', '.join(driven)}, of which each epoch has its own, expected"
            f" static blocks for {who}; ekf considers others, too"
        )
    P_p = problem.prior.P[np.ix_(columns, columns)]
    track = run(replace(problem, prior=_held(problem.prior, columns), considered=()))
    if track.extra:
        raise InputError("extra: found variables beside considered blocks, expected none")
    track = _counted(track, columns - moving.dim, P_p)
    doubt = considered_caution(problem)
    after = track.smoothed and replace(
        _counted(track.smoothed, columns - moving.dim, P_p),
        cautions=track.smoothed.cautions + doubt,
    )
    return replace(track, cautions=track.cautions + doubt, smoothed=after)


def _held(prior: Prior, columns: Indices) -> Prior:
    """A prior in which the states at `columns` are held, and the others know them all the same."""
    P = prior.P
    P_p = P[np.ix_(columns, columns)]
    slope = np.linalg.solve(P_p, P[columns]).T
    less = P - (1 - HELD**2) * slope @ P_p @ slope.T
    return Prior(prior.x, 0.5 * (less + less.T))


def _counted(track: Track, columns: Indices, P_p: Array) -> Track:
    """The track with the uncertainty P_p (c, c) of held static states, at `columns` of all static
    ones, in its covariances."""
    s = track.statics
    assert s is not None
    held = s.P[:, columns[:, None], columns]
    # Estimators that have diverged have no covariance.
    known = np.isfinite(held).all(axis=(1, 2)) & np.isfinite(s.cross).all(axis=(1, 2))
    S_x, S_s = (
        np.full_like(s.cross[:, :, columns], np.nan),
        np.full_like(s.P[:, :, columns], np.nan),
    )
    inverse = np.linalg.inv(held[known])
    S_x[known] = s.cross[known][:, :, columns] @ inverse
    S_s[known] = s.P[known][:, :, columns] @ inverse
    more = P_p - held

    def added(P: Array, A: Array, B: Array) -> Array:
        out: Array = P + A @ more @ B.transpose(0, 2, 1)
        return out

    statics = replace(s, P=added(s.P, S_s, S_s), cross=added(s.cross, S_x, S_s))
    return replace(track, P=added(track.P, S_x, S_x), statics=statics)
