"""Where the lines out go: each one exactly once, also when the process is killed and resumed."""

from __future__ import annotations

import json
import os
import select
import stat
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from relnav_graph.errors import InputError

__all__ = ["Output"]

#: Bytes at the end of a file in which its last whole line is looked for.
_TAIL = 1 << 22


class Output:
    """Standard output, or a file.

    done: number of the last line that is there already, -1 for none. With `goes_on`, lines are
    appended to a file: a partial line that a kill left is cut off, and the last whole one says
    what is done; else the file is emptied. What went into a pipe only the journal knows: see
    `resume`. waiting: wraps each wait for room, so that a signal may end it. Raises InputError
    when a file cannot be written or was not written by a stream.
    """

    def __init__(
        self,
        path: Path | None,
        goes_on: bool,
        waiting: AbstractContextManager[None] | None = None,
    ) -> None:
        self.path, self.done, self._waiting = path, -1, waiting or nullcontext()
        self._descriptor = 1
        if path is not None:
            flags = os.O_RDWR | os.O_CREAT | (0 if goes_on else os.O_TRUNC)
            try:
                self._descriptor = os.open(path, flags, 0o644)
            except OSError as error:
                raise InputError(f"-o {path}: cannot be written: {error.strerror}") from error
            if stat.S_ISREG(os.fstat(self._descriptor).st_mode):
                self.done = self._mend()

    def resume(self, kept: int, done: int) -> None:
        """Resume after a kill. kept: number of the last line before those of the replay; done:
        of the last one that, by the journal, has gone out. Raises InputError when a file ends
        before `kept`: it then lacks lines that are not made again."""
        if self.path is None:
            self.done = done
        elif self.done < kept:
            raise InputError(
                f"-o {self.path}: ends with line {self.done}, expected line {kept} at least: not"
                " the file of this journal"
            )

    def _mend(self) -> int:
        size = os.lseek(self._descriptor, 0, os.SEEK_END)
        start = max(size - _TAIL, 0)
        tail = os.pread(self._descriptor, size - start, start)
        end = tail.rfind(b"\n") + 1
        os.ftruncate(self._descriptor, start + end)
        os.lseek(self._descriptor, 0, os.SEEK_END)
        if not start + end:
            return -1
        last = tail[tail.rfind(b"\n", 0, end - 1) + 1 : end]
        try:
            return int(json.loads(last)["seq"])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"-o {self.path}: exists, and holds no lines of a stream") from error

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
            if stat.S_ISREG(os.fstat(self._descriptor).st_mode):
                os.fsync(self._descriptor)
            os.close(self._descriptor)
