"""What an example of a model is: an instance, and where it is to be looked at."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.draws import Draw, draw_blocks
from relnav_graph.core.contracts import Derived, Dynamics, Sensor
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.state import Block
from relnav_graph.errors import ModelError, RelnavError

__all__ = [
    "DerivedExample",
    "DynamicsExample",
    "Example",
    "SensorExample",
    "example_of",
    "reads_of",
]


@dataclass(frozen=True)
class SensorExample:
    """A sensor.

    draw: values of the blocks read at which the sensor sees everything, from a generator and a
    regime (near, moderate, large); step: size of a moderate change of each block, by name;
    least_large: residual norm that "large" must exceed.
    """

    model: Any
    draw: Draw
    step: Mapping[str, float] = field(default_factory=dict)
    least_large: float = 0.0


@dataclass(frozen=True)
class DynamicsExample:
    """A process.

    diffusion: of the advanced blocks' white noise, unit^2/s, (n, n) at given values; channels: how
    many each input has; companions: processes that advance the blocks that are read; flow: False
    for a process that is no flow in time, such as a copy.
    """

    model: Any
    diffusion: Callable[..., Array] | None = None
    channels: Mapping[str, int] = field(default_factory=dict)
    companions: tuple[Any, ...] = ()
    flow: bool = True


@dataclass(frozen=True)
class DerivedExample:
    """A derived quantity."""

    model: Any


Example = SensorExample | DynamicsExample | DerivedExample


def reads_of(model: Any) -> tuple[Block, ...]:
    """The blocks that one observation of a sensor reads, that of its id last."""
    own = numbered_of(model)
    return tuple(model.reads) if own is None else (*model.reads, own)


def example_of(model: Any) -> Example:
    """A model as an example, drawn anywhere; an example as it is. Raises ModelError on what has
    the methods of no contract, or raises when it is asked for them."""
    try:
        return _example_of(model)
    except RelnavError:
        raise
    except Exception as error:  # of a stranger's code
        what = f"{type(error).__name__}: {error}".removesuffix(": ")
        raise ModelError(
            f"{type(model).__name__}: raised {what}, expected what a Sensor, a Dynamics or a"
            " Derived has (relnav_graph.core.contracts), such as `reads` or `advances`"
        ) from error


def _example_of(model: Any) -> Example:
    if isinstance(model, SensorExample | DynamicsExample | DerivedExample):
        return model
    if isinstance(model, Sensor):
        return SensorExample(model, draw_blocks(reads_of(model)))
    if isinstance(model, Dynamics):
        return DynamicsExample(model, channels={n: len(c) for n, c in model.inputs.items()})
    if isinstance(model, Derived):
        return DerivedExample(model)
    raise ModelError(
        f"{type(model).__name__}: found no contract that it keeps, expected the methods of a"
        " Sensor, a Dynamics or a Derived (relnav_graph.core.contracts)"
    )
