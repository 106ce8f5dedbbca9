"""Tracks with a map of unknown points, made by hand: the target tumbles, the chaser stands off."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import INERTIA_MATRIX, POINT, RELATIVE_POSITION, TARGET_ATTITUDE
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track, Truth, estimates
from relnav_graph.maths import so3

#: In order of first sight.
IDS = (3, 0, 7, 1, 12)
POINTS = np.array(
    [[1.0, 0.2, -0.4], [-0.8, 0.9, 0.1], [0.3, -1.1, 0.6], [-0.5, -0.6, -0.7], [0.1, 0.8, 0.9]]
)
SHAPE = np.array([0.3, -0.2, 0.15, 0.1, -0.05])
LAYOUT = Layout(
    [TARGET_ATTITUDE, RELATIVE_POSITION], [INERTIA_MATRIX, *(POINT.numbered(i) for i in IDS)]
)
EPOCHS = 40


def true_states(epochs: int = EPOCHS) -> Array:
    """(N, size)."""
    fixed = {f"point[{i}]": X for i, X in zip(IDS, POINTS, strict=True)}
    fixed |= {"inertia_matrix_parameters": SHAPE}
    out = []
    for k in range(epochs):
        pose = {"target_attitude": so3.exp(np.array([0.02, 0.1, -0.03]) * k)}
        pose["relative_position"] = np.array([12.0 + 0.02 * k, -5.0 + 0.1 * k, 3.0])
        out.append(LAYOUT.pack(pose | fixed))
    return np.array(out)


def truth_of_map(epochs: int = EPOCHS, **more: Array) -> Truth:
    """The truth, which knows a point (20) that nobody has seen, too."""
    values = dict(LAYOUT.values(true_states(epochs)))
    values["point[20]"] = np.tile([0.5, 0.5, -1.0], (epochs, 1))
    return Truth(np.arange(float(epochs)), values | more)


def joint_covariance(seed: int = 5) -> Array:
    """(26, 26): pose, inertia, points, correlated; the points share a common shift."""
    rng = np.random.default_rng(seed)
    sigma = np.concatenate(
        [np.full(3, 0.003), np.full(3, 0.02), np.full(5, 0.01), np.full(15, 0.006)]
    )
    root = np.tril(rng.normal(size=(26, 26))) + np.eye(26)
    root *= (sigma / np.linalg.norm(root, axis=1))[:, None]
    shift = np.zeros((26, 3))
    shift[11:] = np.tile(0.004 * np.eye(3), (5, 1))
    P: Array = root @ root.T + shift @ shift.T
    return P


def filtered(epochs: int = EPOCHS, seed: int = 0, **options: Any) -> Track:
    """One that learns: at epoch k the covariance of all is 1 / (k + 1) of the first."""
    P, n = joint_covariance(), LAYOUT.dim
    shrink = 1 / np.arange(1.0, epochs + 1)
    d = np.random.default_rng(seed).multivariate_normal(np.zeros(n), P)
    x = LAYOUT.retract(true_states(epochs), -np.sqrt(shrink)[:, None] * d)
    own = estimates(LAYOUT, x, shrink[:, None, None] * P)
    return Track(
        **({"name": "ekf", "kind": "filtered", "t": np.arange(float(epochs))} | own | options)
    )


def smoothed(epochs: int = EPOCHS, seed: int = 0, **options: Any) -> Track:
    """What the filter ends with, at all epochs."""
    P = np.tile(joint_covariance() / epochs, (epochs, 1, 1))
    d = np.random.default_rng(seed).multivariate_normal(np.zeros(LAYOUT.dim), P[0])
    x = LAYOUT.retract(true_states(epochs), np.tile(-d, (epochs, 1)))
    options = {"name": "batch", "kind": "smoothed"} | options
    return replace(filtered(epochs, seed), **estimates(LAYOUT, x, P), **options)


def moved(A: Array, b: Array, scale: float = 1.0, epochs: int = EPOCHS) -> Track:
    """A perfect estimate in another frame t: points scale A X + b, and a pose that goes with it."""
    x = true_states(epochs)
    values = dict(LAYOUT.values(x))
    R_ot = values["target_attitude"] @ A.T
    values["target_attitude"] = R_ot
    values["relative_position"] = scale * values["relative_position"] + R_ot @ b
    for i, X in zip(IDS, POINTS, strict=True):
        values[f"point[{i}]"] = np.tile(scale * A @ X + b, (epochs, 1))
    states = np.hstack([values[block.name].reshape(epochs, -1) for block in LAYOUT])
    P = np.tile(joint_covariance(), (epochs, 1, 1))
    return replace(smoothed(epochs), **estimates(LAYOUT, states, P))
