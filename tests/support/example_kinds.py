"""What an example of a model is, and those that follow from another: a mounting estimated, points
unknown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from draws import Draw, draw_block

from relnav_graph.arrays import Array
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.state import Block
from relnav_graph.maths import so3


@dataclass(frozen=True)
class SensorExample:
    """draw: values of the blocks read at which the sensor sees everything; step: size of
    a moderate change of each block; least_large: residual norm that "large" must exceed."""

    model: Any
    draw: Draw
    step: Mapping[str, float] = field(default_factory=dict)
    least_large: float = 0.0


@dataclass(frozen=True)
class DynamicsExample:
    """diffusion: of the advanced blocks' white noise, unit^2/s, (n, n) at given values;
    channels: of each input; companions: processes that advance the blocks that are read;
    flow: False for a process that is no flow in time, such as a copy."""

    model: Any
    diffusion: Callable[..., Array]
    channels: Mapping[str, int] = field(default_factory=dict)
    companions: tuple[Any, ...] = ()
    flow: bool = True


@dataclass(frozen=True)
class DerivedExample:
    """A derived quantity."""

    model: Any


def reads_of(model: Any) -> tuple[Block, ...]:
    """The blocks that one observation of a sensor reads, that of its id last."""
    own = numbered_of(model)
    return model.reads if own is None else (*model.reads, own)


Example = SensorExample | DynamicsExample | DerivedExample


def estimated(example: Example) -> tuple[Example, ...]:
    """A sensor with its mounting in the state, some degrees and centimetres from the nominal one;
    nothing of a model without one."""
    if not hasattr(example.model, "mounting"):
        return ()
    assert isinstance(example, SensorExample)
    model = replace(example.model, mounting="estimated", mount="rig")
    known = len(example.model.reads)

    def draw(rng: np.random.Generator, regime: str) -> tuple[Array, ...]:
        # Of an antenna that is nominally at the origin, no attitude is read where it is known.
        rest = [draw_block(b, rng, regime) for b in model.reads[known:]]
        for k, block in enumerate(model.reads[known:]):
            if block.name.startswith("rig_"):
                small = 0.1 * rng.normal(size=3)
                rest[k] = so3.exp(small) if block.manifold == "SO3" else small
        return *example.draw(rng, regime), *rest

    return (replace(example, model=model, draw=draw),)


def unmapped(example: Example) -> tuple[Example, ...]:
    """A sensor of known points with one of them unknown; nothing of a model without points. Its
    draw gives that point last."""
    if not hasattr(example.model, "points"):
        return ()
    assert isinstance(example, SensorExample)
    model = replace(example.model, points="unknown")

    def draw(rng: np.random.Generator, regime: str) -> tuple[Array, ...]:
        values = example.draw(rng, regime)
        return *values, rng.choice(example.model.points)

    return (replace(example, model=model, draw=draw, step={**example.step, "point": 0.1}),)


def with_variants(examples: tuple[Example, ...]) -> tuple[Example, ...]:
    """Examples of a model, and what follows from them."""
    mounted = *examples, *(more for example in examples for more in estimated(example))
    return *mounted, *(more for example in mounted for more in unmapped(example))
