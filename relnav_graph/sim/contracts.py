"""Truth and sensors: what a pass would really have been, and what would have been seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics
from relnav_graph.core.measurement import InputSeries
from relnav_graph.core.state import Block, Layout
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
        """True values now by name, (3, 3) or (dim,), SI, in the block's frame: of blocks, and of
        what a controller knows of the chaser itself."""

    def advance(
        self, t: float, command: Array | None, edges: Mapping[str, Array]
    ) -> Mapping[str, Array]:
        """Fly to time t, s, with the command held; None: without any.

        command: (3,), a force, N, or a torque, N m, in the frame that the truth says. edges: by
        input (gyro, accelerometer), where its samples in that time begin and end, (n + 1,), s.
        Result: by input, the true mean over each sample, (n, channels), SI. What is
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
        """The command (3,) from time t, s, on: a force, N, or a torque, N m, as the truth takes it.

        estimate: newest estimates by block name; own: of the chaser itself, exactly known; (3, 3)
        or (dim,) each, SI, in the block's frame.
        """

    def control_errors(self, values: Mapping[str, Array]) -> Mapping[str, Array]:
        """True control errors by name of `controlled`, (N, 3, 3) or (N, dim), SI.

        values: the true values of a pass by name, (N, 3, 3) or (N, dim), SI.
        """


@runtime_checkable
class TakesBesides(Protocol):
    """A controller that takes what an estimator estimates besides the state, where it does: such
    values stand in the `estimate` of its `command`.

    besides: their names.
    """

    besides: ClassVar[tuple[str, ...]]


@runtime_checkable
class KnownInput(Protocol):
    """An input that is the same whatever is flown, and known exactly."""

    def series(self, name: str, t_first: float, t_last: float) -> InputSeries:
        """The input from t_first to t_last, s."""


@runtime_checkable
class PlannedInput(Protocol):
    """An input that tells a plan, which the truth flies with errors of its own."""

    def planned(self, name: str, t_first: float, t_last: float) -> InputSeries:
        """The input from t_first to t_last, s."""

    def flown(self, rng: np.random.Generator) -> Array:
        """Steps of the chaser's velocity, (n, 4): time, s, then the step, m/s, in o."""


@runtime_checkable
class FliesManoeuvres(Protocol):
    """A truth that can be given steps of the chaser's velocity."""

    def flown(self, times: Array, rng: np.random.Generator, steps: Array) -> Truth:
        """As `SimulatedTruth.simulate`, with steps (n, 4), as of `PlannedInput.flown`, in order of
        time; what it says of the time of a step is what was before."""


@runtime_checkable
class Instrument(Protocol):
    """A simulated instrument whose readings are a process's input: a gyro, an accelerometer."""

    def edges(self, t0: float, t1: float) -> Array:
        """Edges (n + 1,), s, of the n adjoining samples from t0 to t1, s."""


@runtime_checkable
class IntervalInstrument(Instrument, Protocol):
    """An instrument whose errors are drawn interval by interval, while the pass is flown."""

    @property
    def measures(self) -> Sequence[str]:
        """Names of the blocks that are its constant bias."""

    def begin(self, rng: np.random.Generator) -> Any:
        """A sampler of the errors: `bias` (3,), what it drifts about that now, `drift` (3,), and
        `take(edges)` for the next samples."""


@runtime_checkable
class SimulatedTruth(Protocol):
    """A truth that gives a whole pass at once, whatever its inputs read."""

    def simulate(self, times: Array, rng: np.random.Generator) -> Truth:
        """True values of blocks at times (N,), s. One with a chaser that turns has
        ``mean_rate(t_start, t_end)`` too: the true mean of w_ci_c, (n, 3), rad/s, over each
        interval, s, for its gyro."""


@runtime_checkable
class DrivenTruth(Protocol):
    """A truth that follows from its inputs, by the estimators' own models."""

    kind: ClassVar[str]

    def follow(
        self,
        layout: Layout,
        processes: Mapping[str, Dynamics],
        inputs: Mapping[str, InputSeries],
        times: Array,
        rng: np.random.Generator,
        statics: Mapping[str, Array],
    ) -> Truth:
        """True values of all blocks of the layout at times (N,), s.

        statics: given values of static blocks, (3, 3) or (dim,), SI, in the block's frame.
        """
