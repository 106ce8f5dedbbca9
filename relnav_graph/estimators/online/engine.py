"""The contract of estimators that are driven online, and the result of one step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.epochs import Epoch
from relnav_graph.estimators.ekf import FilterSweep
from relnav_graph.estimators.online.monitor import Health
from relnav_graph.linear.assembly import Assembly

__all__ = [
    "Engine",
    "EngineState",
    "Estimate",
    "LooksAgain",
    "Refusal",
    "TakesExtra",
    "TakesNumbered",
]


class EngineState(Protocol):
    """An estimator at the newest epoch that it has taken in: an immutable value.

    t: its time, s, None before the first; x (size,), P (n, n); done: the filter's pass over
    that epoch, which holds weights and innovations.
    """

    @property
    def t(self) -> float | None: ...
    @property
    def x(self) -> Array: ...
    @property
    def P(self) -> Array: ...
    @property
    def done(self) -> FilterSweep | None: ...


class Engine(Protocol):
    """How an estimator gets from one state to the next.

    compact: whether a state can be saved; if not, it can only be made again from all its epochs.
    """

    compact: bool

    def begin(self) -> Any:
        """The state before the first epoch."""

    def advance(self, state: Any, epoch: Epoch, assembly: Assembly | None = None) -> Any:
        """The state with one more epoch. Raises EstimationError or ModelError."""

    def save(self, state: Any) -> dict[str, Array]:
        """A state as plain arrays by name, such as t (), x (size,) and P (n, n)."""

    def load(self, arrays: Mapping[str, Array]) -> Any:
        """The state that `save` made `arrays` of: t (), x (size,), P (n, n) and so on."""


@runtime_checkable
class TakesNumbered(Protocol):
    """What an engine has besides that takes numbered blocks, such as points of a map, as they are
    first seen."""

    def grown(self, state: Any, before: Any) -> Any:
        """The state of an engine of the same kind, `before`, whose problem has fewer of them, with
        the prior of the others."""


@runtime_checkable
class TakesExtra(Protocol):
    """What an engine has besides whose graph takes native factors of the user's."""

    def add(self, state: Any, extra: Any) -> Any:
        """The state with more factors and variables. Raises InputError or EstimationError."""

    def variables(self, state: Any) -> dict[int, tuple[Any, Array]]:
        """Value and covariance (d, d) of each variable of the user's, by its key."""

    def named(self, state: Any) -> int:
        """The largest number of an epoch that a factor of the user's names, -1 for none."""

    def extra(self, arrays: Mapping[str, Array]) -> Any:
        """What the user gave, from the arrays (bytes,) that its `save` made."""


@runtime_checkable
class LooksAgain(Protocol):
    """What an engine has besides that holds the whole pass."""

    def second_look(self, state: Any) -> tuple[Caution, ...]:
        """See `relnav_graph.estimators.second_look`: of all epochs of a state, smoothed. Raises
        EstimationError or GeometryError where there is no smoothed trajectory."""


@dataclass(frozen=True)
class Refusal:
    """Observations of one sensor and time that were not used, or not fully.

    reason: "gated", "impossible" (at the state: behind the camera), "downweighted" or
    "duplicate".
    """

    sensor: str
    t: float
    ids: tuple[int, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class Estimate:
    """The state at the newest epoch: t, s, x (size,), P (n, n).

    status, message: whether to trust it, and why not; refused: observations of the epochs taken
    in for it that were not used, or not fully.
    """

    t: float
    x: Array
    P: Array
    status: Health
    message: str = ""
    refused: tuple[Refusal, ...] = ()
