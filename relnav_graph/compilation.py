"""Machine code with numba: compiled once, called from everywhere, kept on disk.

numba copies the code of a compiled function into every function that calls it, and optimises
and generates it there anew: most of the time that it takes. Here each function is generated
once, and its callers call it by a symbol; Python, by a second copy with a wrapper. Helpers
compile beside the program on other cores; a lock for each function keeps two from doing the
same.

numba's own disk cache looks only at the file of the cached function: a change in a
callee, or in a constant, that lives in another file goes unseen. Here the cache folder
bears a digest of the sources that the code may depend on: this package's lower floors and
all of the function's own package. A change in any of them gives a new folder.
"""

from __future__ import annotations

import atexit
import fcntl
import gc
import hashlib
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from copy import copy
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import llvmlite.binding
import numba
from numba import types
from numba.core import sigutils
from numba.core.compiler import Flags
from numba.core.compiler_lock import global_compiler_lock

from relnav_graph.lowering import ShortCompiler, caller_of

__all__ = ["cache_folder", "compile_ahead", "compiled_once", "work"]

_LOG = logging.getLogger(__name__)
F = TypeVar("F", bound=Callable[..., Any])

#: Modules of this package that compiled code may call or take constants from.
_LOWER_FLOORS = (
    *("backward", "compilation", "compiled", "constants", "filtering", "loops"),
    *("lowering", "matrices", "orbit", "robust", "so3", "state", "sweep", "updating"),
)


