"""What a stream did not use: counted by sensor and reason, and noted until the next line out.

However much is refused, and whatever the lines say, memory stays flat.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

__all__ = ["Refusals"]

#: Notes between two lines out, kinds of reason by sensor, and characters of a text.
NOTES, KINDS, LONGEST_TEXT = 1000, 20, 300
UNNAMED, UNKNOWN = "(unnamed)", "(unknown)"


class Refusals:
    """counts: by sensor or input, then by kind of reason, what stands before its colon; notes:
    since the last line out. names: of the sensors and inputs that the scenario has."""

    def __init__(self, names: Collection[str]) -> None:
        self.counts: dict[str, dict[str, int]] = {}
        self.notes: list[dict[str, Any]] = []
        self._names = frozenset(names)

    def add(self, name: str | None, t: float | None, id: int | None, reason: str) -> None:
        """Count a refusal, and note it. name: of a sensor or input, t: its time, s, and id: of
        the observation, None for all of a line."""
        known = UNNAMED if name is None else name if name in self._names else UNKNOWN
        counts = self.counts.setdefault(known, {})
        kind = reason.partition(":")[0][:60]
        kind = kind if kind.isprintable() and (kind in counts or len(counts) < KINDS) else "other"
        counts[kind] = counts.get(kind, 0) + 1
        if len(self.notes) < NOTES:
            said = None if name is None else _short(name)
            self.notes.append({"sensor": said, "t": t, "id": id, "reason": _short(reason)})

    def told(self) -> list[dict[str, Any]]:
        """The notes, which are then forgotten."""
        notes, self.notes = self.notes, []
        return notes


def _short(text: str) -> str:
    return text if len(text) <= LONGEST_TEXT else text[:LONGEST_TEXT] + "..."
