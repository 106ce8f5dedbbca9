"""Examples of models that follow from another: a mounting estimated, points unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.draws import draw_block
from relnav_graph.core.conformance.examples import Example, SensorExample
from relnav_graph.maths import so3


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
