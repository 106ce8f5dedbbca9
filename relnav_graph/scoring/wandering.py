"""A caution, without truth or smoother: constants of which a filter changes its mind too often.

What a consistent filter ends with, of a constant, is the smoothed estimate of all earlier epochs
too. So x_k - x_N has the covariance P_k - P_N (McReynolds 1980; Gelb 1974, sec. 5.4): where it is
many times as large, the filter was sure of what it has given up since. That is how a filter errs
that cannot linearise anew what it has used, beside a map whose scale or axes it knew loosely at
first (Julier, Uhlmann 2001).
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from relnav_graph.core.cautions import Caution
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track

__all__ = ["WANDERING", "wandering_cautions", "wanderings"]

#: Name of the caution.
WANDERING = "wandering constants"
#: Chance that one of all constants of a consistent filter is beyond the limit, were all epochs one.
CHANCE = 1e-4
#: Part of a variance that must have been left to learn: else the ratio is one of rounding errors.
_LEARNT = 0.05


def wanderings(track: Track) -> dict[Block, float]:
    """Mean of (x_k - x_N)^2 / (P_k - P_N), over components and the last three quarters of the
    epochs, of each constant that was learnt then: at most about 1 for a consistent filter."""
    found = {}
    statics = track.statics.layout if track.statics is not None else ()
    for block in statics:
        if block.name in track.retired:
            continue
        x = track.value(block.name)
        P = np.diagonal(track.covariance(block.name), axis1=1, axis2=2)
        late = slice(len(x) // 4, None)
        d = block.local(x[late], np.ascontiguousarray(np.broadcast_to(x[-1], x[late].shape)))
        V = P[late] - P[-1]
        learnt = _LEARNT * P[late] < V
        if learnt.any():
            found[block] = float((d[learnt] ** 2 / V[learnt]).mean())
    return found


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of diverged tracks
def wandering_cautions(track: Track) -> tuple[Caution, ...]:
    """A caution where a filter has gone further from what it said of constants than it allowed."""
    found = wanderings(track) if track.kind == "filtered" else {}
    far = {
        block: ratio
        for block, ratio in found.items()
        if ratio > chdtri(block.dim, CHANCE / len(found)) / block.dim
    }
    if not far:
        return ()
    worst = max(far, key=far.__getitem__)
    text = (f"{worst.name} and {len(far) - 1} more" if len(far) > 1 else worst.name) + (
        f" of {len(found)} constants went further from what was said of them than their covariances"
        f" allow: {far[worst]:.3g} times, squared, on average over the last three quarters of the"
        " pass. A filter cannot linearise anew what it has used: trust a smoother (batch,"
        " incremental), or begin from one (ekf_batch_start)"
    )
    return (Caution(WANDERING, text),)
