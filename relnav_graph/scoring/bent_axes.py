"""A caution, without truth: vectors of which the axes are known so badly that no covariance in
these axes describes them.

A vector v in b is what the data tell of v_a = R_ab v in other axes, turned back by an attitude that
is estimated too. Displaced by one sigma of that attitude, v with it as their covariance says, v_a
stays where it is to first order, or moves within its own sigma; what is left to second order,
(v_a(+) + v_a(-)) / 2 - v_a, is what the covariance cannot say. In units of that of v_a it is a
curvature (Bates, Watts 1980: of the parameters, not of the data): small for every consistent
linear covariance.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.scored import InAxes
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track
from relnav_graph.scoring.deviations import finite

__all__ = ["BENT_AXES", "axes_cautions", "bend"]

#: Name of the caution.
BENT_AXES = "bent axes"
#: Sigmas of second-order change for one of the attitude from which on it is a caution: at two
#: sigmas, it is four times as much.
BENT = 0.1
#: Part of the epochs in which it must be so: not a filter's first, or a single one.
PART = 0.05
#: Frames that do not turn with a body: nobody doubts their axes.
_FIXED = "io"


def _pairs(track: Track) -> Iterator[tuple[Block, InAxes]]:
    """Attitudes, and vectors in the axes of a body that is so turned."""
    turns = [b for b in track.layout if b.manifold == "SO3" and len(b.frame) == 2]
    vectors = [b for b in track.blocks if b.manifold == "vector" and b.dim == 3]
    for turn in turns:
        a, b = turn.frame[0], turn.frame[1]
        for vector in vectors:
            own = vector.frame in (a, b) and vector.frame not in _FIXED
            if own and a != b and vector.number is None:
                yield turn, InAxes.of(vector, b if vector.frame == a else a, [turn])


def bend(track: Track, turn: Block, seen: InAxes) -> Array:
    """Second-order change (N,) of a vector in other axes over one sigma of the attitude `turn`, in
    sigmas: the largest of three directions. NaN where there is no covariance."""
    vector = seen.reads[-1]
    out = np.full(len(track.t), np.nan)
    layout = Layout([turn, vector])
    x = np.hstack([track.value(b.name).reshape(len(out), -1) for b in layout])
    P = track.covariance(turn.name, vector.name)
    known = np.flatnonzero(finite(x, P))
    x, P = x[known], P[known]
    w, V = np.linalg.eigh(P[:, :3, :3])
    sure = w[:, 0] > 0
    known, x, P, w, V = known[sure], x[sure], P[sure], w[sure], V[sure]
    if not len(known):
        return out

    def at(y: Array) -> tuple[Array, Array]:
        return seen.values(layout.value(y, turn.name), layout.value(y, vector.name))

    middle, J = at(x)
    P_a = J @ P @ J.transpose(0, 2, 1)
    scale = np.sqrt(np.einsum("kii->ki", P_a))
    found = np.zeros(len(known))
    for k in range(3):
        d = P[:, :, :3] @ (V[:, :, k] / np.sqrt(w[:, k, None]))[:, :, None]  # one sigma long
        d = d[:, :, 0]
        change = 0.5 * (at(layout.retract(x, d))[0] + at(layout.retract(x, -d))[0]) - middle
        found = np.fmax(found, np.abs(change / scale).max(axis=1))
    out[known] = found
    return out


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # diverged tracks: nothing is said
def axes_cautions(track: Track) -> tuple[Caution, ...]:
    """A caution for each vector of a track that is bent by an attitude that is not known better."""
    found = dict[str, Caution]()
    for turn, seen in _pairs(track) if len(track.t) else ():
        change = bend(track, turn, seen)
        bent = change > BENT
        name = seen.block.name
        if bent.mean() > PART and name not in found:
            k = int(np.nanargmax(np.where(bent, change, np.nan)))
            found[name] = Caution(
                BENT_AXES,
                f"over one sigma of {turn.name}, {name} changes by up to {change[k]:.2g} sigma"
                f" to second order (at t = {track.t[k]:.6g} s; in {bent.mean():.0%} of the"
                f" epochs by more than {BENT:g}): its covariance in axes"
                f" {seen.reads[-1].frame} does not describe it. Judge it in axes"
                f" {seen.block.frame} ([score] axes), trust no joint NEES with it, or measure"
                f" {turn.name} better",
            )
    return tuple(found.values())
