"""Where an estimator gets epochs from, one at a time, and the loop that takes them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import EstimationError, GeometryError
from relnav_graph.linear.assembly import Assembly

__all__ = ["UNSOLVED", "Driven", "RecordedSource", "Source", "drive"]

#: What may go wrong on the way to an estimate, when the problem is in order.
UNSOLVED = (EstimationError, GeometryError, np.linalg.LinAlgError)


class Source(Protocol):
    """Epochs as they come: of a recording, or of a pass that is flown meanwhile.

    problem: models and prior to begin with; count: how many epochs are to come, at most.
    """

    problem: Problem
    count: int

    def __iter__(self) -> Iterator[Epoch]:
        """Each epoch when it comes."""

    def assembly(self) -> Assembly:
        """Of the newest epoch."""

    def take(self, x: Array, besides: Mapping[str, Array]) -> None:
        """Be told the estimate (size,) at the newest epoch, before the next one comes, and what is
        estimated besides the state, by name, SI."""

    def whole(self) -> Problem:
        """The problem with all epochs that have come."""


class RecordedSource:
    """The epochs of a problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.count = problem, len(problem.epochs)
        self._assembly, self._newest = Assembly.of(problem), -1

    def __iter__(self) -> Iterator[Epoch]:
        for self._newest, epoch in enumerate(self.problem.epochs):  # noqa: B020
            yield epoch

    def assembly(self) -> Assembly:
        """Of the newest epoch."""
        return self._assembly.at(self._newest)

    def take(self, x: Array, besides: Mapping[str, Array]) -> None:
        """It is no news to a recording."""

    def whole(self) -> Problem:
        """The problem itself."""
        return self.problem


class _State(Protocol):
    """Where an estimator stands: the newest estimate x (size,) and its covariance P (n, n).

    One that estimates more, for a controller, has that in `besides`, by name.
    """

    @property
    def x(self) -> Array: ...
    @property
    def P(self) -> Array: ...


S = TypeVar("S", bound=_State)


class _Engine(Protocol[S]):
    """How an estimator gets from one state to the next."""

    def begin(self) -> S: ...
    def advance(self, state: S, epoch: Epoch, assembly: Assembly | None = None) -> S: ...


@dataclass(frozen=True, eq=False)
class Driven:
    """What an estimator said while epochs came.

    problem: all N epochs that came; x (N, size), P (N, n, n): its estimate at each, NaN after it
    stopped; step_s (steps,): how long each step took, s; stopped: why it stopped, or "".
    """

    problem: Problem
    x: Array
    P: Array
    step_s: Array
    stopped: str

    def track(self, kind: str, **found: Any) -> Track:
        """The track of these estimates, with what else is known of it (status, smoothed, ...)."""
        return Track(
            name=kind,
            kind="filtered",
            t=self.problem.times,
            **estimates(self.problem.layout, self.x, self.P),
            runtime_s=float(self.step_s.sum()),
            step_s=self.step_s,
            **found,
        )

    def tracks(self, kind: str, ended: Mapping[str, Any], seconds: float, **found: Any) -> Track:
        """`track`, with the trajectory that it ended with as its `smoothed`.

        ended: what that has of its own, its states and covariances above all; seconds: what it
        took, s.
        """
        track = self.track(kind, **found)
        own = {"kind": "smoothed", **ended}
        took = track.runtime_s + seconds
        smoothed = replace(track, name=f"{kind}_smoothed", runtime_s=took, step_s=None, **own)
        return replace(track, smoothed=smoothed)


def drive(
    source: Source, engine: _Engine[S], notice: Callable[[S], object] | None = None
) -> Driven:
    """Take each epoch of a source when it comes, and tell the source the estimate there.

    notice: is told each new state. An epoch without an estimate (see `UNSOLVED`) ends the drive,
    and the result says why.
    """
    layout, count = source.problem.layout, source.count
    x, P = np.full((count, layout.size), np.nan), np.full((count, layout.dim, layout.dim), np.nan)
    seconds, stopped, state = list[float](), "", engine.begin()
    try:
        for k, epoch in enumerate(source):
            part, begun = source.assembly(), time.perf_counter()
            state = engine.advance(state, epoch, part)
            seconds.append(time.perf_counter() - begun)
            x[k], P[k] = state.x, state.P
            source.take(state.x, getattr(state, "besides", {}))
            if notice is not None:
                notice(state)
    except UNSOLVED as error:
        stopped = str(error)
    problem = source.whole()
    reached = len(problem.epochs)
    return Driven(problem, x[:reached], P[:reached], np.array(seconds), stopped)
