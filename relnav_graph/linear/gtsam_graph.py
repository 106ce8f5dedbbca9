"""A problem as GTSAM's own kind of graph: our factors over one typed variable for each block and
epoch (a `Rot3` for an attitude, else a vector), static blocks once.

Variables of your own take keys that none of these have: any symbol with a capital letter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import gtsam
import numpy as np
from scipy.sparse.csgraph import connected_components

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import InputError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.gtsam_factors import (
    Look,
    Way,
    insert_block,
    interval_factor,
    observation_factor,
    prior_factor,
    read_block,
)
from relnav_graph.linear.gtsam_marginals import marginals
from relnav_graph.maths.losses import Loss

__all__ = ["Graph", "Keys", "PassFactors", "graph_of", "to_track"]

#: The first byte of a key: of the first moving block, the next ones follow; and of all static ones.
_FIRST, _STATIC, _INDEX = ord("a"), ord("_"), 56
#: Of GTSAM's values, by type: a vector first, which it takes nothing else for.
_READERS = ("atVector", *(name for name in dir(gtsam.Values) if name.startswith("at")))


class Keys:
    """GTSAM's key of each block at each epoch, and back.

    ``keys["chaser_attitude", 3]`` is that of the epoch with number 3, from 0 on;
    ``keys["inertia", None]``, or with any epoch, that of a static block, which has one only.
    In GTSAM's words moving blocks are a0, a1, ..., b0, ... in the order of the layout, static ones
    _0, _1, ...
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._moving = {b.name: i for i, b in enumerate(layout.moving)}
        self._static = {b.name: i for i, b in enumerate(layout.statics)}
        if _FIRST + len(self._moving) > 256:
            raise InputError(f"keys: found {len(self._moving)} moving blocks, expected fewer")

    def __getitem__(self, at: tuple[str, int | None]) -> int:
        """The key of (name of the block, number of the epoch). Raises InputError on a block that is
        not there, or no epoch."""
        name, epoch = at
        if name in self._static:
            return (_STATIC << _INDEX) | self._static[name]
        if name not in self._moving:
            raise InputError(f"keys: found block {name!r}, expected one of {self.layout}")
        if not isinstance(epoch, (int, np.integer)) or epoch < 0:
            raise InputError(f"keys: found epoch {epoch!r} of {name}, expected its number, from 0")
        return ((_FIRST + self._moving[name]) << _INDEX) | int(epoch)

    def __contains__(self, key: int) -> bool:
        """Whether a key is one of these, of whatever epoch."""
        letter, index = key >> _INDEX, key & ((1 << _INDEX) - 1)
        if letter == _STATIC:
            return index < len(self._static)
        return _FIRST <= letter < _FIRST + len(self._moving)

    def back(self, key: int) -> tuple[str, int | None]:
        """(name of the block, number of the epoch, None for a static one). Raises InputError on a
        key of something else."""
        if key not in self:
            shown = gtsam.DefaultKeyFormatter(key)
            raise InputError(f"keys: found {shown}, which is of no block of {self.layout}")
        letter, index = key >> _INDEX, key & ((1 << _INDEX) - 1)
        if letter == _STATIC:
            return self.layout.statics.blocks[index].name, None
        return self.layout.moving.blocks[letter - _FIRST].name, index

    def at(self, epoch: int, layout: Layout) -> list[int]:
        """Of all blocks of a layout, at an epoch."""
        return [self[block.name, epoch] for block in layout]

    def insert(self, values: gtsam.Values, epoch: int, layout: Layout, x: Array) -> None:
        """Insert the blocks of a layout at an epoch; x (size,): theirs."""
        for block in layout:
            insert_block(values, self[block.name, epoch], block, layout.value(x, block.name))

    def values(self, x: Array) -> gtsam.Values:
        """A trajectory x (N, size), whose last row has the static blocks."""
        values = gtsam.Values()
        moving = self.layout.moving
        for k in range(len(x)):
            self.insert(values, k, moving, x[k, : moving.size])
        self.insert(values, 0, self.layout.statics, x[-1, moving.size :])
        return values

    def read(self, values: gtsam.Values, epoch: int) -> Array:
        """The state (size,) of all blocks at an epoch."""
        found = [read_block(values, self[b.name, epoch], b).ravel() for b in self.layout]
        return np.concatenate(found)

    def in_time(self, values: gtsam.Values) -> gtsam.Ordering:
        """All variables in order of time, then those of no epoch."""
        ordering = gtsam.Ordering()
        moving = range(_FIRST, _FIRST + len(self._moving))
        every = list(values.keys())
        for key in sorted(every, key=lambda k: (k >> _INDEX not in moving, k % (1 << _INDEX), k)):
            ordering.push_back(key)
        return ordering

    def trajectory(self, values: gtsam.Values, count: int) -> Array:
        """The inverse of :meth:`values`: x (count, size)."""
        return np.array([self.read(values, k) for k in range(count)])


