"""How a stream is read, and what a line of it says."""

from __future__ import annotations

from dataclasses import dataclass

from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.streaming.lines import Header, InputSample, LineError, Tick

__all__ = ["PATIENCE", "Options", "Parsed"]

Item = Header | Measurement | InputSample | Tick | LineError
#: Where neither the options nor the problem say how long to wait for inputs, s.
PATIENCE = 30.0


@dataclass(frozen=True)
class Options:
    """How a stream is read.

    max_gap: a line whose time is further than this, s, from the newest time of arrival is
    taken to be of another clock; patience: how long, s of the stream's time, a measurement
    waits for inputs before a gap in them is bridged, None for the length of the estimator's
    window, or `PATIENCE` without one; predict_to_now: add the prediction to the newest time
    of arrival to each line out. Raises InputError on lengths of time that cannot be.
    """

    max_gap: float = 3600.0
    patience: float | None = None
    predict_to_now: bool = False

    def __post_init__(self) -> None:
        for name, found in ("max-gap", self.max_gap), ("patience", self.patience):
            if found is not None and not found > 0:
                raise InputError(f"--{name}: found {found} s, expected a length of time")


@dataclass(frozen=True, eq=False)
class Parsed:
    """A line in: its number, where it has one, and what it says or why it says nothing."""

    n: int | None
    item: Item
