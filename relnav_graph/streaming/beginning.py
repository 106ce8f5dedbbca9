"""The first epochs of a stream, held back until they give a first estimate (the prior).

Each epoch is tried until the measurements of one suffice; for those that do not, the error says
what is missing. Where the first leaves several hypotheses (mirror poses), the next few epochs
are held back too, until there are enough to tell them apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.packing import merged, pack, packed_time, time_in, under, unpack
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import UNIT_QUATERNION, Layout
from relnav_graph.errors import InputError
from relnav_graph.io.tabular import from_components
from relnav_graph.linear.assembly import Assembly
from relnav_graph.scenario.first_estimate import FRAMES, decide, hypotheses
from relnav_graph.streaming.lines import LARGEST, Header

__all__ = ["Beginning", "prior_values"]


class Beginning:
    """The state of a stream before its first estimate.

    names: blocks whose prior is to be measured; t: time of the newest epoch taken, s; epochs:
    those held back, the first being the one that suffices. The prior of the other blocks holds
    at the first epoch taken; until one suffices, the processes predict it to each epoch.
    """

    def __init__(self, problem: Problem, names: Sequence[str]) -> None:
        self.problem, self.names = problem, tuple(names)
        self.t: float | None = None
        self.epochs: list[Epoch] = []

    def take(self, epoch: Epoch) -> bool:
        """Take an epoch, with the inputs since the one before; whether `prior` can decide now.

        Raises EstimationError, naming what is missing, when the first estimate cannot be made
        from this epoch.
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
        return replace(self.problem, epochs=tuple(epochs), considered=())

    def _move_to(self, epoch: Epoch) -> None:
        """Predict the prior to an epoch's time."""
        if self.t is not None:
            p, ahead = self.problem, Epoch(epoch.t, (), epoch.inputs)
            assembly = Assembly.ahead(p, ahead, self.t)
            self.problem = replace(p, prior=Prior(*assembly.predict(p.prior.x, p.prior.P)))
        self.t = epoch.t

    def save(self) -> dict[str, Array]:
        """As plain arrays by name: the prior's t (), s, NaN before any epoch, x (size,) and P
        (n, n), and the epochs, see `relnav_graph.core.packing.pack`."""
        prior = self.problem.prior
        t = packed_time(self.t)
        return {"t": t, "x": prior.x, "P": prior.P} | {
            f"epochs.{name}": array for name, array in pack(self.epochs).items()
        }

    def load(self, arrays: Mapping[str, Array]) -> None:
        """Restore what `save` made `arrays` of: t (), x (size,), P (n, n) and epochs."""
        self.t = time_in(arrays["t"])
        self.problem = replace(self.problem, prior=Prior(arrays["x"], arrays["P"]))
        self.epochs = unpack(under(arrays, "epochs."))


def prior_values(header: Header, layout: Layout) -> dict[str, Array]:
    """Values of the blocks whose prior means a header gives, by name.

    (3, 3) for an attitude, else (dim,), SI, in the block's frame. Raises InputError.
    """
    out = {}
    for name, components in header.prior.items():
        if name not in layout:
            raise InputError(f"header: prior.{name}: the state has {[b.name for b in layout]}")
        block, found = layout.block(name), np.array(components)
        length = 4 if block.manifold == "SO3" else block.dim
        where = f"header: prior.{name}: found {components}, expected"
        if found.shape != (length,) or not np.isfinite(found).all():
            raise InputError(f"{where} {length} numbers")
        if not np.abs(found).max() <= LARGEST:
            raise InputError(f"{where} {LARGEST:g} at most")
        if block.manifold == "SO3" and not abs(np.linalg.norm(found) - 1) <= UNIT_QUATERNION:
            raise InputError(f"{where} a unit quaternion, within {UNIT_QUATERNION:g}")
        out[name] = from_components(block, found[None])[0]
    return out