@dataclass(frozen=True, eq=False)
class PassFactors:
    """Makes the factors of a problem's prior, epochs and intervals."""

    problem: Problem
    keys: Keys
    _looks: dict[tuple[str, int | None], tuple[Look, Assembly]] = field(default_factory=dict)
    _ways: dict[str, tuple[Way, Assembly]] = field(default_factory=dict)
    _made: WeakKeyDictionary[Measurement | Epoch, dict[Any, Assembly]] = field(
        default_factory=WeakKeyDictionary
    )
    _split: WeakKeyDictionary[Measurement, list[Measurement]] = field(
        default_factory=WeakKeyDictionary
    )

    def __post_init__(self) -> None:
        self.problem.expect_none_considered("a GTSAM graph")
        for name, process in self.problem.processes.items():
            way = Way(process)
            self._ways[name] = way, Assembly(way.layout, {name: process}, {}, [])

    def _look(self, name: str, number: int | None) -> tuple[Look, Assembly]:
        """Of a sensor, and of the numbered block that its observations read, if any."""
        if (name, number) not in self._looks:
            sensor = self.problem.sensors[name]
            block = numbered_of(sensor)
            own = None if block is None or number is None else block.numbered(number)
            look = Look(sensor, own)
            self._looks[name, number] = look, Assembly(look.layout, {}, {name: sensor}, [])
        return self._looks[name, number]

    def _each(self, m: Measurement) -> list[Measurement]:
        """The observations of a measurement, each by itself; made once."""
        if m not in self._split:
            self._split[m] = [m.only([i]) for i in range(len(m.z))]
        return self._split[m]

    def _assembled(
        self, what: Measurement | Epoch, name: str, models: Assembly, t: float, t_before: Any = None
    ) -> Assembly:
        """One measurement or interval of one model, alone; made once for each."""
        made = self._made.setdefault(what, {})
        if (name, t_before) not in made:
            inputs = what.inputs if isinstance(what, Epoch) else {}
            seen = () if isinstance(what, Epoch) else (what,)
            made[name, t_before] = models.again(Epoch(t, seen, inputs), t_before)
        return made[name, t_before]

    def prior(self) -> list[gtsam.CustomFactor]:
        """Of the first epoch: one factor for each set of blocks that the prior correlates."""
        layout, prior = self.problem.layout, self.problem.prior
        parts = [layout.tangent(b.name) for b in layout]
        tied = [[bool(prior.P[a, b].any()) for b in parts] for a in parts]
        count, group = connected_components(np.array(tied), directed=False)
        out = []
        for i in range(count):
            own = Layout(b for b, g in zip(layout, group, strict=True) if g == i)
            stored, tangent = layout.gather(own)
            part = Prior(prior.x[stored], prior.P[np.ix_(tangent, tangent)])
            out.append(prior_factor(own, part, self.keys.at(0, own)))
        return out

    def measurements(
        self, k: int, epoch: Epoch, weight: Array, losses: Mapping[str, Loss]
    ) -> list[gtsam.CustomFactor]:
        """Of epoch k: one for each measurement, or for each observation of a sensor that has a loss
        or reads numbered blocks.

        weight (observations,): square roots of their weights; 0 leaves one out.
        """
        out, first = [], 0
        for m in epoch.measurements:
            w, loss = weight[first : first + len(m.z)], losses.get(m.sensor)
            first += len(m.z)
            numbered = numbered_of(self.problem.sensors[m.sensor]) is not None
            if loss is None and not numbered:
                each = [(m, w)]
            else:
                parts = self._each(m)
                each = [(parts[i], w[[i]]) for i in np.flatnonzero(w)]
            for part, own in each:
                look, models = self._look(m.sensor, int(part.ids[0]) if numbered else None)
                one = self._assembled(part, m.sensor, models, epoch.t)
                keys = self.keys.at(k, look.layout)
                out.append(observation_factor(look, one, keys, own, loss))
        return out

    def interval(
        self, k: int, epoch: Epoch, t_before: float, whiten: Array
    ) -> list[gtsam.CustomFactor]:
        """Of the interval from t_before, s, to epoch k; whiten (n, n): of its process noise."""
        out, layout = [], self.problem.layout
        for name, (way, models) in self._ways.items():
            keys = self.keys.at(k - 1, way.layout) + self.keys.at(k, way.end)
            one = self._assembled(epoch, name, models, epoch.t, t_before)
            _, own = layout.gather(way.end)
            out.append(interval_factor(way, one, keys, whiten[np.ix_(own, own)]))
        return out

    def whole(
        self,
        epochs: Sequence[Epoch],
        assembly: Assembly,
        weights: Array,
        whiten: Array,
        losses: Mapping[str, Loss],
    ) -> gtsam.NonlinearFactorGraph:
        """All of a pass, in order of time; assembly: of its epochs; weights (observations,),
        whiten (N - 1, n, n): as above."""
        out = gtsam.NonlinearFactorGraph()
        for factor in self.prior():
            out.push_back(factor)
        for k, epoch in enumerate(epochs):
            own = slice(*assembly.epoch_offsets[k : k + 2])
            found = self.measurements(k, epoch, weights[own], losses)
            if k:
                found += self.interval(k, epoch, epochs[k - 1].t, whiten[k - 1])
            for factor in found:
                out.push_back(factor)
        return out


