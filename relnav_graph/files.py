"""What is asked of a file or a name before it is used: kind, size, letters."""

from __future__ import annotations

import os
import re
import resource
import stat
from contextlib import suppress
from pathlib import Path

from relnav_graph.errors import InputError

__all__ = ["check_memory", "check_name", "printable", "read_file"]

#: Where Linux says how much memory a container may use.
_CGROUPS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
_NAME = re.compile(r"\w[\w.+-]*")
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def _memory() -> float:
    """Bytes of memory that this process may use."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    limits += [] if soft == resource.RLIM_INFINITY else [soft]
    for path in _CGROUPS:
        with suppress(OSError, ValueError):
            limits.append(int(Path(path).read_text("ascii")))
    return float(min(limits))


def check_memory(what: str, size: float) -> None:
    """Raise InputError when `size` bytes, of `what`, are more than half of this machine's memory.

    To be asked before they are taken: a system that overcommits gives them, and kills later.
    """
    there = _memory()
    if not size <= there / 2:
        raise InputError(
            f"{what}: would take {size / 2**30:.3g} GiB of memory, expected at most"
            f" {there / 2**31:.3g} GiB, half of what there is"
        )


def check_name(what: str, name: str, longest: int = 48) -> None:
    """Raise InputError unless a sensor, an input, a process or a table may bear a name.

    what: of whom, for the message; longest: characters it may have. It is also that of a file,
    which cannot lie outside its folder then, a key in lines of JSON, a label in figures.
    """
    if not (_NAME.fullmatch(name) and len(name) <= longest):
        raise InputError(
            f"found {name[:60]!r} as the name of {what}, expected letters, digits, _ and, not"
            f" first, . + -; {longest} at most"
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