@cache
def _digest(folder: Path) -> str:
    """Digest of the sources that machine code of a file in `folder` may depend on: the
    whole package that it is in; only its own folder for a loose file."""
    top, loose = folder, not (folder / "__init__.py").is_file()
    while (top.parent / "__init__.py").is_file():
        top = top.parent
    if top == Path(__file__).parent:
        own = [] if folder == top else list(folder.glob("*.py"))
        paths = [top / f"{name}.py" for name in _LOWER_FLOORS] + own
    else:
        paths = list(top.glob("*.py") if loose else top.rglob("*.py"))
    sha = hashlib.sha256()
    for path in sorted(paths):
        sha.update(path.name.encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()


def cache_folder(source: str) -> Path:
    """Where the compiled code of the source file `source` is kept.

    ``RELNAV_CACHE_DIR``, else ``XDG_CACHE_HOME``, else ``~/.cache``; below it a folder
    named after everything that the machine code depends on.
    """
    root = os.environ.get("RELNAV_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    base = Path(root) if root else Path.home() / ".cache"
    folders = {Path(__file__).parent, Path(source).resolve().parent}
    key = "".join(_digest(folder) for folder in sorted(folders))
    key += f"{numba.__version__} {sys.version_info[:2]} {numba.config.BOUNDSCHECK}"
    return base / "relnav_graph" / hashlib.sha256(key.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class _Callee:
    """A compiled function that others call, for these types of arguments."""

    module: str
    name: str
    arguments: tuple[Any, ...]

    def __call__(self) -> None:
        """Load it: called before code that calls it is loaded from the cache."""
        getattr(import_module(self.module), self.name).compile(self.arguments)


#: What the functions that are being compiled call, innermost last.
_CALLED: list[set[_Callee]] = []
#: What this process compiles when it has nothing better to do, "module:name/compiler", the
#: next one last.
_TASKS: list[str] = []


def work(tasks: list[str]) -> None:
    """Make things, each by calling a function of `relnav_graph.compiled` with it, in order."""
    _TASKS[:] = tasks[::-1]
    while _TASKS:
        _make(_TASKS.pop())


def _make(task: str) -> None:
    module, _, name = task.partition(":")
    name, _, compiler = name.partition("/")
    thing = getattr(import_module(module), name)
    getattr(import_module("relnav_graph.compiled"), compiler)(thing)


def _busy(path: Path) -> bool:
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


@contextmanager
def _locked(path: Path) -> Iterator[None]:
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


@contextmanager
def _no_collection() -> Iterator[None]:
    """Without Python's garbage collector: to look through all that numba makes takes it a
    twelfth of the time, and most is still in use."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@contextmanager
def _vectors(of: str) -> Iterator[None]:
    """What numba's compiler makes vectors of: it has one choice for all functions."""
    configured = numba.config.LOOP_VECTORIZE, numba.config.SLP_VECTORIZE
    numba.config.LOOP_VECTORIZE, numba.config.SLP_VECTORIZE = of == "loops", of == "columns"
    try:
        yield
    finally:
        numba.config.LOOP_VECTORIZE, numba.config.SLP_VECTORIZE = configured


def _call_by_symbol(compiled: Any, folder: Path, vectorize: str) -> None:
    """Have compiled callers call the one copy of a function's machine code.

    Its address is known to the linker of a process under a symbol, which the callers' code
    bears, in the cache as well. Cached code says what it needs to be loaded before it.
    """
    function = compiled.py_func
    build, compile_ = compiled._compiler.compile, compiled.compile
    symbols: dict[tuple[Any, ...], str] = {}

    def build_and_note(arguments: Any, return_type: Any) -> Any:
        _CALLED.append(set())
        try:
            with _vectors(vectorize):
                result = build(arguments, return_type)
        finally:
            called = _CALLED.pop()
        result.reload_init.extend(sorted(called - set(result.reload_init), key=repr))
        return result

    def compile_and_publish(signature: Any) -> Any:
        arguments = tuple(sigutils.normalize_signature(signature)[0])
        if arguments in symbols:
            return compiled.overloads[arguments].entry_point
        version = "/".join(folder.parts[-2:])  # no whole path: a cache may be moved
        text = f"{function.__module__}.{function.__qualname__}{arguments} {version}"
        symbol = "relnav_" + hashlib.sha256(text.encode()).hexdigest()
        # Who holds no lock may do something else in the meantime; who holds one might come to
        # wait for itself. Callers are locked before what they call, so that nobody waits for
        # each other.
        while not _HELD and _TASKS and _busy(folder / f"{symbol}.lock"):
            _make(_TASKS.pop())
        with global_compiler_lock, _locked(folder / f"{symbol}.lock"), _no_collection():
            entry = compile_(signature)
        result = compiled.overloads[arguments]
        result.library._reload_init.update(result.reload_init)  # for those who link it
        described = copy(result.fndesc)
        described.mangled_name = symbol
        address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
        llvmlite.binding.add_symbol(symbol, address)
        compiled.targetctx.insert_func_defn([(caller_of(described), symbol, arguments)])
        symbols[arguments] = symbol
        return entry

    def symbol_of(signature: Any) -> str:
        arguments = tuple(sigutils.normalize_signature(signature)[0])
        if _CALLED:
            _CALLED[-1].add(_Callee(function.__module__, function.__name__, arguments))
        return symbols[arguments]

    compiled._compiler.compile = build_and_note
    compiled.compile = compile_and_publish
    compiled.get_overload = symbol_of


class _Flags(Flags):  # type: ignore[misc]
    """numba's flags, all alike for what our functions call: the same `np.empty` serves a
    function with a wrapper for Python and one without."""

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Flags)


def _dispatcher(function: F, folder: Path, wrapped: bool, vectorize: str) -> Any:
    """numba's for a function; wrapped: with what Python calls it through."""
    options: dict[str, Any] = {"error_model": "numpy", "pipeline_class": ShortCompiler}
    options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": not wrapped}
    configured = numba.config.CACHE_DIR  # numba has one global folder only; put it back
    numba.config.CACHE_DIR = str(folder)
    try:
        compiled = numba.njit(cache=True, **options)(function)
    except (OSError, RuntimeError):  # nowhere to write the cache: compile in memory
        compiled = numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = configured
    compiled._compiler._customize_flags = _Flags
    template = compiled.get_call_template

    def of_types(arguments: Any, keywords: Any) -> Any:
        # A 0 is an integer: numba would compile the function again for each literal.
        return template([types.unliteral(a) for a in arguments], keywords)

    compiled.get_call_template = of_types
    if "<locals>" not in function.__qualname__:  # else no import finds it again
        _call_by_symbol(compiled, folder, vectorize)
        # Another process imports it: numba would make it anew there, without all this.
        compiled.__reduce__ = lambda: function.__qualname__
    return compiled


def _wrap_when_called(compiled: Any, make_twin: Callable[[], Any]) -> None:
    """Have Python's calls go to another dispatcher of a function, which has the wrapper."""

    def add_overload(result: Any) -> None:
        compiled.overloads[tuple(result.signature.args)] = result

    def compile_for_args(*values: Any, **keywords: Any) -> Any:
        with global_compiler_lock:
            twin = make_twin()
        entry = twin._compile_for_args(*values, **keywords)
        for arguments, result in twin.overloads.items():
            if result.entry_point is entry:  # from now on without this detour
                compiled._insert([a._code for a in arguments], entry, False)
        return entry

    compiled.add_overload, compiled._compile_for_args = add_overload, compile_for_args


def compiled_once(function: F, wrapped: bool = False, vectorize: str = "") -> F:
    """A function that numba compiles when it is first called, and keeps on disk.

    wrapped: what Python calls it through is compiled with it. It takes as long as a small
    function; else Python's first call has the function compiled once more, with it.
    vectorize: "loops", which takes long and only helps the long ones; "columns", neighbours
    that the source writes out one by one; or nothing.
    """
    folder = cache_folder(function.__code__.co_filename)
    compiled = _dispatcher(function, folder, wrapped, vectorize)
    if not wrapped:
        make_twin = cache(lambda: _dispatcher(function, folder / "wrapped", True, vectorize))
        _wrap_when_called(compiled, make_twin)
    return compiled  # type: ignore[no-any-return]


#: What helpers run.
_HELPER = (
    "import gc, sys; gc.disable(); from relnav_graph.compilation import work; work(sys.argv[1:])"
)


@cache
def _empty(folder: Path) -> bool:
    """Whether nothing has been compiled into a cache folder; told once to a process."""
    return next(folder.rglob("*.nbi"), None) is None  # numba makes the folder at import


def compile_ahead(tasks: list[str], sources: Iterable[str]) -> None:
    """Say so, and start helpers on the other cores, when `sources` were never compiled.

    tasks: "module:name/compiler". Each helper begins elsewhere among them, the first one with
    the first; this process does some too, from the last one on, while it waits for a helper.
    What has not been done when it ends is left.
    """
    folders = [folder for folder in map(cache_folder, sources) if _empty(folder)]
    if not folders:
        return
    _LOG.info("compiling the models, once; later runs take them from %s", folders[0])
    _TASKS[:] = tasks
    helpers = max(0, min(3, (os.cpu_count() or 1) - 1))
    for i in range(helpers):
        start = i * len(tasks) // helpers
        mine = tasks[start:] + tasks[:start]
        helper = subprocess.Popen(
            [sys.executable, "-c", _HELPER, *mine],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(p or "." for p in sys.path)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        atexit.register(helper.kill)
