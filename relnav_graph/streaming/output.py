"""Where the lines out go: each one exactly once, also when the process is killed and resumed."""

from __future__ import annotations

import json
import os
import select
import stat
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from relnav_graph.errors import InputError
from relnav_graph.streaming.writing import dump

__all__ = ["Output"]

#: Bytes at the end of a file in which its last whole line is looked for.
_TAIL = 1 << 22
#: How every line of a stream begins.
_BEGINS = b'{"seq": '


class Output:
    """Standard output, or a file.

    done: number of the last line that is there already, -1 for none. With `goes_on`, lines are
    appended to a file: a partial line that a kill left is cut off, and the last whole one says
    what is done; else the file is emptied. What went into a pipe only the journal knows: see
    `resume`, until which no byte of a file changes. waiting: wraps each wait for room, so that
    a signal may end it. Raises InputError when a file cannot be written or was not written by a
    stream.
    """

    def __init__(
        self,
        path: Path | None,
        goes_on: bool,
        waiting: AbstractContextManager[None] | None = None,
    ) -> None:
        self.path, self.done, self._waiting = path, -1, waiting or nullcontext()
        self._descriptor = 1
        self._kept = 0  # bytes of a file that stay
        self._last: dict[int, dict[str, Any]] = {}  # lines at its end, by number
        if path is not None:
            try:
                self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
            except OSError as error:
                raise InputError(f"-o {path}: cannot be written: {error.strerror}") from error
            try:
                if self._is_file():
                    self._look(goes_on)
            except BaseException:
                os.close(self._descriptor)
                raise

    def _is_file(self) -> bool:
        return self.path is not None and stat.S_ISREG(os.fstat(self._descriptor).st_mode)

    def _look(self, goes_on: bool) -> None:
        """What is there already. Raises InputError when it was not written by a stream."""
        size = os.fstat(self._descriptor).st_size
        start = max(size - _TAIL, 0)
        tail = os.pread(self._descriptor, size - start, start)
        end = tail.rfind(b"\n") + 1
        begins = os.pread(self._descriptor, len(_BEGINS), 0)
        lines = tail[:end].split(b"\n")[bool(start) : -1]
        try:
            last = [json.loads(line) for line in lines if goes_on or line is lines[-1]]
            self._last = {int(line["seq"]): line for line in last}
            for line in last:
                line.pop("latency_ms", None)
            if size and begins != _BEGINS:
                raise ValueError(begins)
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"-o {self.path}: exists, and holds no lines of a stream") from error
        if goes_on:
            self._kept, self.done = start + end, max(self._last, default=-1)

    def resume(self, kept: int, done: int, again: Sequence[Mapping[str, Any]] = ()) -> None:
        """Begin, or resume after a kill.

        kept: number of the last line before those of the replay; done: of the last one that, by
        the journal, has gone out; again: the lines of the replay. Raises InputError when a file
        ends before `kept`, for it then lacks lines that are not made again, or has others.
        """
        if self.path is None:
            self.done = done
            return
        theirs = {line["seq"]: self._last.get(line["seq"]) for line in again}
        other = any(theirs[line["seq"]] not in (None, _as_read(line)) for line in again)
        if self.done < kept or other:
            found = "other lines" if other else f"line {self.done} at its end"
            raise InputError(
                f"-o {self.path}: found {found}, expected line {kept} at least: not the file of"
                " this journal"
            )
        if self._is_file():
            os.ftruncate(self._descriptor, self._kept)
            os.lseek(self._descriptor, 0, os.SEEK_END)

    def write(self, seq: int, text: str) -> None:
        """Write a line, unless it is there already. Raises InputError when it cannot be."""
        if seq <= self.done:
            return
        data = text.encode() + b"\n"
        try:
            while data:
                self._wait()
                data = data[os.write(self._descriptor, data[: select.PIPE_BUF]) :]
        except BrokenPipeError:
            raise
        except OSError as error:
            where = self.path or "standard output"
            raise InputError(f"-o {where}: cannot be written: {error.strerror}") from error
        self.done = seq

    def _wait(self) -> None:
        """Wait until the output takes bytes. Only here may a signal end the stream, so that it
        is known what went out."""
        if not select.select([], [self._descriptor], [], 0)[1]:
            with self._waiting:
                select.select([], [self._descriptor], [])

    def close(self) -> None:
        """Flush a file to the disk and close it."""
        if self.path is not None:
            if self._is_file():
                os.fsync(self._descriptor)
            os.close(self._descriptor)


def _as_read(line: Mapping[str, Any]) -> dict[str, Any]:
    """A line as it was read back, but for its latency, which never comes again."""
    found: dict[str, Any] = json.loads(dump(line))
    return found
