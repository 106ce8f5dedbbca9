"""Where machine code is kept, and how processes take turns to make it.

numba's own disk cache looks only at the file of the cached function: a change in a
callee, or in a constant, that lives in another file goes unseen. Here the cache folder
bears a digest of the sources that the code may depend on: this package's lower floors and
all of the function's own room or package. A change in any of them gives a new folder.

Each file bears a digest of its content: one that was emptied, cut or changed (a power loss, a
full disk, a failing one) is as good as absent, so that the function is compiled again and the
file is replaced.
"""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
import pickle
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    UserProvidedCacheLocator,
)

__all__ = [
    "busy",
    "cache_folder",
    "disk_cache",
    "holds_a_lock",
    "is_empty",
    "locked",
    "why_not_kept",
]

_LOG = logging.getLogger(__name__)
_PACKAGE = Path(__file__).parents[1]
#: What compiled code of any room may call or take constants from.
_LOWER_FLOORS = ("compiled", "constants.py", "linear", "maths")


def _top(folder: Path) -> Path:
    """The folder of the whole package that a folder is in."""
    while (folder.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder


@cache
def _digest(folder: Path) -> str:
    """Digest of the sources that machine code of a file in `folder` may depend on.

    In this package: the lower floors and the whole room that the folder is in, whose files may
    call one another. Elsewhere: the whole package that the folder is in, or only itself for a
    loose file.
    """
    top, loose = _top(folder), not (folder / "__init__.py").is_file()
    if top == _PACKAGE:
        room = folder.relative_to(top).parts[:1]
        paths = {*(top / room[0]).rglob("*.py")} if room else set()
        for floor in _LOWER_FLOORS:
            paths |= {top / floor} if floor.endswith(".py") else {*(top / floor).glob("*.py")}
    else:
        paths = set(top.glob("*.py") if loose else top.rglob("*.py"))
    sha = hashlib.sha256()
    for path in sorted(paths):
        sha.update(f"{path.relative_to(top).as_posix()}\0".encode() + path.read_bytes())
    return sha.hexdigest()


def _all_folders() -> Path:
    """Where the cache folders are: below ``RELNAV_CACHE_DIR``, else ``XDG_CACHE_HOME``, else
    ``~/.cache``. Whoever has no home, as in some containers, gets a place that keeps nothing."""
    root = os.environ.get("RELNAV_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    try:
        base = Path(root) if root else Path.home() / ".cache"
    except RuntimeError:
        base = Path(os.devnull)
    return base / "relnav_graph"


def cache_folder(source: str) -> Path:
    """Where the compiled code of the source file `source` is kept: in a folder named after
    everything that the machine code depends on."""
    folders = {_PACKAGE, Path(source).resolve().parent}
    key = "".join(_digest(folder) for folder in sorted(folders))
    key += f"{numba.__version__} {sys.version_info[:2]} {numba.config.BOUNDSCHECK}"
    return _all_folders() / hashlib.sha256(key.encode()).hexdigest()[:16]


def why_not_kept(folder: Path) -> str:
    """Why a cache folder takes no files; "" when it does."""
    if Path(os.devnull) in folder.parents:
        return "there is no home folder"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return f"{folder}: {error.strerror or error}"
    return ""


@cache
def _warn(trouble: str) -> None:
    """Say what is wrong with the cache, once: it has hundreds of files."""
    _LOG.warning("%s: %s", _all_folders(), trouble)


class _CheckedFiles(IndexDataCacheFile):  # type: ignore[misc]
    """numba's two files of a function, index and code, each with a digest before its content."""

    def __init__(self, files: IndexDataCacheFile) -> None:
        self.__dict__.update(vars(files))

    def _content(self, path: str) -> Any:
        """What a file holds; None when it is absent, unreadable or damaged."""
        try:
            stored = Path(path).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            _warn(f"compiled code cannot be read: {error.strerror or error}")
            return None
        digest, content = stored[:32], stored[32:]
        if hashlib.sha256(content).digest() != digest:
            _warn("damaged files of compiled code; what they held is compiled again")
            return None
        return pickle.loads(content)

    def _store(self, path: str, content: bytes) -> None:
        with self._open_for_write(path) as file:
            file.write(hashlib.sha256(content).digest() + content)

    def _load_index(self) -> dict[Any, str]:
        stamp, overloads = self._content(self._index_path) or (None, {})
        return overloads if stamp == self._source_stamp else {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._store(self._index_path, self._dump((self._source_stamp, overloads)))

    def _load_data(self, name: str) -> Any:
        return self._content(self._data_path(name))

    def _save_data(self, name: str, data: Any) -> None:
        self._store(self._data_path(name), self._dump(data))


class _ByContent(UserProvidedCacheLocator):  # type: ignore[misc]
    """Where a function's code is, below a folder that is named after the sources: by the path of
    its file in the package, so that installations and checkouts of the same sources share it."""

    def __init__(self, function: Any, file: str) -> None:
        super().__init__(function, file)
        source = Path(file).resolve()
        top = _top(source.parent)
        loose = not (top / "__init__.py").is_file()
        own = source.relative_to(top if loose else top.parent).with_suffix("")
        self._cache_path = str(Path(numba.config.CACHE_DIR, ".".join(own.parts)))

    def get_source_stamp(self) -> int:
        """The same always: the folder's name knows the content."""
        return 0


class _HereOnly(CompileResultCacheImpl):  # type: ignore[misc]
    """numba would else keep code beside the source, where a change in a callee goes unseen."""

    _locator_classes = (_ByContent,)


class _DiskCache(FunctionCache):  # type: ignore[misc]
    """numba's cache of one function; where it cannot be written, code stays in memory."""

    _impl_class = _HereOnly

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file: Any = _CheckedFiles(self._cache_file)

    def save_overload(self, signature: Any, result: Any) -> None:
        try:
            super().save_overload(signature, result)
        except OSError as error:
            _warn(f"compiled code cannot be kept: {error.strerror or error}")


def disk_cache(function: Any, folder: Path) -> Any:
    """What keeps a function's machine code in a folder; None where that takes no files."""
    configured = numba.config.CACHE_DIR  # numba has one global folder only; put it back
    numba.config.CACHE_DIR = str(folder)
    try:
        return _DiskCache(function)
    except (OSError, RuntimeError):
        return None
    finally:
        numba.config.CACHE_DIR = configured


@cache
def is_empty(folder: Path) -> bool:
    """Whether nothing has been compiled into a cache folder; told once to a process."""
    try:
        return next(folder.rglob("*.nbi"), None) is None  # numba makes the folder at import
    except OSError:
        return True


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
