"""Tracks with static blocks, made by hand: a moving position, a mounting that is constant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track, Truth, estimates
from relnav_graph.maths import so3

MOUNTING = Block("mounting", "R_cs", "SO3", 3, "rad", "cs", "deg")
LEVER_ARM = Block("lever_arm", "r_sc_c", "vector", 3, "m", "c", "cm")
LAYOUT = Layout([RELATIVE_POSITION], [MOUNTING, LEVER_ARM])


def true_states(epochs: int) -> Array:
    """(N, size): a straight path, and the same constants in all rows."""
    constant = {"mounting": so3.exp(np.array([0.3, -0.2, 1.0])), "lever_arm": [0.1, 0.0, -0.3]}
    path = np.array([10.0, -40.0, 3.0]) + np.arange(epochs)[:, None] * np.array([0.1, 0.2, 0.0])
    return np.array([LAYOUT.pack({"relative_position": r, **constant}) for r in path])


def joint_covariance(seed: int = 3) -> Array:
    """(9, 9), with strong correlations between all blocks."""
    rng = np.random.default_rng(seed)
    sigma = np.array([0.1, 0.2, 0.1, 0.01, 0.02, 0.01, 0.05, 0.04, 0.03])
    root = np.tril(rng.normal(size=(9, 9))) + 0.3 * np.eye(9)
    root *= (sigma / np.linalg.norm(root, axis=1))[:, None]
    P: Array = root @ root.T
    return P


def truth_of_statics(epochs: int = 40) -> Truth:
    return Truth(np.arange(float(epochs)), LAYOUT.values(true_states(epochs)))


def filtered(epochs: int = 40, seed: int = 0, **options: Any) -> Track:
    """One that learns: at epoch k the covariance of all is 1 / (k + 1) of the first, and one
    error, drawn from that, shrinks with it."""
    P = joint_covariance()
    shrink = 1 / np.arange(1.0, epochs + 1)
    d = np.random.default_rng(seed).multivariate_normal(np.zeros(9), P)
    x = LAYOUT.retract(true_states(epochs), -np.sqrt(shrink)[:, None] * d)
    t = np.arange(float(epochs))
    own = estimates(LAYOUT, x, shrink[:, None, None] * P)
    return Track(**({"name": "ekf", "kind": "filtered", "t": t} | own | options))


def smoothed(epochs: int = 40, seed: int = 0, **options: Any) -> Track:
    """What the filter ends with, at all epochs."""
    last = filtered(epochs, seed).at(slice(-1, None))
    assert last.statics is not None
    d = LAYOUT.local(true_states(epochs)[-1:], np.hstack([last.x, last.statics.x]))
    x = LAYOUT.retract(true_states(epochs), np.tile(d, (epochs, 1)))
    x[:, LAYOUT.moving.size :] = last.statics.x
    P = np.tile(joint_covariance() / epochs, (epochs, 1, 1))
    options = {"name": "batch", "kind": "smoothed"} | options
    return replace(filtered(epochs, seed), **estimates(LAYOUT, x, P), **options)
