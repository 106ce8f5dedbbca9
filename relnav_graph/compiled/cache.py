"""Where machine code is kept, and how processes take turns to make it.

numba's own disk cache looks only at the file of the cached function: a change in a
callee, or in a constant, that lives in another file goes unseen. Here the cache folder
bears a digest of the sources that the code may depend on: this package's lower floors and
all of the function's own room or package. A change in any of them gives a new folder.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path

import numba

__all__ = ["busy", "cache_folder", "holds_a_lock", "is_empty", "locked"]

_PACKAGE = Path(__file__).parents[1]
#: What compiled code of any room may call or take constants from.
_LOWER_FLOORS = ("compiled", "constants.py", "linear", "maths")


@cache
def _digest(folder: Path) -> str:
    """Digest of the sources that machine code of a file in `folder` may depend on.

    In this package: the lower floors and the whole room that the folder is in, whose files may
    call one another. Elsewhere: the whole package that the folder is in, or only itself for a
    loose file.
    """
    top, loose = folder, not (folder / "__init__.py").is_file()
    while (top.parent / "__init__.py").is_file():
        top = top.parent
    if top == _PACKAGE:
        room = folder.relative_to(top).parts[:1]
        paths = {*(top / room[0]).rglob("*.py")} if room else set()
        for floor in _LOWER_FLOORS:
            paths |= {top / floor} if floor.endswith(".py") else {*(top / floor).glob("*.py")}
    else:
        paths = set(top.glob("*.py") if loose else top.rglob("*.py"))
    sha = hashlib.sha256()
    for path in sorted(paths):
        sha.update(f"{path.parent.name}/{path.name}\0".encode() + path.read_bytes())
    return sha.hexdigest()


def cache_folder(source: str) -> Path:
    """Where the compiled code of the source file `source` is kept.

    ``RELNAV_CACHE_DIR``, else ``XDG_CACHE_HOME``, else ``~/.cache``; below it a folder
    named after everything that the machine code depends on.
    """
    root = os.environ.get("RELNAV_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    base = Path(root) if root else Path.home() / ".cache"
    folders = {_PACKAGE, Path(source).resolve().parent}
    key = "".join(_digest(folder) for folder in sorted(folders))
    key += f"{numba.__version__} {sys.version_info[:2]} {numba.config.BOUNDSCHECK}"
    return base / "relnav_graph" / hashlib.sha256(key.encode()).hexdigest()[:16]


@cache
def is_empty(folder: Path) -> bool:
    """Whether nothing has been compiled into a cache folder; told once to a process."""
    return next(folder.rglob("*.nbi"), None) is None  # numba makes the folder at import


def busy(path: Path) -> bool:
    """Whether another process holds a file's lock."""
    with suppress(OSError), path.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


#: What this process has locked, innermost last: a function, then what it calls, while it is
#: compiled or loaded.
_HELD: list[Path] = []


def holds_a_lock() -> bool:
    """Whether this process has locked a file."""
    return bool(_HELD)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Alone with a file among all processes; without one where it cannot be written."""
    with ExitStack() as stack:
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            fcntl.flock(stack.enter_context(path.open("w")), fcntl.LOCK_EX)
        _HELD.append(path)
        try:
            yield
        finally:
            _HELD.pop()
