"""Machine code with numba: compiled once, called from everywhere, kept on disk.

`jit` compiles kernels and what they call, `jit_loop` the loops over a whole pass, which call
`give_way` in each turn, so that Ctrl-C ends them.
`contracts` has the signatures of kernels, `symbols` and `cache` how functions call one another
and where they are kept, `helpers` the first compilation on several cores.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, overload

from numba import types

from relnav_graph.compiled.signals import give_way
from relnav_graph.compiled.symbols import Vectorize, compiled_once

__all__ = ["give_way", "jit", "jit_loop", "loops_so_far", "prepare"]

F = TypeVar("F", bound=Callable[..., Any])

#: The loops of `jit_loop` in the modules imported so far that helpers compile.
_LOOPS: list[Callable[..., None]] = []


@overload
def jit(function: F) -> F: ...
@overload
def jit(*, from_python: bool = ..., vectorize: Vectorize = ...) -> Callable[[F], F]: ...
def jit(
    function: F | None = None, *, from_python: bool = False, vectorize: Vectorize = ""
) -> F | Callable[[F], F]:
    """Compile a function at its first call; for kernels, and for what they call.

    from_python: for what Python, too, calls in most runs: the wrapper through which Python
    calls it takes as long to compile as a small function, and is else made at Python's first
    call. vectorize: "loops" for long rows; "columns" for neighbours that the source writes
    out one by one; neither for all else.
    """
    if function is not None:
        return compiled_once(function)
    return lambda function: compiled_once(function, from_python, vectorize)


def jit_loop(
    *arguments: Any, ahead: bool = True
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Compile at the first call, for exactly these numba argument types, returning nothing.

    For the generic loops, which take a kernel by its address, so that one compiled loop
    serves every kernel. Calls skip numba's dispatch: arrays must be of the type and layout
    declared. A loop over epochs calls `give_way` in each turn. ahead: whether helpers compile
    it (`helpers.compile_ahead`): not what a program calls first.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @functools.cache
        def entry() -> Any:
            compiled: Any = compiled_once(function, from_python=True)
            return compiled.compile(types.void(*arguments))

        @functools.wraps(function)
        def call(*values: Any) -> None:
            entry()(*values)

        call.prepare = entry  # type: ignore[attr-defined]
        if ahead:
            _LOOPS.append(call)
        return call

    return decorate


def prepare(loop: Any) -> None:
    """Compile a loop of `jit_loop` before it is called."""
    loop.prepare()


def loops_so_far() -> tuple[Callable[..., None], ...]:
    """The loops of the modules imported so far that are worth compiling ahead."""
    return tuple(_LOOPS)
