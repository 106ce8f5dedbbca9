"""Where lines come from: standard input, a file (that may grow), a TCP socket on loopback.

A source is read only when its lines are wanted: what is not read yet waits in the pipe, the
file or the socket, and memory stays flat. None in place of a line tells of a pause: nothing
more has come for the moment.
"""

from __future__ import annotations

import os
import select
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from relnav_graph.errors import InputError
from relnav_graph.streaming.lines import LONGEST

__all__ = ["Source", "open_source"]

_CHUNK = 1 << 16
#: How often a growing file is looked at, s.
_LOOK = 0.01


class Source:
    """Lines of a descriptor.

    settle: after so many s without data, one None. follow: at the end of a file wait for
    more, for `patience` s at most (None: for ever). waiting: wraps each wait, so that a
    signal may end it. where: its name in errors.
    """

    def __init__(
        self,
        descriptor: int,
        settle: float,
        follow: bool = False,
        patience: float | None = None,
        waiting: AbstractContextManager[None] | None = None,
        where: str = "-",
    ) -> None:
        for name, found in ("settle", settle), ("for", patience):
            if found is not None and not found >= 0:
                raise InputError(f"--{name}: found {found} s, expected a length of time")
        self._where = where
        self.settle, self._descriptor, self._follow = settle, descriptor, follow
        self._patience, self._waiting = patience, waiting or nullcontext()

    def skip(self, offset: int) -> None:
        """Go on at an offset, bytes, of a file; a pipe or a socket goes on where it is.

        Raises InputError when the file is shorter than that.
        """
        status = os.fstat(self._descriptor)
        if stat.S_ISREG(status.st_mode):
            if status.st_size < offset - 1:  # the end of a last line may be missing
                raise InputError(
                    f"the input has {status.st_size} bytes, and the journal has read {offset} of it"
                )
            os.lseek(self._descriptor, offset, os.SEEK_SET)

    def _chunk(self, seconds: float | None) -> bytes | None:
        """What there is to read, b"" at the end, None when nothing comes for a while.

        Raises InputError when it cannot be read, as where a sender has broken off.
        """
        try:
            return self._read(seconds)
        except OSError as error:
            raise InputError(
                f"--from {self._where}: cannot be read: {error.strerror or error}"
            ) from error

    def _read(self, seconds: float | None) -> bytes | None:
        with self._waiting:
            if not self._follow:
                ready, _, _ = select.select([self._descriptor], [], [], seconds)
                return os.read(self._descriptor, _CHUNK) if ready else None
            begun = time.monotonic()
            while not (data := os.read(self._descriptor, _CHUNK)):
                waited = time.monotonic() - begun
                if seconds is not None and waited >= seconds:
                    return None
                if self._patience is not None and waited >= self._patience:
                    return b""
                time.sleep(_LOOK)
            return data

    def lines(self) -> Iterator[bytes | None]:
        """Whole lines, without their ends; a last one that has no end counts as one.

        Of a line too long for any purpose only the beginning comes: the format refuses it.
        """
        rest, told = b"", False
        while True:
            data = self._chunk(None if told else self.settle)
            if data is None:
                told = True
                yield None
                continue
            if not data:
                break
            told = False
            *whole, tail = (rest + data).split(b"\n") if len(rest) <= LONGEST else _over(rest, data)
            rest = tail
            yield from whole
        if rest:
            yield rest


def _over(rest: bytes, data: bytes) -> list[bytes]:
    """The same for a line that is too long already: it grows no further."""
    end = data.find(b"\n")
    return [rest] if end < 0 else [rest, *data[end + 1 :].split(b"\n")]


def _listen(port: int, waiting: AbstractContextManager[None] | None) -> tuple[int, int]:
    """Wait for one sender on loopback; its descriptor, and the port."""
    with socket.create_server(("127.0.0.1", port)) as server, waiting or nullcontext():
        connection, _ = server.accept()
    return connection.detach(), port


def open_source(
    where: str,
    settle: float,
    follow: bool = False,
    patience: float | None = None,
    waiting: AbstractContextManager[None] | None = None,
) -> Source:
    """A source by its name: ``-`` for standard input, ``tcp:PORT`` to wait for one sender on
    that port of loopback, else a file.

    Raises InputError when it cannot be opened.
    """
    try:
        if where == "-":
            return Source(0, settle, waiting=waiting, where=where)
        if where.startswith("tcp:"):
            if not where[4:].isdigit() or not 0 < int(where[4:]) < 65536:
                raise InputError(f"--from {where}: expected tcp:PORT, 1 to 65535")
            descriptor, _ = _listen(int(where[4:]), waiting)
            return Source(descriptor, settle, waiting=waiting, where=where)
        descriptor = os.open(Path(where), os.O_RDONLY)
    except OSError as error:
        raise InputError(f"--from {where}: {error.strerror or error}") from error
    return Source(descriptor, settle, follow, patience, waiting, where)