@dataclass(frozen=True, eq=False)
class Graph:
    """A problem as GTSAM's own kind of graph: factors, where to begin, and the names of the keys.

    The sum of the factors' errors is the cost that `batch` minimises. To it add what you like.
    """

    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    keys: Keys


def graph_of(problem: Problem, x: Array, weights: Array | None = None) -> Graph:
    """The graph of a problem at a trajectory x (N, size), where process noise is evaluated.

    weights (observations,): square roots of the weights of the observations, held fixed, in the
    order of `Assembly.of(problem)`; without, each counts fully, or as its sensor's robust loss
    has it. One that is impossible at x is left out. Raises InputError on a trajectory of another
    size; ModelError or GeometryError when a model cannot be evaluated.
    """
    assembly, count = Assembly.of(problem), len(problem.epochs)
    if x.shape != (count, problem.layout.size):
        raise InputError(
            f"trajectory: found {x.shape}, expected ({count}, {problem.layout.size}): a row for"
            " each epoch, of all blocks, the static ones last"
        )
    losses = problem.losses if weights is None else {}
    weights = np.ones(assembly.observations) if weights is None else weights
    if weights.shape != (assembly.observations,):
        raise InputError(f"weights: found {weights.shape}, expected ({assembly.observations},)")
    weights = np.where(assembly.measure(x, weights).status == 0, weights, 0.0)
    whiten, keys = assembly.whitening(x[:-1]), Keys(problem.layout)
    factors = PassFactors(problem, keys).whole(problem.epochs, assembly, weights, whiten, losses)
    return Graph(factors, keys.values(x), keys)


def to_track(problem: Problem, graph: Graph, values: gtsam.Values) -> Track:
    """The smoothed track that GTSAM's values are, with the covariances of the graph there.

    values: of all variables of the graph, linearised anew here; those that are not of the problem
    are in `Track.extra`. Covariances by QR, in order of time: any ratio of noises will do. The
    status is "ok" whatever the fit: to judge that is an estimator's part. Raises EstimationError
    when the graph does not determine all variables.
    """
    keys, layout, count = graph.keys, problem.layout, len(problem.epochs)
    own = [key for key in list(values.keys()) if key not in keys]
    groups = [keys.at(k, layout.moving) for k in range(count)]
    border = [*keys.at(0, layout.statics), *own]
    found = marginals(graph.factors.linearize(values), groups, border)
    n, m = layout.moving.dim, layout.statics.dim
    P = np.empty((count, n + m, n + m))
    P[:, :n, :n], P[:, :n, n:] = found.P, found.cross[:, :, :m]
    P[:, n:, :n], P[:, n:, n:] = P[:, :n, n:].transpose(0, 2, 1), found.border[:m, :m]
    extra, first = {}, m
    for key in own:
        last = first + found.dims[key]
        extra[key] = (read_any(values, key), found.border[first:last, first:last])
        first = last
    x = keys.trajectory(values, count)
    return Track("gtsam", "smoothed", t=problem.times, extra=extra, **estimates(layout, x, P))


def read_any(values: gtsam.Values, key: int) -> Any:
    """The value of a variable of whatever type: an array of a vector, else GTSAM's object."""
    for name in _READERS:
        try:
            return getattr(values, name)(key)
        except RuntimeError:
            continue
    raise InputError(f"found {gtsam.DefaultKeyFormatter(key)} of a type that cannot be read")
