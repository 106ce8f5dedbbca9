"""Truth drawn from the estimator's own process models, and inputs for it.

An inverse crime, and named as such: such a truth can only show that an estimator is
right about its own models. It serves tests, and reproductions of papers that did so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics
from relnav_graph.core.epochs import process_inputs
from relnav_graph.core.measurement import InputSeries
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Truth
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity

__all__ = [
    "OwnModels",
]


@dataclass(frozen=True)
class OwnModels:
    """Truth propagated by the scenario's processes, with their own noise.

    initial: value of a block at the first epoch, SI or with units (an attitude as a
    rotation vector); a block without one starts at zero.
    """

    kind: ClassVar[str] = "own_models"

    initial: Mapping[str, Any] = field(default_factory=dict)

    def follow(
        self,
        layout: Layout,
        processes: Mapping[str, Dynamics],
        inputs: Mapping[str, InputSeries],
        times: Array,
        rng: np.random.Generator,
        statics: Mapping[str, Array] = MappingProxyType({}),
    ) -> Truth:
        """Truth of every block at `times` (N,), s.

        statics: given values of static blocks, (3, 3) or (dim,), SI. Raises InputError on a wrong
        initial value, or on one of a block that is given.
        """
        for name in self.initial:
            if name in statics:
                raise InputError(f"truth.statics.{name}: found a value, and one in truth.initial")
        unknown = set(self.initial) - {b.name for b in layout}
        if unknown:
            raise InputError(f"truth.initial: no block {sorted(unknown)} in the state")
        start = np.zeros(layout.dim)
        for name, value in self.initial.items():
            block = layout.block(name)
            try:
                start[layout.tangent(name)] = Quantity(block.unit, (block.dim,)).parse(value)
            except InputError as error:
                raise InputError(
                    f"truth.initial.{name}: found {value!r}, expected {block.dim} numbers: {error}"
                ) from error
        first = layout.retract(layout.identity, start)
        xs = [layout.pack({**layout.values(first), **statics})]
        for t0, t1 in pairwise(times):
            values = layout.values(xs[-1])
            x_next = dict(values)
            step = np.zeros(layout.dim)
            for process in processes.values():
                u = process_inputs(process, inputs, float(t0), float(t1))
                blocks = process.advances + process.reads
                after, _, Q = process.transition(float(t0), u, *(values[b.name] for b in blocks))
                x_next |= {b.name: v for b, v in zip(process.advances, after, strict=True)}
                noise = np.linalg.cholesky(Q) @ rng.standard_normal(len(Q))
                _, rows = layout.gather(process.advances)
                step[rows] = noise
            xs.append(layout.retract(layout.pack(x_next), step))
        x = np.array(xs)
        return Truth(
            times,
            layout.values(x),
            "own_models: drawn from the estimators' own models (an inverse crime)",
        )
