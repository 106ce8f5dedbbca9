"""The loop of a stream: read a line, journal it, process it, write the lines that result."""

from __future__ import annotations

import signal
import struct
import threading
import time
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any
from zipfile import BadZipFile

from relnav_graph.errors import RelnavError
from relnav_graph.streaming.journal import Journal, JournalError, JournalRecord
from relnav_graph.streaming.lines import Header
from relnav_graph.streaming.output import Output
from relnav_graph.streaming.saved import header_in
from relnav_graph.streaming.session import Session
from relnav_graph.streaming.writing import dump

__all__ = ["Interrupted", "Interrupts", "JournaledSession", "journaled_header", "run"]

#: Seconds that an update may go on after a signal.
_PATIENCE = 0.5
_OFFSET = struct.Struct("<q")  # of the source, bytes, before a snapshot and each line in
_DIGEST = struct.Struct("<qI")  # number and CRC-32 of a line out


class Interrupted(BaseException):
    """Ctrl-C or SIGTERM: `number` is the signal's. No Exception: no line is refused for it."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class Interrupts:
    """Ctrl-C and SIGTERM end the stream between two lines, not within an update: unless that
    takes longer than half a second, when it is broken off. The journal is whole even then: it has
    the line already, and what comes of it is found anew.

    Used as a context manager around a wait, for input or for a reader of the output: there a
    signal raises Interrupted at once.
    """

    def __init__(self) -> None:
        self.caught = 0
        self._waits = False

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Handle the signals; without effect outside the main thread, which alone can."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        numbers = signal.SIGINT, signal.SIGTERM
        before = {n: signal.signal(n, self._caught) for n in numbers}
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._overdue)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            for number, handler in before.items():
                signal.signal(number, handler)

    def _caught(self, number: int, frame: FrameType | None) -> None:
        self.caught = number
        if self._waits:
            raise Interrupted(number)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE)

    def _overdue(self, number: int, frame: FrameType | None) -> None:
        raise Interrupted(self.caught)

    def check(self) -> None:
        """Raise Interrupted if a signal has come."""
        if self.caught:
            raise Interrupted(self.caught)

    def __enter__(self) -> None:
        self._waits = True
        self.check()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._waits = False


def _digest(line: dict[str, Any]) -> bytes:
    """Number and digest of a line out, but for its latency."""
    return _DIGEST.pack(line["seq"], zlib.crc32(dump(line).encode()))


@contextmanager
def _snapshot_of(journal: Journal) -> Iterator[bytes]:
    """The session in a journal's snapshot; what cannot be read of it becomes a JournalError."""
    try:
        yield journal.snapshot[_OFFSET.size :]
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, BadZipFile) as error:
        if isinstance(error, RelnavError):
            raise
        what = f"{type(error).__name__}: {error}"
        raise JournalError(f"{journal.folder}: not a snapshot of this version: {what}") from error


def journaled_header(journal: Journal) -> Header:
    """The header of the stream in a journal that is not new. Raises JournalError when it cannot
    be read."""
    with _snapshot_of(journal) as data:
        return header_in(data)


class JournaledSession:
    """A session, with a journal of what goes in and out, if it has one.

    every: lines between snapshots; offset: bytes of the source whose lines are processed, or
    in the journal; skipped: number of lines that were repeats; kept, done: see `Output.resume`.
    """

    def __init__(self, session: Session, journal: Journal | None, every: int) -> None:
        self.session, self.journal, self.every = session, journal, every
        self.offset = self.skipped = 0
        self.kept = self.done = -1
        self._fresh = 0  # lines since the last snapshot

    def begin(self) -> list[dict[str, Any]]:
        """Resume where the journal ends: load its last snapshot and replay the records after it.

        Returns the lines out of the replay. Raises JournalError when they differ from those
        in the journal: on another platform, say, or with another version of a library.
        """
        if self.journal is None:
            return []
        if not self.journal.snapshot:
            self._snapshot()
            return []
        with _snapshot_of(self.journal) as data:
            self.offset = _OFFSET.unpack_from(self.journal.snapshot)[0]
            self.session.load(data)
        self.kept = self.session.seq - 1
        out = []
        for kind, content in self.journal.records:
            if kind == b"L":
                self.offset = _OFFSET.unpack_from(content)[0]
                out += self._take(content[_OFFSET.size :])
            elif kind == b"F":
                out += self.session.end() if content else self.session.pause()
        self.done = self._verify(out, self.journal.records)
        self._fresh = self.every  # the next line in begins a new segment
        return out

    def _verify(self, out: list[dict[str, Any]], records: list[JournalRecord]) -> int:
        """Compare the lines of the replay with the journal; number of its last line out."""
        found = {line["seq"]: _digest(line) for line in out}
        seq = self.kept
        for content in (content for kind, content in records if kind == b"O"):
            seq = _DIGEST.unpack(content)[0]
            if found.get(seq) != content:
                raise JournalError(
                    f"{self.journal.folder if self.journal else ''}: line {seq} comes out otherwise"
                    " than it did: another platform, or another version of a library?"
                )
        return int(seq)

    def _take(self, raw: bytes) -> list[dict[str, Any]]:
        return self.session.take(self.session.parse(raw))

    def _snapshot(self) -> None:
        assert self.journal is not None
        self.journal.rotate(_OFFSET.pack(self.offset) + self.session.save())
        self._fresh = 0

    def take(self, raw: bytes) -> list[dict[str, Any]]:
        """Journal and process a line; the lines out. A repeat is skipped."""
        line, end = self.session.parse(raw), self.offset + len(raw) + 1
        if not self.session.repeats(line):
            if self.journal is not None:
                if self._fresh >= self.every:
                    self._snapshot()
                self.journal.append(b"L", _OFFSET.pack(end) + raw)
                self._fresh += 1
            self.offset = end
            return self.session.take(line)
        self.offset, self.skipped = end, self.skipped + 1
        return []

    def pause(self) -> list[dict[str, Any]]:
        """The source has come to a pause."""
        if not self.session.busy:
            return []
        if self.journal is not None:
            self.journal.append(b"F")
        return self.session.pause()

    def end(self) -> list[dict[str, Any]]:
        """The source has come to its end."""
        out = self.pause()
        if self.journal is not None:
            self.journal.append(b"F", b"end")
        return out + self.session.end()

    def told(self, line: dict[str, Any]) -> None:
        """Note in the journal that a line went out."""
        if self.journal is not None:
            self.journal.append(b"O", _digest(line))


def _write(
    session: JournaledSession, output: Output, lines: list[dict[str, Any]], begun: float
) -> None:
    for line in lines:
        fresh = line["seq"] > output.done
        latency = round(1e3 * (time.perf_counter() - begun), 3)
        output.write(line["seq"], dump({**line, "latency_ms": latency}))
        if fresh:
            session.told(line)


def run(
    session: JournaledSession, lines: Iterable[bytes | None], output: Output, interrupts: Interrupts
) -> None:
    """Run a stream to its end. Raises Interrupted on a signal; the journal is intact then,
    and after whatever else is raised."""
    begun = time.perf_counter()
    again = session.begin()
    output.resume(session.kept, session.done, again)
    _write(session, output, again, begun)
    for raw in lines:
        interrupts.check()
        begun = time.perf_counter()
        _write(session, output, session.pause() if raw is None else session.take(raw), begun)
    _write(session, output, session.end(), begun)
