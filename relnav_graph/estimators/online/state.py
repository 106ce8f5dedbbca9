"""The state of an estimator in service, and of each epoch that late data may still change."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.numbered import families, first_seen
from relnav_graph.core.packing import pack
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.estimators import ServesOnline
from relnav_graph.estimators.first_sights import few_sides, turned_between
from relnav_graph.estimators.online.engine import Engine, TakesNumbered
from relnav_graph.estimators.online.monitor import Monitor
from relnav_graph.linear.assembly import Assembly

__all__ = ["Moment", "Setting", "State", "known_in"]


@dataclass(frozen=True, eq=False)
class Setting:
    """A problem without epochs, with the numbered blocks seen so far, and its engine."""

    estimator: ServesOnline
    problem: Problem

    @cached_property
    def engine(self) -> Engine:
        """The estimator's, of this problem."""
        engine: Engine = self.estimator.engine(self.problem)
        return engine

    @cached_property
    def models(self) -> Assembly:
        """Of no epochs, from which those of others are made."""
        p = self.problem
        return Assembly(p.layout, p.processes, p.sensors, [])

    def knowing(self, blocks: Iterable[Block]) -> Setting:
        """The setting with further numbered blocks; itself where it has them all."""
        known = tuple(dict.fromkeys((*self.problem.known, *blocks)))
        if len(known) == len(self.problem.known):
            return self
        return Setting(self.estimator, replace(self.problem, known=known, epochs=()))

    def seeing(self, measurements: Iterable[Measurement]) -> Setting:
        """The setting with the numbered blocks that measurements are of."""
        return self.knowing(first_seen(self.problem.sensors, measurements))

    def taken(self, state: Any, before: Setting) -> Any:
        """The state of another setting's engine as one of this engine's. Raises InputError when
        it takes no numbered blocks that were not known before."""
        if self is before:
            return state
        if not isinstance(self.engine, TakesNumbered):
            new = self.problem.known[len(before.problem.known)].name
            raise InputError(f"this estimator takes no {new}, which was not known beforehand")
        return self.engine.grown(state, before.engine)

    def turned(self, before: Any, after: Any) -> float:
        """By how much the target has turned between two states of engines, rad."""
        moving = self.problem.layout.moving
        if before.t is None:
            return 0.0
        return turned_between(moving, before.x[: moving.size], after.x[: moving.size])

    def initialising(self, turned: float) -> str:
        """Why a map is not to be trusted yet, by how much the target has turned, rad; or ""."""
        doubt = few_sides(turned) if families(self.problem.sensors) else ""
        return doubt and f"initialising: {doubt}"


def _saved_known(problem: Problem) -> Array:
    """The numbered blocks that a problem knows (k, 2): number of the family, and of the block."""
    names = list(families(problem.sensors))
    pairs = [(names.index(block.family), block.number) for block in problem.known]
    return np.array(pairs, dtype=np.float64).reshape(-1, 2)


def known_in(saved: Mapping[str, Array], problem: Problem) -> tuple[Block, ...]:
    """The blocks that `State.saved` has put among arrays as "known"."""
    blocks = list(families(problem.sensors).values())
    pairs = saved.get("known", np.zeros((0, 2)))
    return tuple(blocks[int(family)].numbered(int(number)) for family, number in pairs)


@dataclass(frozen=True, eq=False)
class Moment:
    """Engine, its setting and monitor as they were before an epoch, and the epoch; turned: see
    `State`."""

    state: Any
    setting: Setting
    monitor: Monitor
    epoch: Epoch
    turned: float = 0.0


@dataclass(frozen=True, eq=False)
class State:
    """All that changes, swapped as one. past: epochs that left the window, newest first, as
    nested pairs; None for an engine that can be saved without them. added: what the user has put
    into the graph, each with the time of the newest epoch then; turned: by how much the target has
    turned, rad."""

    engine: Any
    setting: Setting
    monitor: Monitor
    moments: tuple[Moment, ...] = ()
    past: Any = None
    added: tuple[tuple[float, Any], ...] = ()
    turned: float = 0.0

    def saved(self, counts: Mapping[str, Mapping[str, int]]) -> dict[str, Array]:
        """As plain arrays by name, but for `added`; counts: of what was refused, by sensor and
        reason."""
        saved, problem = dict[str, Array](), self.setting.problem
        monitor, epochs = Monitor.of(problem.sensors), [m.epoch for m in self.moments]
        known, turned_by, first = np.zeros((0, 2)), 0.0, self.moments[0] if self.moments else None
        if self.setting.engine.compact and first is not None:
            saved, monitor = first.setting.engine.save(first.state), first.monitor
            known, turned_by = _saved_known(first.setting.problem), first.turned
        past, before = self.past, list[Epoch]()
        while past is not None:
            epoch, past = past
            before.append(epoch)
        epochs = before[::-1] + epochs
        out = {f"engine.{name}": array for name, array in saved.items()}
        out |= {f"epochs.{name}": array for name, array in pack(epochs).items()}
        out["monitor"] = monitor.table
        if families(problem.sensors):
            out |= {"known": known, "turned": np.array(turned_by)}
        for sensor, reasons in counts.items():
            for reason, n in reasons.items():
                out[f"counts.{reason}.{sensor}"] = np.array(float(n))
        return out
