"""Families of numbered blocks, such as the points of a map: one state each, and what is derived.

A family of k blocks of dimension d has its values one after the other, (k d,), and their joint
covariance. Of points X_j, in the frame whose origin is the centre of mass, follow

    centre_of_mass  c = -sum X_j / k: where it is in the geometry, from the middle of the points;
    map_scale       s = ln sqrt(sum |X_j - sum X_i / k|^2 / k): errors are relative errors of size.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import POINT
from relnav_graph.core.numbered import members, unnumbered
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track, Truth
from relnav_graph.scoring.deviations import StateErrors, StateEstimates, finite
from relnav_graph.scoring.truth_noise import noise_of

__all__ = ["CENTRE_OF_MASS", "MAP_SCALE", "family", "family_scores", "known_points"]

CENTRE_OF_MASS = Block("centre_of_mass", "c_t", "vector", 3, "m", "t", "mm")
MAP_SCALE = Block("map_scale", "s_t", "vector", 1, "1", "t", "1")


def family(track: Track, blocks: tuple[Block, ...]) -> StateEstimates:
    """The numbered blocks of one family as one state."""
    names = [b.name for b in blocks]
    value = np.hstack([track.value(n) for n in names])
    P = track.covariance(*names)
    return StateEstimates(unnumbered(blocks[0]), value, P, True, blocks)


def _known(t: Array, blocks: tuple[Block, ...], truth: Truth | None) -> dict[Block, Array]:
    """True values (N, dim) of those blocks that truth knows at all times t (N,), s."""
    if truth is None:
        return {}
    rows, there = truth.at(t)
    found = {b: truth.values[b.name][rows] for b in blocks if b.name in truth.values}
    return {b: v for b, v in found.items() if there.all() and finite(v).all()}


def _derived(block: Block, value: Array) -> dict[Block, tuple[Array, Array]]:
    """Values (N, dim) and Jacobians (N, dim, k 3) of what follows from points (N, k 3), m."""
    if block != POINT:
        return {}
    X = value.reshape(len(value), -1, 3)
    k = X.shape[1]
    centred = X - X.mean(axis=1, keepdims=True)
    square = (centred**2).sum(axis=(1, 2))
    middle = np.tile(-np.eye(3) / k, (len(X), 1, k))
    found = {CENTRE_OF_MASS: (-X.mean(axis=1), middle)}
    if k > 1 and (square > 0).all():
        slope = centred.reshape(len(X), 1, -1) / square[:, None, None]
        found[MAP_SCALE] = (0.5 * np.log(square / k)[:, None], slope)
    return found


def _with_derived(state: StateEstimates) -> dict[str, StateEstimates]:
    found = {state.block.name: state}
    for block, (value, J) in _derived(state.block, state.value).items():
        P = J @ state.P @ J.transpose(0, 2, 1)
        found[block.name] = StateEstimates(block, value, P, True)
    return found


@np.errstate(over="ignore", invalid="ignore")  # of diverged tracks
def family_scores(
    track: Track, truth: Truth | None
) -> tuple[dict[str, StateEstimates], dict[str, StateErrors]]:
    """Estimates of the families of a track, and of what is derived of them; and their errors.

    Errors are of those blocks that truth knows at all epochs of the track, and so is what is
    derived. Joint covariances of many blocks are large: of a track with few epochs.
    """
    states: dict[str, StateEstimates] = {}
    errors: dict[str, StateErrors] = {}
    for blocks in members(track.mapped).values():
        states |= _with_derived(family(track, blocks))
        known = _known(track.t, blocks, truth)
        if not known or truth is None:
            continue
        own = family(track, tuple(known))
        true = np.hstack(list(known.values()))
        itself = np.tile(np.eye(true.shape[1]), (len(true), 1, 1))
        values = {own.block: (true, itself)} | _derived(own.block, true)
        rows, _ = truth.at(track.t)
        for name, state in _with_derived(own).items():
            if state.block in values:
                value, J = values[state.block]
                noise = noise_of(own.members, J, truth.sigmas, rows)
                e, P = state.to(value), state.P
                errors[name] = StateErrors(state.block, track.t, e, P, state.members, noise=noise)
    return states, errors


def known_points(truth: Truth | None) -> Mapping[str, Array]:
    """True points (3,), m, in t, by the name of their block: at the first epoch, as at all."""
    values = {} if truth is None or not len(truth.t) else truth.values
    prefix = f"{POINT.name}["
    return {n: v[0] for n, v in values.items() if n.startswith(prefix) and finite(v[:1]).all()}
