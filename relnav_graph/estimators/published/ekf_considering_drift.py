"""The honest opponent of the filter of Yang et al. 2016: what drifts about a constant bias is no
state that it estimates, and it counts it all the same."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators.ekf import Ekf
from relnav_graph.estimators.published.ekf_without_drift import drifts_of
from relnav_graph.estimators.source import Source
from relnav_graph.linear.assembly import Assembly

__all__ = ["EkfConsideringDrift"]


@dataclass(frozen=True)
class EkfConsideringDrift:
    """Extended Kalman filter that considers the drifts of biases (Schmidt 1966): it does not
    estimate them, and its covariances count them.

    The same as `ekf` with `considered = true` in the priors of the drifts.
    """

    kind: ClassVar[str] = "ekf_considering_drift"

    def run(self, problem: Problem) -> Track:
        """Filter the whole pass. Raises ModelError when the problem has no drifts."""
        return replace(Ekf().run(_considering(problem)), name=self.kind)

    def drive(self, source: Source) -> Track:
        """Filter epochs as they come. Raises ModelError when the problem has no drifts."""
        return replace(Ekf().drive(_ConsideringDrifts(source)), name=self.kind)


def _considering(problem: Problem) -> Problem:
    """The problem with its drifts considered. Raises ModelError when it has none."""
    drifts = drifts_of(problem, EkfConsideringDrift.kind)
    return replace(problem, considered=(*problem.considered, *drifts))


class _ConsideringDrifts:
    """A source for the filter; see `relnav_graph.estimators.source.Source`."""

    def __init__(self, source: Source) -> None:
        self._source, self.count, self.problem = source, source.count, _considering(source.problem)

    def __iter__(self) -> Iterator[Epoch]:
        return iter(self._source)

    def assembly(self) -> Assembly:
        """Of the newest epoch."""
        return self._source.assembly()

    def take(self, x: Array, besides: Mapping[str, Array]) -> None:
        """Tell the source, which has the same states."""
        self._source.take(x, besides)

    def whole(self) -> Problem:
        """All epochs that have come, with drifts considered."""
        return _considering(self._source.whole())
