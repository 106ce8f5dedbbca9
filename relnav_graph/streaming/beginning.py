"""The first epochs of a stream, held back until they give a first estimate (the prior).

Each epoch is tried until one suffices; it says what is missing in those that do not. Where one
leaves several hypotheses, the next few are held back, until they tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.packing import merged, pack, under, unpack
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.linear.assembly import Assembly
from relnav_graph.scenario.first_estimate import FRAMES, decide, hypotheses

__all__ = ["Beginning"]


class Beginning:
    """What is there before the first estimate.

    names: blocks to be measured; t: time of the newest epoch taken, s; epochs: those held
    back, from the first that suffices on. The prior of the other blocks holds at the first
    epoch taken, and moves on with the processes until one suffices.
    """

    def __init__(self, problem: Problem, names: Sequence[str]) -> None:
        self.problem, self.names = problem, tuple(names)
        self.t: float | None = None
        self.epochs: list[Epoch] = []

    def take(self, epoch: Epoch) -> bool:
        """Take an epoch, with the inputs since the one before; whether there is enough now.

        Raises EstimationError, naming what is missing, when it cannot be the first.
        """
        if self.epochs and epoch.t <= self.epochs[-1].t + self.problem.merge:
            own = self.problem.processes, self.problem.merge
            for m in epoch.measurements:
                self.epochs = merged(self.epochs, m, *own)
        elif self.epochs:
            self.epochs.append(epoch)
            self.t = epoch.t
        else:
            self._move_to(epoch)
            first = replace(epoch, inputs={})
            single = len(hypotheses(self._with([first]), self.names)) == 1
            self.epochs = [first]
            return single
        return len(self.epochs) >= FRAMES

    def prior(self) -> tuple[Prior, str]:
        """The prior at the first of the epochs held back; and a warning about it, or ""."""
        return decide(self._with(self.epochs), self.names)

    def _with(self, epochs: Sequence[Epoch]) -> Problem:
        return replace(self.problem, epochs=tuple(epochs))

    def _move_to(self, epoch: Epoch) -> None:
        """Carry the prior to an epoch's time."""
        if self.t is not None:
            p, ahead = self.problem, Epoch(epoch.t, (), epoch.inputs)
            assembly = Assembly(p.layout, p.processes, p.sensors, [ahead], self.t)
            self.problem = replace(p, prior=Prior(*assembly.predict(p.prior.x, p.prior.P)))
        self.t = epoch.t

    def save(self) -> dict[str, Array]:
        """As plain arrays by name: the prior's t (), s, NaN before any epoch, x (size,) and P
        (n, n), and the epochs, see `relnav_graph.core.packing.pack`."""
        prior = self.problem.prior
        t = np.array(np.nan if self.t is None else self.t)
        return {"t": t, "x": prior.x, "P": prior.P} | {
            f"epochs.{name}": array for name, array in pack(self.epochs).items()
        }

    def load(self, arrays: Mapping[str, Array]) -> None:
        """Restore what `save` made `arrays` of: t (), x (size,), P (n, n) and epochs."""
        t = float(arrays["t"])
        self.t = None if np.isnan(t) else t
        self.problem = replace(self.problem, prior=Prior(arrays["x"], arrays["P"]))
        self.epochs = unpack(under(arrays, "epochs."))
