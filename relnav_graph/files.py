"""What is asked of a file or a name before it is used: kind, size, letters."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

from relnav_graph.errors import InputError

__all__ = ["check_memory", "check_name", "printable", "read_file"]

_NAME = re.compile(r"\w[\w.+-]{0,199}")
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def check_memory(what: str, size: float) -> None:
    """Raise InputError when `size` bytes, of `what`, are more than half of this machine's memory.

    To be asked before they are taken: a system that overcommits gives them, and kills later.
    """
    limit = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    if not size <= limit:
        raise InputError(
            f"{what}: would take {size / 2**30:.3g} GiB of memory, expected at most"
            f" {limit / 2**30:.3g} GiB, half of what this machine has"
        )


def check_name(where: str, name: str) -> None:
    """Raise InputError unless `name` can name a table: letters, digits, _, then also dots, + and
    -, so that its file cannot lie outside its folder."""
    if not _NAME.fullmatch(name):
        raise InputError(
            f"{where}: {name!r} cannot name a table: expected letters, digits, '_', and after the"
            " first also '.', '+', '-'"
        )


def printable(text: str) -> str:
    """The text as UTF-8 and HDF5 can hold it: NUL, and bytes of a file name that are no UTF-8, as
    escapes."""
    # Python keeps a byte b that it could not decode as the code point 0xdc00 + b.
    raw = re.sub("[\udc80-\udcff]", lambda m: f"\\x{ord(m[0]) - 0xDC00:02x}", text)
    return raw.encode("utf-8", "backslashreplace").decode().replace("\0", "\\x00")


def read_file(path: str | os.PathLike[str], most: int | None = None) -> bytes:
    """The content of a file.

    most: bytes that it may have; without, what memory allows. Raises InputError when it cannot
    be read, is larger, or is no file but a folder, a pipe or a device, which may have no end.
    """
    path = Path(path)
    try:
        # Opening a pipe would else wait for somebody to write.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
                raise InputError(f"{path}: is {kind}, expected a file")
            if most is not None and status.st_size > most:
                raise InputError(
                    f"{path}: found {status.st_size} bytes, expected at most {most} of such a file"
                )
            check_memory(str(path), status.st_size)
            return stream.read(status.st_size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # NUL in the name
        if isinstance(error, InputError):
            raise
        raise InputError(f"{str(path)!r}: cannot be read: {error}") from error
