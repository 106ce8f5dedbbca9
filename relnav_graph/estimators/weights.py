"""How much each observation counts: the chi-square gate and robust losses, the same for
filter and smoothers."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import LeftOut
from relnav_graph.estimators.first_sights import has_map, names_of
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.rows import MeasurementRows
from relnav_graph.linear.tables import EPOCH, NUMBERED, OWN_COLUMN, ROWS
from relnav_graph.maths.losses import Loss, root_weights

__all__ = [
    "contested",
    "count_downweighted",
    "count_rejected",
    "left_out",
    "losses_of",
    "lost",
    "residual_weights",
    "retired",
    "reweighted",
    "thresholds",
]

#: Rounds of reweighting, at most, and the change of a weight's root that ends them.
ROUNDS, SETTLED = 50, 1e-3


def thresholds(assembly: Assembly, gates: Mapping[str, float]) -> Array:
    """Squared normalised residual above which an observation is left out, (observations,).

    gates: probability of the chi-square gate by sensor; no gate gives infinity. A filter
    compares the innovation, normalised by H P H^T + R, with it.
    """
    limits = np.full(len(assembly.sensor_names), np.inf)
    for i, name in enumerate(assembly.sensor_names):
        if name in gates:
            limits[i] = chdtri(assembly.tables.sensors[i, ROWS], 1.0 - gates[name])
    by_observation: Array = limits[assembly.sensor_of]
    return by_observation


def losses_of(assembly: Assembly, losses: Mapping[str, Loss]) -> Array:
    """Kind and tuning of each observation's loss, (observations, 2), see `Loss.numbers`."""
    numbers = np.array([[0.0, 1.0]] * len(assembly.sensor_names)).reshape(-1, 2)
    for i, name in enumerate(assembly.sensor_names):
        if name in losses:
            numbers[i] = losses[name].numbers(int(assembly.tables.sensors[i, ROWS]))
    by_observation: Array = numbers[assembly.sensor_of]
    return by_observation


def residual_weights(
    assembly: Assembly,
    rows: MeasurementRows,
    gates: Mapping[str, float],
    losses: Mapping[str, Loss],
) -> Array:
    """Square root of each observation's weight (observations,); 0 for one beyond its gate.

    By its residual at a smoothed estimate, whitened by R alone. rows: the whitened residual
    rows, r (rows,), not weighted yet.
    """
    ends = np.cumsum(assembly.heights)
    total = np.concatenate(([0.0], np.cumsum(rows.r**2)))
    squares = total[ends] - total[ends - assembly.heights]
    weights: Array = root_weights(losses_of(assembly, losses), squares / assembly.heights)
    weights[rows.status != 0] = 0.0
    weights[squares > thresholds(assembly, gates)] = 0.0
    return weights


def count_downweighted(assembly: Assembly, weights: Array) -> dict[str, int]:
    """Observations that a robust loss lets count for less, by sensor.

    weights: (observations,), square roots, as of `residual_weights`.
    """
    return assembly.by_sensor((weights > 0) & (weights < 1))


def lost(assembly: Assembly, weights: Array) -> dict[str, float]:
    """Sum over each sensor's observations of the weight they lack: 1 for a rejected one; below zero
    where a loss of student_t gives more than it takes.

    weights: (observations,), square roots, as of `residual_weights`.
    """
    part = np.bincount(assembly.sensor_of, 1 - weights**2, len(assembly.sensor_names))
    return {name: float(n) for name, n in zip(assembly.sensor_names, part, strict=True)}


def count_rejected(assembly: Assembly, weights: Array) -> dict[str, int]:
    """Observations left out, by sensor.

    weights: (observations,), square roots, as of `residual_weights`.
    """
    return assembly.by_sensor(weights == 0)


def contested(assembly: Assembly, weights: Array) -> NDArray[np.bool_]:
    """The observations (observations,) of numbered blocks of which no more observations are used
    than left out: where such a block is, its first sight may have decided, and been wrong.

    weights: (observations,), square roots, as of `residual_weights`.
    """
    tables = assembly.tables
    own = np.flatnonzero(tables.sensors[assembly.sensor_of, NUMBERED])
    _, block = np.unique(tables.observations[own, OWN_COLUMN], return_inverse=True)
    used = np.bincount(block, weights[own] > 0)
    doubtful = np.zeros(assembly.observations, np.bool_)
    doubtful[own] = (2 * used <= np.bincount(block))[block]
    return doubtful


def retired(assembly: Assembly, weights: Array) -> tuple[str, ...]:
    """Names of the numbered blocks of which no observation is used.

    weights: (observations,), square roots, as of `residual_weights`.
    """
    none = np.flatnonzero(contested(assembly, weights))
    blocks = assembly.tables.observations[:, OWN_COLUMN]
    none = none[~np.isin(blocks[none], blocks[none][weights[none] > 0])]
    return tuple(dict.fromkeys(names_of(assembly, none)))


def left_out(assembly: Assembly, weights: Array) -> dict[str, LeftOut]:
    """The observations left out, of each sensor that has any.

    weights: (observations,), square roots, as of `residual_weights`.
    """
    out, t = np.flatnonzero(weights == 0), assembly.times[assembly.tables.observations[:, EPOCH]]
    found = {n: out[assembly.sensor_of[out] == i] for i, n in enumerate(assembly.sensor_names)}
    return {n: LeftOut(t[own], assembly.ids[own]) for n, own in found.items() if len(own)}


def reweighted(
    problem: Problem,
    assembly: Assembly,
    x: Array,
    weights: Array,
    solve: Callable[[Array, Array], Array],
    rounds: int = ROUNDS,
) -> tuple[Array, Array]:
    """A trajectory x (N, size) and weights (observations,), square roots, that give each other:
    those of the problem's gates and losses.

    x, weights: to begin with; solve: the trajectory of some weights, from one to begin with. A
    loss that redescends, or a gate once something was left out, has many minima: it is preceded by
    Huber's loss, which has one. rounds: at most, of each.
    """
    x = solve(x, weights)
    losses, gates = problem.losses, problem.gates
    doubtful = {name for name, loss in losses.items() if loss.redescends}
    everything = np.ones(assembly.observations)
    if (weights == 0).any() or (
        residual_weights(assembly, assembly.measure(x, everything), gates, losses) == 0
    ).any():
        doubtful |= set(gates)
    convex = {**losses, **dict.fromkeys(doubtful, Loss("huber"))}
    kept = {name: gate for name, gate in gates.items() if name not in doubtful}
    stages = [(kept, convex, 0.05)] if doubtful else []
    if has_map(assembly.layout) and doubtful & set(gates):  # see `gauss_newton.solve_gated`
        last = {**losses, **dict.fromkeys(doubtful & set(gates), Loss("cauchy"))}
        stages.append((kept, last, 0.05))
    for some, how, settled in [*stages, (gates, losses, SETTLED)]:
        for _ in range(rounds):
            new = residual_weights(assembly, assembly.measure(x, everything), some, how)
            if np.abs(new - weights).max(initial=0.0) <= settled:
                break
            weights = new
            x = solve(x, weights)
    return x, weights
