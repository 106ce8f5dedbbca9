"""How an unknown target turns, from lines of sight alone: where a map without depths begins.

One camera tells only on which line a point is. How far along it, follows from how the target
turns, and how it turns, from where the points are: from a wrong rate Gauss-Newton finds points at
wrong depths, and stays there. But once the rate is supposed, all else is nearly linear: the lines
of sight stand in the target's frame, each point X is where its own lines come closest, and a shift
of the chaser's place and velocity moves them. So the rates that the prior allows are tried, on a
grid, over the first seconds; those with the best cost are where Gauss-Newton begins. Far away a
body that turns one way looks like its mirror image that turns the other way, for a while: several
are followed until the costs decide.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.catalogue import (
    BODY_RATE,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    RELATIVE_VELOCITY,
    RELATIVE_VELOCITY_T,
    TARGET_RATE,
)
from relnav_graph.core.contracts import ReadsNumbered
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Block, Layout
from relnav_graph.estimators.first_sights import measured, sights_in
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.tables import EPOCH, OWN_PLACE

__all__ = ["begun", "motions", "tells_no_depth", "worth_a_search"]

#: Distance of the rates tried: what they turn the target by over the span, one from the next, rad;
#: how far from the prior's mean, in its sigmas; how many are followed.
APART, REACH, FOLLOWED = 0.35, 2.5, 4
#: Each of these is refined so often, by halves; those whose squared error is no larger than the
#: best one's, by this factor, stay.
FINER, LIKELY = 4, 3.0
#: A sigma of the prior's rate turns the target by so much, rad, over the epochs that are searched.
SEARCHED = (0.5, 0.7)
#: Epochs of which the lines of sight are taken.
TAKEN = 12
#: Fewer epochs with sights tell no rate.
FEWEST = 3
#: Error of a line of sight, rad, against which the prior of place and velocity counts; how near to
#: the centre of mass points are, in distances of the chaser, against that.
ANGLE, NEAR = 3e-4, 0.3


def tells_no_depth(problem: Problem) -> bool:
    """Whether all that sees numbered blocks sees no depth, and the state has a place and a rate."""
    seeing = [s for s in problem.sensors.values() if numbered_of(s) is not None]
    blocks = problem.layout.moving.blocks
    return (
        bool(seeing)
        and not any(isinstance(s, ReadsNumbered) and s.sees_depth for s in seeing)
        and (TARGET_RATE in blocks or BODY_RATE in blocks)
        and (RELATIVE_POSITION in blocks or RELATIVE_POSITION_T in blocks)
    )


def _carried(assembly: Assembly, x: Array) -> Array:
    """Trajectories (N, h, size) that begin with states x (h, size), without noise."""
    out = [x]
    for k in range(1, len(assembly.times)):
        part = assembly.at(k)
        tables, count = part.tables, len(x)
        part.tables = tables._replace(
            starts=np.repeat(tables.starts, count), intervals=np.repeat(tables.intervals, count, 0)
        )
        out.append(part.transition(out[-1])[0])
    return np.array(out)


def _lines(assembly: Assembly, x: Array) -> tuple[Indices, Array, Array]:
    """Of all sights of numbered blocks from trajectories x (N, h, size): places (s,) of the blocks
    in the state, origins (h, s, 3), lines (h, s, 3)."""
    layout, tables = assembly.layout, assembly.tables
    places, origins, lines = [np.zeros(0, dtype=np.int64)], [], []
    for which, sensor in enumerate(assembly.sensors.values()):
        if numbered_of(sensor) is None or not isinstance(sensor, ReadsNumbered):
            continue
        seen = np.flatnonzero(assembly.sensor_of == which)
        epochs = np.unique(tables.observations[seen, EPOCH])
        for k in epochs[:: -(-len(epochs) // TAKEN) or 1]:
            own = seen[tables.observations[seen, EPOCH] == k]
            z = measured(assembly, own)
            states = [[layout.value(one, b.name) for b in sensor.reads] for one in x[k]]
            found = [sensor.sights(assembly.ids[own], z, *values) for values in states]
            places.append(tables.observations[own, OWN_PLACE])
            origins.append(np.array([o for o, _ in found]))
            lines.append(np.array([line for _, line in found]))
    return np.concatenate(places), np.concatenate(origins, axis=1), np.concatenate(lines, axis=1)


def _fitted(assembly: Assembly, prior: Prior, x: Array) -> tuple[Array, Array]:
    """States x (h, size) at the first epoch with the best place, velocity and points for their
    rates, and the costs (h,)."""
    layout, count, x = assembly.layout, len(x), x.copy()
    free = [b.name for b in layout.moving if b in (RELATIVE_POSITION, RELATIVE_POSITION_T)]
    free += [b.name for b in layout.moving if b in (RELATIVE_VELOCITY, RELATIVE_VELOCITY_T)]
    stored = np.concatenate([np.arange(layout.size)[layout.stored(n)] for n in free])
    columns = np.concatenate([np.arange(layout.dim)[layout.tangent(n)] for n in free])
    sigma = np.sqrt(np.diag(prior.P)[columns])
    sigma[:3] = sigma[:3].min()
    # The derivatives of the origins, by differences: the motion is nearly linear in these.
    x[:, stored] = prior.x[stored]
    trials = np.repeat(x[None], len(stored) + 1, axis=0)
    for i, place in enumerate(stored):
        trials[i + 1, :, place] += sigma[i]
    places, origins, lines = _lines(assembly, _carried(assembly, trials.reshape(-1, layout.size)))
    shape = (len(stored) + 1, count, len(places), 3)
    origins, line = origins.reshape(shape), lines.reshape(shape)[0]
    told = np.isfinite(origins).all(axis=(0, 3)) & np.isfinite(line).all(axis=2)  # (h, s)
    origins, line = np.where(told[..., None], origins, 1.0), np.where(told[..., None], line, 0.0)
    G = np.moveaxis(origins[1:] - origins[0], 0, -1)  # (h, s, 3, f), for a sigma each
    # One size for all: without depth, the chaser could come as near as it likes.
    depth = np.einsum("hsif,hsi->hf", G[..., :3], line)
    depth /= np.linalg.norm(depth, axis=1, keepdims=True)
    keep = np.eye(3) - depth[:, :, None] * depth[:, None, :]
    G[..., :3] = np.einsum("hsif,hfg->hsig", G[..., :3], keep)
    distance = np.linalg.norm(origins[0], axis=2)
    across = np.eye(3) - line[..., :, None] * line[..., None, :]
    across *= (told / distance**2)[..., None, None]
    blocks, own = np.unique(places, return_inverse=True)

    def summed(values: Array) -> Array:
        out = np.zeros((len(blocks), *values.swapaxes(0, 1).shape[1:]))
        np.add.at(out, own, values.swapaxes(0, 1))
        return out.swapaxes(0, 1)

    near = (ANGLE / (NEAR * distance.mean(axis=1))) ** 2
    A = summed(across) + near[:, None, None, None] * np.eye(3)
    o = np.einsum("hsij,hsj->hsi", across, origins[0])
    B = np.einsum("hsij,hsjf->hsif", across, G)
    b, C = summed(o), summed(B)
    Ab, AC = np.linalg.solve(A, b[..., None])[..., 0], np.linalg.solve(A, C)
    H = np.einsum("hsif,hsig->hfg", G, B) - np.einsum("hpif,hpig->hfg", C, AC)
    H += ANGLE**2 * np.eye(len(stored))
    g = np.einsum("hsif,hsi->hf", G, o) - np.einsum("hpif,hpi->hf", C, Ab)
    y = -np.linalg.solve(H, g[..., None])[..., 0]
    X = Ab + np.einsum("hpif,hf->hpi", AC, y)
    cost = np.einsum("hsi,hsi->h", origins[0], o) - np.einsum("hpi,hpi->h", b, Ab)
    cost += np.einsum("hf,hf->h", g, y)
    y[:, :3] = np.einsum("hfg,hg->hf", keep, y[:, :3])
    x[:, stored] += y * sigma
    x[:, blocks[:, None] + np.arange(3)] = X
    return x, cost


def _rate(layout: Layout) -> Block:
    return next(b for b in layout.moving if b in (TARGET_RATE, BODY_RATE))


def _tried(rate: tuple[Array, Array], span: float) -> Array:
    """Rates (h, 3), rad/s, that a prior of mean (3,) and covariance (3, 3) allows."""
    mean, P = rate
    variances, axes = np.linalg.eigh(P)
    sigma, apart = np.sqrt(variances), APART / span
    steps = [np.arange(-n, n + 1) for n in np.ceil(REACH * sigma / apart - 0.5).astype(int)]
    grid = np.array(list(product(*steps))) * apart
    inside = ((grid / np.maximum(sigma, apart)) ** 2).sum(axis=1) <= REACH**2
    rates: Array = mean + grid[inside] @ axes.T
    return rates


def worth_a_search(assembly: Assembly, prior: Prior) -> bool:
    """Whether the epochs are enough to tell rates that the prior allows from one another, and so
    few that not many need to be tried."""
    if len(np.unique(assembly.tables.observations[sights_in(assembly), EPOCH])) < FEWEST:
        return False
    own = assembly.layout.tangent(_rate(assembly.layout).name)
    sigma = float(np.sqrt(np.linalg.eigvalsh(prior.P[own, own])[-1]))
    return SEARCHED[0] <= sigma * float(assembly.times[-1] - assembly.times[0]) < SEARCHED[1]


def motions(assembly: Assembly, prior: Prior) -> tuple[Array, ...]:
    """States (size,) at the first epoch from which to try Gauss-Newton, the likeliest first."""
    layout, span = assembly.layout, float(assembly.times[-1] - assembly.times[0])
    name = _rate(layout).name
    own, stored = layout.tangent(name), layout.stored(name)
    rates = _tried((prior.x[stored], prior.P[own, own]), span)
    x = np.tile(prior.x, (len(rates), 1))
    x[:, stored] = rates
    x, cost = _fitted(assembly, prior, x)
    chosen = list[int]()
    for i in np.argsort(cost):
        away = np.linalg.norm(rates[chosen] - rates[i], axis=1)
        if len(chosen) < FOLLOWED and (away > 1.8 * APART / span).all():
            chosen.append(int(i))
    x, around = x[chosen], np.array(list(product((-1, 0, 1), repeat=3)))
    for level in range(1, FINER + 1):
        near = np.repeat(x, len(around), axis=0)
        near[:, stored] += np.tile(around, (len(x), 1)) * APART / span / 2**level
        near, costs = _fitted(assembly, prior, near)
        costs = costs.reshape(len(x), -1)
        x = near.reshape(len(x), -1, layout.size)[np.arange(len(x)), costs.argmin(axis=1)]
        cost = costs.min(axis=1)
        x, cost = x[cost <= LIKELY * cost.min()], cost[cost <= LIKELY * cost.min()]
    return tuple(x[np.argsort(cost)])


def begun(assembly: Assembly, prior: Prior, x: Array) -> Array:
    """The trajectory (N, size) of a motion, x (any size,) at the first epoch, with the points where
    its lines of sight put them."""
    start = np.concatenate([x, prior.x[len(x) :]])
    start = _fitted(assembly, prior, start[None])[0]
    return _carried(assembly, start)[:, 0]
