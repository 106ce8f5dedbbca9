"""Absolute times of a scenario: when t = 0 is, for the models that must know."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from datetime import date
from typing import Any

from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.errors import InputError, ModelError
from relnav_graph.maths.instants import EXAMPLE, Instant
from relnav_graph.registry import find_class

__all__ = ["NEEDED", "Clock", "in_pass_time", "pass_clock", "with_data_epoch"]

#: Absolute times closer than that, s, are the same.
_SAME = 1e-3
#: How a date begins, which no quantity does.
_DATE = re.compile(r"\s*\d{4}-\d")
NEEDED = f"needs the absolute time of t = 0: found none, expected [time] epoch = {EXAMPLE}"
_TABLES = ("orbit", "truth", "control", "processes", "sensors", "inputs")


@dataclasses.dataclass(frozen=True)
class Clock:
    """What is known of absolute time; wrong: it is given, and cannot be used, as is reported."""

    time: AbsoluteTime | None = None
    wrong: bool = False

    def given_to(self, group: str, table: dict[str, Any]) -> dict[str, Any]:
        """The table of a model, with the clock where the model has a field of that name."""
        try:
            cls = find_class(group, str(table.get("kind")))
        except ModelError:
            return table  # reported elsewhere
        if self.time is None or not dataclasses.is_dataclass(cls):
            return table
        fields = {f.name for f in dataclasses.fields(cls)}
        return {**table, "clock": self.time} if "clock" in fields else table

    def lacks(self, model: Any) -> bool:
        """Whether a model needs an absolute time that nobody gives."""
        return not self.wrong and bool(getattr(model, "undated", False))


def _table(raw: Mapping[str, Any]) -> Mapping[str, Any]:
    found = raw.get("time")
    return found if isinstance(found, Mapping) else {}


def with_data_epoch(
    raw: Mapping[str, Any], settings: Mapping[str, Any] | None, problems: list[tuple[str, str]]
) -> dict[str, Any]:
    """The tables, with the absolute time that recorded data bring, where they bring one, as their
    [time] epoch: that of a stamp of 0. A scenario may say it, too, if it says the same."""
    brought, own = _table(settings or {}).get("epoch"), _table(raw)
    if brought is None:
        return dict(raw)
    try:
        of_data = Instant.parse(str(brought)).after(float(own.get("origin", 0.0)))
        told = Instant.parse(str(own["epoch"])) if "epoch" in own else of_data
    except (InputError, TypeError, ValueError):
        return dict(raw)  # of the scenario's own fields, which are checked
    if abs(told.since(of_data)) > _SAME:
        problems.append(
            ("time.epoch", f"found {own['epoch']}, but the data say {of_data} of t = 0: leave one")
        )
    return {**raw, "time": {"epoch": str(of_data), **own}}


def pass_clock(raw: Mapping[str, Any], problems: list[tuple[str, str]]) -> Clock:
    """The clock that [time] tells."""
    time = _table(raw)
    epoch, orientation = time.get("epoch"), time.get("orientation") or ""
    if epoch is None:
        return Clock()
    try:
        Instant.parse(str(epoch))
    except InputError:
        return Clock(wrong=True)  # reported as a field of [time]
    try:
        return Clock(AbsoluteTime(str(epoch), str(orientation)))
    except InputError as error:
        problems.append(("time.orientation", str(error)))
        return Clock(wrong=True)


def in_pass_time(
    raw: Mapping[str, Any], clock: Clock, waiting: bool, problems: list[tuple[str, str]]
) -> dict[str, Any]:
    """The tables of models, with absolute times that stand as `epoch` in them as seconds since
    t = 0. waiting: data that may bring the absolute time of that are not read yet."""

    def seconds(path: str, text: str) -> float:
        try:
            when = Instant.parse(text)
        except InputError as error:
            problems.append((path, str(error)))
            return 0.0
        if clock.time is not None:
            return when.since(clock.time.begin)
        if not (waiting or clock.wrong):
            problems.append((path, f"found {text!r}, which {NEEDED}"))
        return 0.0

    def changed(path: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {k: changed(f"{path}.{k}", v) for k, v in value.items()}
        text = value.isoformat() if isinstance(value, date) else value
        dated = path.endswith(".epoch") and isinstance(text, str) and _DATE.match(text)
        return seconds(path, text) if dated else value

    return {k: changed(k, v) if k in _TABLES else v for k, v in raw.items()}
