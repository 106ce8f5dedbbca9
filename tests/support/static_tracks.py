"""Tracks with static blocks: made by hand, a moving position with a mounting that is constant; and
passes of the toy ranger, whose drift is constant where no process advances it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from passes import FIX, PRIOR, PROCESSES, RANGER, SENSORS

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
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


def drifting_pass(seed: int = 0, epochs: int = 30, step: float = 1.0) -> tuple[Problem, Truth]:
    """Fixes every third epoch, two ranges at each; all drawn from the models, the constant drift
    from the prior."""
    rng, motion = np.random.default_rng(seed), PROCESSES["motion"]
    r, v, drift = np.split(rng.multivariate_normal(PRIOR.x, PRIOR.P), [3, 6])
    times, states, measurements = step * np.arange(float(epochs)), [], list[Measurement]()
    for k, t in enumerate(times.tolist()):
        if k:
            ahead, _, Q = motion.transition(t, np.array([[step]]), r, v)
            r, v = np.split(rng.multivariate_normal(np.concatenate(ahead), Q), 2)
        states.append((r, v, drift))
        if k % 3 == 0:
            z = rng.multivariate_normal(r, FIX.covariance)
            measurements.append(Measurement("fix", t, z[None], np.zeros(1, dtype=np.int64)))
        ids = RANGER.observables()[:2]
        z = RANGER.predict(ids, r, drift) + RANGER.sigma * rng.normal(size=(2, 1))
        measurements.append(Measurement("ranger", t, z, ids))
    processes = {"motion": motion}
    problem = Problem(processes, SENSORS, PRIOR, make_epochs(processes, measurements, {}, times))
    names = [b.name for b in problem.layout]
    values = {n: np.array(v) for n, v in zip(names, zip(*states, strict=True), strict=True)}
    return problem, Truth(times, values)


#: A scenario of the toy models: the ranger's offset is a constant of the pass.
OFFSET = """
title = "a laser ranger with a constant offset"
seed = 4
estimators = ["iekf", "batch"]

[time]
step = "2 s"
epochs = 30

[processes.motion]
kind = "white_noise_acceleration"
acceleration_density = "1 mm/s^1.5"

[sensors.fix]
kind = "toy_model:PositionFix"
covariance = [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]]
period = "6 s"

[sensors.ranger]
kind = "toy_model:DriftingRange"
points = [[2, 0, 0], [-2, 0, 1], [0, 2, -1]]
sigma = "5 mm"

[prior]
relative_position = { sigma = "1 m" }
relative_velocity = { sigma = "2 cm/s" }
range_drift = { sigma = "20 cm" }

[truth]
kind = "own_models"

[truth.initial]
relative_position = [9, -6, 4]
relative_velocity = [-0.02, 0.01, 0]
range_drift = [0.15]
"""
