"""Progress of long work on standard error: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

from relnav_graph.study.conduct import Progress

__all__ = ["study_progress"]

#: Seconds between plain lines.
_INTERVAL = 5.0


class _Lines:
    """A line every `_INTERVAL` seconds, at the end, and for each event with a note."""

    def __init__(self) -> None:
        self._begun = self._last = time.monotonic()
        self._first: int | None = None

    def __call__(self, event: Progress) -> None:
        now = time.monotonic()
        if self._first is None:
            self._first = event.done - 1
        if event.note:
            click.echo(f"run {event.run}: {event.note}", err=True)
        if now - self._last >= _INTERVAL or event.done == event.total:
            self._last = now
            rate = (event.done - self._first) / max(now - self._begun, 1e-9)
            left = (event.total - event.done) / rate
            click.echo(f"{event.done} of {event.total} runs, {left:.0f} s left", err=True)


@contextmanager
def study_progress() -> Iterator[Callable[[Progress], None]]:
    """A listener for the events of a study."""
    if not sys.stderr.isatty():
        yield _Lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = ("runs", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("runs")

        def listen(event: Progress) -> None:
            bar.update(task, completed=event.done, total=event.total)
            if event.note:
                bar.console.print(f"run {event.run}: {event.note}")

        yield listen
