"""What is asked of a file or a name before it is used: kind, size, letters."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

from relnav_graph.errors import InputError
from relnav_graph.memory import check_room

__all__ = ["check_name", "file_in", "printable", "read_file"]

#: Of a sensor, an input, a process, a table: also a file, a key in lines of JSON, a label.
_NAME = re.compile(r"\w[\w.+-]*")
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def is_name(name: str, longest: int = 48) -> bool:
    """Whether a sensor, an input, a process or a table may bear a name; see `check_name`."""
    return bool(_NAME.fullmatch(name)) and len(name) <= longest


def check_name(what: str, name: str, longest: int = 48) -> None:
    """Raise InputError unless a sensor, an input, a process or a table may bear a name.

    what: of whom, for the message; longest: characters it may have. It is also that of a file,
    which cannot lie outside its folder then, a key in lines of JSON, a label in figures.
    """
    if not is_name(name, longest):
        raise InputError(
            f"found {name[:60]!r} as the name of {what}, expected letters, digits, _ and, not"
            f" first, . + -; {longest} at most"
        )


def file_in(folder: str | os.PathLike[str], name: str) -> Path:
    """The path of a file in a folder. Raises InputError when its name is a path itself, which
    could lead out of the folder."""
    if not name or name in (".", "..") or "/" in name or "\0" in name or len(name) > 200:
        raise InputError(f"{folder}: {name[:200]!r} cannot name a file in it")
    return Path(folder) / name


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
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # a NUL in the name
        raise InputError(f"{str(path)!r}: cannot be read: {error}") from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
            raise InputError(f"{path}: is {kind}, expected a file")
        if most is not None and status.st_size > most:
            raise InputError(f"{path}: found {status.st_size} bytes, expected at most {most}")
        check_room(f"a file, {path}, whose bytes", status.st_size / 8)
        with open(descriptor, "rb", closefd=False) as stream:
            return stream.read(status.st_size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    finally:
        os.close(descriptor)
