"""Where an estimator that takes one epoch at a time gets them from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem
from relnav_graph.linear.assembly import Assembly

__all__ = ["Recorded", "Source"]


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

    def take(self, x: Array) -> None:
        """Be told the estimate (size,) at the newest epoch, before the next one comes."""

    def whole(self) -> Problem:
        """The problem with all epochs that have come."""


class Recorded:
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

    def take(self, x: Array) -> None:
        """It is no news to a recording."""

    def whole(self) -> Problem:
        """The problem itself."""
        return self.problem
