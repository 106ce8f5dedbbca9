"""What a stream knows against its estimates, beside what the estimator says of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from relnav_graph.core.cautions import Caution
from relnav_graph.core.problem import Problem
from relnav_graph.streaming.buffers import Gap

__all__ = ["Doubts"]

#: Name of the caution of a stream that went on after a gap of which nothing was to be said.
BEGUN_AGAIN = "begun again"


class Doubts:
    """A prior that was measured, gaps in the inputs, and the cautions of all lines out.

    patience: how long, s, a gap is remembered; prior: what is said against the prior, or "".
    """

    def __init__(self, problem: Problem, patience: float) -> None:
        self._problem, self._patience = problem, patience
        self.prior = ""
        self._begun_at: float | None = None
        self._of_pass: tuple[Caution, ...] = ()
        self._gap = -np.inf, ""  # end of the last gap, s, and what is said of it
        self._again = ""
        self._looked: tuple[Caution, ...] = ()  # of the pass as it is at the newest estimate

    @property
    def cautions(self) -> tuple[Caution, ...]:
        """Of all lines from now on."""
        again = (Caution(BEGUN_AGAIN, self._again),) if self._again else ()
        return (*self._of_pass, *again, *self._looked)

    def look(self, found: tuple[Caution, ...]) -> bool:
        """Note what a second look at the whole has found; whether that is anything."""
        self._looked = found
        return bool(found)

    def begin(self, t: float | None) -> None:
        """Note the time of a line out, s: the first one tells which cautions the pass has."""
        if self._begun_at is None and t is not None:
            self._begun_at, self._of_pass = t, self._problem.cautions_from(t)

    def bridged(self, gap: Gap, now: float) -> str:
        """Note that a gap is bridged, or that the state at `now`, s, goes on after one that is too
        long for that; the reason for the list of what was refused."""
        what = f"nothing from {gap.start} s to {gap.end} s"
        said, how = f"the inputs had a gap until {gap.end} s", "bridged"
        if gap.long:
            said = how = f"begun again from the estimate of {now} s"
            self._again = (
                f"input {gap.name!r}: {what}, longer than [gaps] {gap.name}.bridge: {said}, with"
                " the last mean held and its spread"
            )
        self._gap = max(self._gap, (gap.end, said))
        return f"gap: {what}; {how}"

    def judge(self, t: float, status: str, message: str) -> tuple[str, str]:
        """Status and message of a new estimate at t, s, with what is known against it."""
        self._looked = ()
        if status != "LOST" and t <= self._gap[0] + self._patience:
            status, message = "DEGRADED", self._gap[1]
        if self.prior:
            status = "LOST" if status == "LOST" else "DEGRADED"
            message = "; ".join(filter(None, [message, self.prior]))
        return status, message

    def save(self) -> dict[str, Any]:
        """As plain values, for `load`."""
        return {
            "prior": self.prior,
            "begun_at": self._begun_at,
            "gap": self._gap,
            "again": self._again,
            "looked": [vars(c) for c in self._looked],
        }

    def load(self, saved: Mapping[str, Any]) -> None:
        """Restore what `save` gave."""
        self.prior = saved["prior"]
        self.begin(saved["begun_at"])
        end, said = saved["gap"]
        self._gap, self._again = (end, said), saved["again"]
        self._looked = tuple(Caution(**c) for c in saved["looked"])
