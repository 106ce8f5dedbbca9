"""The filter of Yang et al. 2016: biases are constants, and what drifts about them is no state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import DRIFTS
from relnav_graph.core.contracts import Drifts
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Prior, Problem, layout_of
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import ModelError
from relnav_graph.estimators.ekf import Ekf
from relnav_graph.estimators.source import Source
from relnav_graph.linear.assembly import Assembly

__all__ = ["EkfWithoutDrift", "drifts_of"]


@dataclass(frozen=True)
class EkfWithoutDrift:
    """Extended Kalman filter on the problem without its drifts ("an error that cannot be modelled",
    Yang et al. 2016): the relative navigation has nine states, position, velocity and a constant
    bias of the accelerometer.

    It believes that drifts are zero: its track says so, with a covariance of zero.
    """

    kind: ClassVar[str] = "ekf_without_drift"

    def run(self, problem: Problem) -> Track:
        """Filter the whole pass. Raises ModelError when the problem has no drifts."""
        return self._padded(Ekf().run(_without_drifts(problem)), problem.layout)

    def drive(self, source: Source) -> Track:
        """Filter epochs as they come. Raises ModelError when the problem has no drifts."""
        return self._padded(Ekf().drive(_WithoutDrifts(source)), source.problem.layout)

    def _padded(self, track: Track, layout: Layout) -> Track:
        """The track, in all blocks of a layout."""
        own = Layout(track.blocks)
        x = _whole(layout, own, track.states)
        P = np.zeros((len(x), layout.dim, layout.dim))
        _, columns = layout.gather(own)
        P[:, columns[:, None], columns] = track.covariance(*(b.name for b in own))
        return replace(track, name=self.kind, **estimates(layout, x, P))


def drifts_of(problem: Problem, who: str) -> tuple[str, ...]:
    """Names of the drifts in a problem's state, beside their biases. Raises ModelError, for the
    estimator `who`, when there are none."""
    layout = problem.layout
    found = tuple(name for name, bias in DRIFTS.items() if name in layout and bias in layout)
    if not found:
        expected = ", ".join(DRIFTS)
        raise ModelError(f"{who}: found no drift in {problem.layout}, expected one of {expected}")
    return found


def _whole(layout: Layout, own: Layout, x: Array) -> Array:
    """Stored vectors (N, size) of a layout, of those (N, s) of the blocks that it shares with
    another, and zeros."""
    out = np.tile(layout.identity, (len(x), 1))
    out[:, layout.gather(own)[0]] = x
    return out


def _without_drifts(problem: Problem) -> Problem:
    """The problem in which no bias drifts. Raises ModelError when none does as it is."""
    drifts_of(problem, EkfWithoutDrift.kind)
    processes = {name: _constant(p) for name, p in problem.processes.items()}
    processes = {name: p for name, p in processes.items() if p is not None}
    sensors = {name: _constant(s) for name, s in problem.sensors.items()}
    numbered = [b for b in problem.layout.statics if b.number is not None]
    plain = layout_of(processes, sensors)
    stored, tangent = problem.layout.gather([*plain, *numbered])
    prior = Prior(problem.prior.x[stored], problem.prior.P[np.ix_(tangent, tangent)])
    epochs = tuple(epoch.of(processes) for epoch in problem.epochs)
    return replace(problem, processes=processes, sensors=sensors, prior=prior, epochs=epochs)


def _constant(model: Any) -> Any:
    """A model for which biases are constant; None where nothing is left of it."""
    return model.without_drift() if isinstance(model, Drifts) else model


class _WithoutDrifts:
    """A source for the filter; see `relnav_graph.estimators.source.Source`."""

    def __init__(self, source: Source) -> None:
        self._source, self.count = source, source.count
        self.problem = p = _without_drifts(source.problem)
        self._models = Assembly(p.layout, p.processes, p.sensors, [])
        self._newest: tuple[float | None, Epoch | None] = None, None

    def __iter__(self) -> Iterator[Epoch]:
        before: float | None = None
        for epoch in self._source:
            own = epoch.of(self.problem.processes)
            self._newest = before, own
            yield own
            before = own.t

    def assembly(self) -> Assembly:
        """Of the newest epoch."""
        before, epoch = self._newest
        assert epoch is not None
        return self._models.again(epoch, before)

    def take(self, x: Array, besides: Mapping[str, Array]) -> None:
        """Tell the source, whose states have drifts."""
        layout = self._source.problem.layout
        self._source.take(_whole(layout, self.problem.layout, x[None])[0], besides)

    def whole(self) -> Problem:
        """All epochs that have come, without drifts."""
        return _without_drifts(self._source.whole())
