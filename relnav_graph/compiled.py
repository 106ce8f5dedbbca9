"""Compilation of numeric kernels with numba, and a disk cache that cannot go stale.

A *kernel* is the one place where a model's formula stands. Each contract has one
fixed signature, so that the generic loops call kernels by their address and are
themselves compiled once, whatever models a problem uses.

numba's own disk cache looks only at the file of the cached function: a change in a
callee, or in a constant, that lives in another file goes unseen. Here the cache folder
bears a digest of the sources that the code may depend on: this package's lower floors and
all of the kernel's own package. A change in any of them gives a new folder.
"""

from __future__ import annotations

import hashlib
import logging
import os
import sys
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import types
from numba.core import cgutils
from numba.core.errors import NumbaError
from numba.experimental.function_type import _get_jit_address
from numba.extending import intrinsic

from relnav_graph.errors import ModelError

__all__ = [
    "DYNAMICS_KERNEL",
    "SENSOR_KERNEL",
    "announce",
    "cache_folder",
    "dynamics_address",
    "dynamics_at",
    "jit",
    "jit_as",
    "sensor_address",
    "sensor_at",
]

_LOG = logging.getLogger(__name__)
F = TypeVar("F", bound=Callable[..., Any])

VECTOR = types.Array(types.float64, 1, "C")
MATRIX = types.Array(types.float64, 2, "C")
STACK = types.Array(types.float64, 3, "C")
INDICES = types.Array(types.int64, 1, "C")

#: Numbers before and after each array that a kernel fills, and their value: a kernel that
#: writes past its arrays is found out, before it can spoil anybody else's memory.
GUARD, MARK = 64, 1.2345678901234567e300

#: ``status = kernel(p, q, z, x, r, H)``: one observation (one beacon, one point, one fix).
#: p constants of the sensor, q data of this observation, z measured value, x stored values
#: of the blocks read, one after the other; fills all of r (residual, prediction minus
#: measured) and of H (dr/dx in tangent coordinates), which come filled with NaN. A status
#: other than 0 names a geometry failure.
SENSOR_KERNEL = types.int64(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, MATRIX)

#: ``status = kernel(p, t, u, x, x_next, F, Q)``: one interval from time t. u has one row
#: per sub-interval: its length in seconds, then the inputs that hold in it. Fills all of
#: x_next (stored values of the advanced blocks), F (their sensitivity to all blocks read) and Q.
DYNAMICS_KERNEL = types.int64(VECTOR, types.float64, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX)


#: Modules of this package that compiled code may call or take constants from.
_LOWER_FLOORS = (
    *("backward", "compiled", "constants", "filtering", "loops"),
    *("matrices", "orbit", "robust", "so3", "state", "sweep", "updating"),
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
    key += f"{numba.__version__} {sys.version_info[:2]}"
    return base / "relnav_graph" / hashlib.sha256(key.encode()).hexdigest()[:16]


def _compile(function: F, *signature: Any, **options: bool) -> F:
    options["error_model"] = "numpy"  # type: ignore[assignment]
    configured = numba.config.CACHE_DIR  # numba has one global folder only; put it back
    numba.config.CACHE_DIR = str(cache_folder(function.__code__.co_filename))
    try:
        compiled = numba.njit(*signature, cache=True, **options)(function)
    except (OSError, RuntimeError):  # nowhere to write the cache: compile in memory
        compiled = numba.njit(*signature, **options)(function)
    finally:
        numba.config.CACHE_DIR = configured
    template = compiled.get_call_template

    def of_types(arguments: Any, keywords: Any) -> Any:
        # A 0 is an integer: numba would compile the function again for each literal.
        return template([types.unliteral(a) for a in arguments], keywords)

    compiled.get_call_template = of_types
    return compiled  # type: ignore[no-any-return]


def jit(function: F) -> F:
    """Compile `function` at its first call; for kernels and for what they call.

    A private one can be called from compiled code only: its wrappers for Python would take
    a tenth of the time that all compilation takes.
    """
    if function.__name__.startswith("_"):
        return _compile(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    return _compile(function)


@cache
def _announce(folder: Path) -> None:
    if next(folder.rglob("*.nbi"), None) is None:  # numba makes the folder at import
        _LOG.info("compiling the models, once; later runs take them from %s", folder)


def announce(kernel: Any) -> None:
    """Say, once, when a kernel will be compiled for the first time: that takes a while."""
    if hasattr(kernel, "py_func"):
        _announce(cache_folder(kernel.py_func.__code__.co_filename))


def _address(kernel: Any, signature: Any) -> int:
    name = getattr(kernel, "__name__", kernel)
    if not hasattr(kernel, "py_func"):
        raise ModelError(f"kernel {name}: not compiled; decorate it with relnav_graph's jit")
    try:
        return _get_jit_address(kernel, signature)  # type: ignore[no-any-return]
    except (NumbaError, TypeError) as error:
        raise ModelError(f"kernel {name}: does not compile as {signature}: {error}") from error


@cache
def sensor_address(kernel: Any) -> int:
    """The machine code of a sensor's kernel, compiled if need be, for `sensor_at`.

    An address costs a loop nothing to take; a first-class function 15 us per call.
    Raises ModelError on a function that is not compiled or has another signature.
    """
    return _address(kernel, SENSOR_KERNEL)


@cache
def dynamics_address(kernel: Any) -> int:
    """The machine code of a process model's kernel, for `dynamics_at`. Raises ModelError."""
    return _address(kernel, DYNAMICS_KERNEL)


def _function_at(kind: types.FunctionType) -> Any:
    """An intrinsic that turns an address into a first-class function of a type."""

    @intrinsic  # type: ignore[untyped-decorator]
    def function_at(typing_context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            function = cgutils.create_struct_proxy(kind)(context, builder)
            pointer = context.get_value_type(types.voidptr)
            function.jit_addr = builder.inttoptr(arguments[0], pointer)
            return function._getvalue()

        return kind(types.int64), generate

    return function_at


#: Inside compiled code: the kernel at an address.
sensor_at = _function_at(types.FunctionType(SENSOR_KERNEL))
dynamics_at = _function_at(types.FunctionType(DYNAMICS_KERNEL))


def jit_as(*arguments: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Compile at the first call, for exactly these numba argument types, returning nothing.

    For the generic loops, which take a kernel by its address, so that one compiled loop
    serves every kernel. Calls skip numba's dispatch: arrays must be of the type and layout
    declared.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @cache
        def entry() -> Any:
            (compiled,) = _compile(function, types.void(*arguments)).overloads.values()  # type: ignore[attr-defined]
            return compiled.entry_point

        @wraps(function)
        def call(*values: Any) -> None:
            entry()(*values)

        return call

    return decorate
