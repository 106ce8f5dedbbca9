"""Truth and sensors: what a pass would really have been, and what would have been seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.state import Block
from relnav_graph.core.track import Truth

__all__ = [
    "GROUP",
    "ControlledTruth",
    "Controller",
    "Flight",
]

GROUP = "relnav_graph.truths"


class Flight(Protocol):
    """A pass while it is flown: it stands at one time, and moves on when told to."""

    def values(self) -> Mapping[str, Array]:
        """True values now by name, (3, 3) or (dim,): blocks, and what a controller reads as
        the chaser's own."""

    def advance(
        self, t: float, command: Array | None, edges: Mapping[str, Array]
    ) -> Mapping[str, Array]:
        """Fly to time t, s, with the command held; None: without any.

        edges: of the samples of each input (gyro, accelerometer) in that time, (n + 1,), s.
        Gives the true means of what the input measures between them, (n, channels). What is
        drawn at random on the way must not depend on the command. Raises InputError on an
        input that this truth cannot drive.
        """


@runtime_checkable
class ControlledTruth(Protocol):
    """A truth that can be flown."""

    @property
    def source(self) -> str:
        """What it is, and what it leaves out; see `relnav_graph.core.track.Truth`."""

    def fly(self, t: float, rng: np.random.Generator) -> Flight:
        """A flight that begins at time t, s."""


@runtime_checkable
class Controller(Protocol):
    """A control law, without a memory.

    start: s, when it begins. reads: names of the blocks that it needs of the estimate; own:
    of what it needs of the chaser itself, which is known exactly. controlled: its own errors,
    quantities whose aim is zero (or the identity), for tables.
    """

    kind: ClassVar[str]
    reads: ClassVar[tuple[str, ...]]
    own: ClassVar[tuple[str, ...]]
    controlled: ClassVar[tuple[Block, ...]]

    @property
    def start(self) -> float: ...

    def command(self, t: float, estimate: Mapping[str, Array], own: Mapping[str, Array]) -> Array:
        """The command from time t, s, on, of newest estimates by block name."""

    def control_errors(self, values: Mapping[str, Array]) -> Mapping[str, Array]:
        """True values of `controlled` over a pass of true values (N, ...)."""


@runtime_checkable
class Instrument(Protocol):
    """What an input (gyro, accelerometer) reads of the truth."""

    def edges(self, t0: float, t1: float) -> Array:
        """Where the samples from t0 to t1, s, begin and end, (n + 1,), s."""


@runtime_checkable
class IntervalInstrument(Instrument, Protocol):
    """An instrument whose errors are drawn interval by interval, while the pass is flown."""

    @property
    def measures(self) -> Sequence[str]:
        """Names of the blocks that are its bias."""

    def begin(self, rng: np.random.Generator) -> Any:
        """What draws the errors, with `bias` (3,) and `take(edges)`."""


@runtime_checkable
class SimulatedTruth(Protocol):
    """A truth that gives a whole pass at once."""

    def simulate(self, *arguments: Any) -> Truth:
        """True blocks at given times."""
