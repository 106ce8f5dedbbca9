"""The clock of a stream, and what a line says against it.

The policy (`relnav_graph.streaming.lines` states it for users): a stream has one clock, that
of its header or of its first line that was taken in. Times may come in any order within the
window, and nothing that is refused moves the clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.errors import InputError

__all__ = ["LATEST", "Clock", "ClockError", "check_reasonable"]

#: Later times, s, cannot be told apart to a microsecond.
LATEST = 1e10
#: Units that people give for seconds.
_SMALLER = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}

#: A pause of up to so many of its steps is still a sensor that runs on.
RUNS_ON = 2.5
#: A pause of more than so many of its steps is a silence, or a clock that has jumped.
SILENT = 5.0


class ClockError(InputError):
    """A time that is not of the stream's clock."""


def check_reasonable(t: float, seen: float = 0.0, gap: float = LATEST) -> None:
    """Raise ClockError on a time, s, too far from zero to be told from those beside it.

    seen: the newest time heard of, s; gap: how far from it a unit that was meant leads.
    """
    if abs(t) > LATEST:
        raise ClockError(
            f"clock: found {t:.6g} s, expected {LATEST:g} s at most"
            + (_hint(t, seen, gap) or "; count from a later zero")
        )


def _hint(t: float, seen: float, gap: float) -> str:
    meant = [unit for unit, scale in _SMALLER.items() if abs(t * scale - seen) <= gap]
    return f"; {meant[0]} given for seconds?" if meant and abs(t) > abs(seen) else ""


@dataclass
class _Own:
    """Times of arrival of one sensor or input: the newest taken in and the step that leads to
    it, s; behind: the newest of those refused since, where its clock has gone back; told: that
    the stream has said so."""

    newest: float = -np.inf
    step: float = 0.0
    behind: float | None = None
    told: bool = False

    def runs_on(self, arrival: float) -> bool:
        """Whether a time, s, follows those that were refused since its clock has gone back."""
        return self.behind is not None and 0 <= arrival - self.behind <= RUNS_ON * self.step


class Clock:
    """Newest time heard of, `heard`, s, and for each sensor and input how its own times run.

    max_gap: further from the newest time, s, is another clock; patience: a pause, s, that
    is worth a word.
    """

    def __init__(self, names: Iterable[str], max_gap: float, patience: float) -> None:
        self.max_gap, self.patience = max_gap, patience
        self.heard = -np.inf
        self._own = {name: _Own() for name in names}

    def check(self, name: str, times: tuple[float, ...], again: bool) -> None:
        """Raise ClockError on times of one line, s, the last of them that of its arrival, which
        cannot be of this clock. again: it repeats what is there. Changes nothing."""
        own, arrival = self._own[name], times[-1]
        if arrival < times[-2] - SAME_TIME:
            raise ClockError(f"clock: it arrives at {arrival} s, before its own time")
        known = self.heard > -np.inf
        for time in times:
            check_reasonable(time, *((self.heard, self.max_gap) if known else (0.0, LATEST)))
        seen = self.heard if known else arrival
        far = max(abs(time - seen) for time in times)
        if far > self.max_gap:
            raise ClockError(
                f"clock: {far:.6g} s from the newest time heard of, {seen:.6g} s; above"
                f" {self.max_gap:g} s it is taken to be of another clock (--max-gap)"
                + _hint(arrival, seen, self.max_gap)
            )
        if not again and own.runs_on(arrival):
            raise ClockError(
                f"clock: its times went back from {own.newest:.6g} s and run on from there, now at"
                f" {arrival:.6g} s; they are refused until they jump forward again"
            )

    def follows(self, line: float) -> bool:
        """Whether a time of arrival, s, is new, and can be of this clock."""
        return self.heard + SAME_TIME < line <= self.heard + self.max_gap

    def take(self, name: str, arrival: float) -> str:
        """Take in that a line of this name has arrived, at a time, s; a message when the time
        has jumped, or ""."""
        own, heard = self._own[name], self.heard
        pause = arrival - own.newest
        jumped = arrival - heard > self.patience and pause > SILENT * own.step > 0
        if SAME_TIME < pause < np.inf:
            own.step = max(pause, 0.9 * own.step) if not jumped else own.step
        own.newest, own.behind, own.told = max(own.newest, arrival), None, False
        self.heard = max(heard, arrival)
        if not jumped:
            return ""
        return (
            f"clock: {name} comes {arrival - heard:.6g} s after the newest time heard of,"
            f" {heard:.6g} s: a silence, or a clock that jumped"
        )

    def refuse(self, name: str, arrival: float, error: InputError) -> str:
        """Note that a line was refused; a message when its clock is wrong, for the first time
        since one was taken in, else ""."""
        own = self._own[name]
        back = self.heard - self.max_gap < arrival < own.newest - SAME_TIME
        if back or own.runs_on(arrival):
            own.behind = arrival
        if own.told or not (back or isinstance(error, ClockError)):
            return ""
        own.told = True
        went = f"clock: from {own.newest:.6g} s back to {arrival:.6g} s: " if back else ""
        return f"{name}: {went}{error}"

    def repeated(self, name: str) -> None:
        """A line repeats one that was taken in: so its clock is the same as then."""
        self._own[name].behind = None

    def save(self) -> dict[str, Any]:
        """As plain values, for `load`."""
        return {"heard": self.heard, "own": {name: asdict(o) for name, o in self._own.items()}}

    def load(self, saved: Mapping[str, Any]) -> None:
        """Restore what `save` gave."""
        self.heard = saved["heard"]
        self._own |= {name: _Own(**own) for name, own in saved["own"].items()}
