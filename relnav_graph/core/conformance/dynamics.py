"""Processes: the intervals at which they are looked at, and what is wrong with F, Q and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.draws import draw_block, scale_of, sizes
from relnav_graph.core.conformance.examples import DynamicsExample
from relnav_graph.core.conformance.faults import Fault, badly_filled, covariance_fault, say_wrong
from relnav_graph.core.conformance.numeric import (
    blocks_of,
    components,
    differences,
    steps_for,
    wrong_entries,
)
from relnav_graph.core.models import Outputs
from relnav_graph.core.state import Layout
from relnav_graph.errors import GeometryError

__all__ = [
    "Interval",
    "input_rows",
    "intervals",
    "manifold_faults",
    "output_faults",
    "transition",
    "transition_faults",
]


@dataclass(frozen=True, eq=False)
class Interval:
    """An interval from t, s, with inputs u (rows, 1 + channels), at the state x of all blocks."""

    t: float
    u: Array
    x: Array


def input_rows(
    example: DynamicsExample, lengths: Array, rng: np.random.Generator, regime: str
) -> Array:
    """u (rows, 1 + channels) with random inputs over lengths (rows,), s; or one row when there are
    none."""
    if not example.channels:
        return np.array([[lengths.sum()]])
    drawn = example.channels.items()
    parts = [scale_of(c, regime) * rng.normal(size=(len(lengths), n)) for c, n in drawn]
    return np.ascontiguousarray(np.hstack([lengths[:, None], *parts]))


def _layout(model: Any) -> Layout:
    return Layout(tuple(model.advances) + tuple(model.reads))


def intervals(
    example: DynamicsExample, regime: str, count: int, rng: np.random.Generator
) -> list[Interval]:
    """Seeded intervals: 0.1 s; 10 s in rows of 0.5 s; 100 s in four uneven rows."""
    layout, found = _layout(example.model), list[Interval]()
    lengths = {"near": np.array([0.1]), "moderate": np.full(20, 0.5)}
    for _ in range(count):
        split = lengths.get(regime, 100 * rng.dirichlet(np.ones(4)))
        x = layout.pack({b.name: draw_block(b, rng, regime) for b in layout})
        u = input_rows(example, split, rng, regime)
        found.append(Interval(float(rng.uniform(0, 5000)), u, x))
    return found


def transition(model: Any, t: float, u: Array, x: Array) -> tuple[Array, Array, Array]:
    """Stored advanced blocks (size,) at the end, F (n, dims) and Q (n, n), from a stored vector."""
    values, F, Q = model.transition(t, u, *_layout(model).values(x).values())
    return np.concatenate([v.ravel() for v in values]), F, Q


def output_faults(example: DynamicsExample, regime: str, given: Sequence[Interval]) -> list[Fault]:
    """As of sensors: where the kernel does not fill x_next, F and Q, or writes past them."""
    model, layout, advanced = example.model, _layout(example.model), Layout(example.model.advances)
    n, found = advanced.dim, list[Fault]()
    stored = [f"{b.name}, stored value {k}" for b in advanced for k in range(b.size)]
    axes = {
        "x_next": (stored,),
        "F": (components(advanced), layout.blocks),
        "Q": (components(advanced), advanced.blocks),
    }
    for i in given:

        def call(fill: float, i: Interval = i) -> tuple[int, Outputs]:
            shapes = {"x_next": (advanced.size,), "F": (n, layout.dim), "Q": (n, n)}
            outputs = Outputs(model.kind, fill, **shapes)
            arguments = model.constants(), i.t, i.u.copy(), i.x.copy()
            return int(model.kernel(*arguments, *outputs.arrays)), outputs

        found += badly_filled(call, regime, axes)
        if found:
            break
    return found


def transition_faults(
    example: DynamicsExample, regime: str, given: Sequence[Interval], most: int = 3
) -> list[Fault]:
    """Where F is not what central differences say, to the advanced blocks and to those that are
    only read, or Q is no covariance."""
    model, layout, advanced = example.model, _layout(example.model), Layout(example.model.advances)
    inputs, outputs = sizes(layout.blocks, regime), sizes(advanced.blocks, regime)
    found = list[Fault]()
    for i in given:
        try:
            x_next, F, Q = transition(model, i.t, i.u, i.x)
        except GeometryError:
            continue
        if F.shape != (advanced.dim, layout.dim):
            text = f"found {F.shape}, expected {(advanced.dim, layout.dim)}"
            return [Fault("shapes", regime, "F", text)]
        if fault := covariance_fault("Q", regime, Q):
            found.append(fault)

        def f(d: Array, i: Interval = i, x_next: Array = x_next) -> Array:
            moved = model.propagate(i.t, i.u, *layout.values(layout.retract(i.x, d)).values())
            return advanced.local(x_next, np.concatenate([v.ravel() for v in moved]))

        numeric = differences(f, steps_for(F, inputs, outputs))
        wrong = wrong_entries(numeric, F, blocks_of(advanced), blocks_of(layout), inputs)
        found += say_wrong("F", regime, wrong, components(advanced), layout.blocks)
        if len(found) >= most:
            break
    return found[:most]


def manifold_faults(example: DynamicsExample, given: Sequence[Interval]) -> list[Fault]:
    """Where an advanced attitude is no rotation any more, within 1e-14."""
    model, layout = example.model, _layout(example.model)
    for i in given:
        try:
            values = model.propagate(i.t, i.u, *layout.values(i.x).values())
        except GeometryError:
            continue
        for block, value in zip(model.advances, values, strict=True):
            if block.manifold == "SO3" and np.abs(value.T @ value - np.eye(3)).max() > 1e-14:
                off = np.abs(value.T @ value - np.eye(3)).max()
                text = f"R^T R - I up to {off:.1e}, expected 1e-14 (so3.project)"
                return [Fault("manifold", "large", block.name, text)]
    return []
