"""Compiled functions that call each other by symbol, each generated once.

numba copies the code of a compiled function into every function that calls it, and optimises
and generates it there anew: most of the time that it takes. Here each function is generated
once, and its callers call it by a symbol; Python, by a second copy with a wrapper. A lock for
each function keeps two processes from doing the same.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, TypeVar

import llvmlite.binding
import numba
from numba import types
from numba.core import sigutils
from numba.core.compiler import Flags
from numba.core.compiler_lock import global_compiler_lock

from relnav_graph.compiled.cache import busy, cache_folder, disk_cache, holds_a_lock, locked
from relnav_graph.errors import InputError

__all__ = ["Vectorize", "compiled_once", "meanwhile"]

F = TypeVar("F", bound=Callable[..., Any])
Vectorize = Literal["", "loops", "columns"]


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
#: What this process compiles while it waits for another one, the next one last.
_MEANWHILE: list[Callable[[], object]] = []


def meanwhile(tasks: list[Callable[[], object]]) -> None:
    """Have this process do these, the last one first, while it waits for another one that
    compiles what it needs. The list is used up."""
    global _MEANWHILE
    _MEANWHILE = tasks


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
        while not holds_a_lock() and _MEANWHILE and busy(folder / f"{symbol}.lock"):
            _MEANWHILE.pop()()
        with global_compiler_lock, locked(folder / f"{symbol}.lock"), _no_collection():
            entry = compile_(signature)
        result = compiled.overloads[arguments]
        result.library._reload_init.update(result.reload_init)  # for those who link it
        described = copy(result.fndesc)
        described.mangled_name = symbol
        address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
        llvmlite.binding.add_symbol(symbol, address)
        compiled.targetctx.insert_user_function(symbol, described)
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
    options: dict[str, Any] = {"error_model": "numpy"}
    options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": not wrapped}
    compiled = numba.njit(**options)(function)
    compiled._cache = disk_cache(function, folder) or compiled._cache
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


def compiled_once(function: F, from_python: bool = False, vectorize: Vectorize = "") -> F:
    """A function that numba compiles when it is first called, and keeps on disk.

    from_python, vectorize: see `relnav_graph.compiled.jit`. Without `from_python`, Python's
    first call has the function compiled once more, with the wrapper for it. Raises InputError
    where numba is told to compile nothing: loops call kernels by the address of machine code.
    """
    if numba.config.DISABLE_JIT:
        raise InputError("NUMBA_DISABLE_JIT is set, and nothing works uncompiled here; unset it")
    folder = cache_folder(function.__code__.co_filename)
    compiled = _dispatcher(function, folder, from_python, vectorize)
    if not from_python:
        make_twin = cache(lambda: _dispatcher(function, folder / "wrapped", True, vectorize))
        _wrap_when_called(compiled, make_twin)
    return compiled  # type: ignore[no-any-return]
