"""All checks of one example, in order: later ones lean on earlier ones."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled.contracts import dynamics_address, sensor_address
from relnav_graph.core.conformance import dynamics, sensors
from relnav_graph.core.conformance.draws import REGIMES, draw_block, sizes
from relnav_graph.core.conformance.examples import (
    DerivedExample,
    DynamicsExample,
    Example,
    SensorExample,
)
from relnav_graph.core.conformance.faults import Fault, say_wrong
from relnav_graph.core.conformance.numeric import (
    blocks_of,
    components,
    differences,
    steps_for,
    wrong_entries,
)
from relnav_graph.core.state import Layout
from relnav_graph.errors import InputError, ModelError, RelnavError

__all__ = ["Checked", "check_example", "derived_faults"]


@dataclass(frozen=True)
class Checked:
    """One check: its name, what it looked at, and what it found; nothing where all is well."""

    name: str
    looked: str
    faults: list[Fault]


def _stream(seed: int, what: str) -> np.random.Generator:
    """The generator of one check."""
    key = (zlib.crc32(what.encode()),)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _contract(model: Any, address: Callable[[Any], int] | None) -> list[Fault]:
    """What is wrong with a model before it is called."""
    found = []
    cls = type(model)
    params = getattr(cls, "__dataclass_params__", None)
    if params is None or not params.frozen:
        text = "expected @dataclass(frozen=True): problems are immutable"
        found.append(Fault("contract", "any", cls.__name__, text))
    for field in dataclasses.fields(model) if params is not None else ():
        value = getattr(model, field.name)
        if isinstance(value, np.ndarray) and value.flags.writeable:
            text = "can be overwritten, expected an array that cannot (Quantity, check_fields)"
            found.append(Fault("contract", "any", f"{cls.__name__}.{field.name}", text))
    columns = getattr(model, "columns", ())
    if len(set(columns)) != len(columns):
        found.append(Fault("contract", "any", "columns", f"found {columns}, expected each once"))
    if address is not None:
        try:
            address(model.kernel)
        except RelnavError as error:
            found.append(Fault("contract", "any", "kernel", str(error)))
    return found


def _sensor(example: SensorExample, count: int, seed: int) -> Iterator[Checked]:
    def rng(what: str) -> np.random.Generator:
        return _stream(seed, what)

    yield Checked(
        "contract", type(example.model).__name__, _contract(example.model, sensor_address)
    )
    said, faults = f"{count} states in each of {', '.join(REGIMES)}", list[Fault]()
    for regime in REGIMES:
        faults += [] if faults else sensors.output_faults(example, regime, count, rng(regime))
    yield Checked("outputs", said, faults)
    looked, faults = {}, list[Fault]()
    for regime in REGIMES:
        try:
            looked[regime] = sensors.looks(example, regime, count, rng(regime))
        except (InputError, ModelError) as error:
            faults.append(Fault("look", regime, type(example.model).__name__, str(error)))
    for regime, own in looked.items():
        faults += sensors.jacobian_faults(example, regime, own)
    yield Checked("jacobian", said + ", residuals over 10 sigma in the last", faults)
    moderate = looked.get("moderate", [])
    if moderate:
        yield Checked(
            "noise", f"{count} states", sensors.noise_faults(example, moderate, rng("noise"))
        )


def _dynamics(example: DynamicsExample, count: int, seed: int) -> Iterator[Checked]:
    model = example.model
    yield Checked("contract", type(model).__name__, _contract(model, dynamics_address))
    given = {
        regime: dynamics.intervals(example, regime, count, _stream(seed, regime))
        for regime in REGIMES
    }
    said = f"{count} intervals in each of {', '.join(REGIMES)}"
    faults = list[Fault]()
    for regime, own in given.items():
        faults += dynamics.output_faults(example, regime, own)
    yield Checked("outputs", said, faults)
    faults = []
    for regime, own in given.items():
        faults += dynamics.transition_faults(example, regime, own)
    yield Checked("jacobian and noise", said, faults)
    yield Checked(
        "manifold", f"{count} long intervals", dynamics.manifold_faults(example, given["large"])
    )


def derived_faults(
    example: DerivedExample, regime: str, count: int, rng: np.random.Generator
) -> list[Fault]:
    """Where the Jacobian of a derived quantity is not what central differences say, at `count`
    states of a regime."""
    model, layout, found = example.model, Layout(example.model.reads), list[Fault]()
    inputs = sizes(example.model.reads, regime)
    for _ in range(count):
        x = layout.pack({b.name: draw_block(b, rng, regime) for b in layout})
        value, J = model.value(*layout.values(x).values())
        model.block.pack(value)
        if J.shape != (model.block.dim, layout.dim):
            text = f"found {J.shape}, expected {(model.block.dim, layout.dim)}"
            return [Fault("shapes", regime, "jacobian", text)]

        def f(d: Array, x: Array = x, value: Array = value) -> Array:
            moved = model.value(*layout.values(layout.retract(x, d)).values())[0]
            return np.asarray(model.block.local(value, moved))

        outputs = np.full(model.block.dim, np.abs(J * inputs).max())
        numeric = differences(f, steps_for(J, inputs, outputs))
        wrong = wrong_entries(numeric, J, [slice(None)], blocks_of(layout), inputs)
        found += say_wrong("J", regime, wrong, components([model.block]), layout.blocks)
        if found:
            break
    return found[:3]


def _derived(example: DerivedExample, count: int, seed: int) -> Iterator[Checked]:
    yield Checked("contract", type(example.model).__name__, _contract(example.model, None))
    faults = [
        f
        for regime in REGIMES
        for f in derived_faults(example, regime, count, _stream(seed, regime))
    ]
    yield Checked("jacobian", f"{count} states in each of {', '.join(REGIMES)}", faults)


def check_example(example: Example, count: int = 34, seed: int = 0) -> Iterator[Checked]:
    """The checks of an example, until one on which the others lean has failed.

    count: of states in each regime. Raises RelnavError on what the model raises where it should
    not.
    """
    if isinstance(example, SensorExample):
        checks = _sensor(example, count, seed)
    elif isinstance(example, DynamicsExample):
        checks = _dynamics(example, count, seed)
    else:
        checks = _derived(example, count, seed)
    for checked in checks:
        yield checked
        if checked.faults and checked.name in ("contract", "outputs"):
            return
