"""The state of an estimator in service, and of each epoch that late data may still change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from relnav_graph.core.epochs import Epoch
from relnav_graph.estimators.online.monitor import Monitor

__all__ = ["Moment", "State"]


@dataclass(frozen=True, eq=False)
class Moment:
    """Engine and monitor as they were before an epoch, and the epoch."""

    state: Any
    monitor: Monitor
    epoch: Epoch


@dataclass(frozen=True, eq=False)
class State:
    """All that changes, swapped as one. past: epochs that left the window, newest first, as
    nested pairs; None for an engine that can be saved without them. added: what the user has put
    into the graph, each with the time of the newest epoch then."""

    engine: Any
    monitor: Monitor
    moments: tuple[Moment, ...] = ()
    past: Any = None
    added: tuple[tuple[float, Any], ...] = ()
