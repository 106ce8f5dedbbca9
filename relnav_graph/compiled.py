"""Kernels: compiled functions of one signature per contract, and the loops that call them.

A *kernel* is the one place where a model's formula stands. Each contract has one
fixed signature, so that the generic loops call kernels by their address and are
themselves compiled once, whatever models a problem uses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, wraps
from typing import Any, TypeVar

from numba import types
from numba.core.errors import NumbaError
from numba.experimental.function_type import _get_jit_address
from numba.extending import intrinsic

from relnav_graph.compilation import compile_ahead, compiled_once
from relnav_graph.errors import ModelError
from relnav_graph.lowering import call_compiled

__all__ = [
    "DYNAMICS_KERNEL",
    "SENSOR_KERNEL",
    "announce",
    "call_dynamics",
    "call_sensor",
    "dynamics_address",
    "jit",
    "jit_as",
    "jit_columns",
    "jit_vector",
    "jit_wrapped",
    "prepare",
    "sensor_address",
]

F = TypeVar("F", bound=Callable[..., Any])

VECTOR = types.Array(types.float64, 1, "C")
MATRIX = types.Array(types.float64, 2, "C")
STACK = types.Array(types.float64, 3, "C")
INDICES = types.Array(types.int64, 1, "C")
INDEX_MATRIX = types.Array(types.int64, 2, "C")
INDEX_STACK = types.Array(types.int64, 3, "C")

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


def jit(function: F) -> F:
    """Compile `function` at its first call; for kernels, and for what they call."""
    return compiled_once(function)


def jit_wrapped(function: F) -> F:
    """:func:`jit` for what Python, too, calls in most runs: with the wrapper for that, which
    takes as long to compile as a small function."""
    return compiled_once(function, wrapped=True)


def jit_vector(function: F) -> F:
    """:func:`jit` with loops over vectors, for long rows."""
    return compiled_once(function, vectorize="loops")


def jit_columns(function: F) -> F:
    """:func:`jit` with vectors made of what is written out for adjoining columns."""
    return compiled_once(function, vectorize="columns")


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
    """The machine code of a sensor's kernel, compiled if need be, for `call_sensor`.

    An address costs a loop nothing to take; a first-class function 15 us per call.
    Raises ModelError on a function that is not compiled or has another signature.
    """
    return _address(kernel, SENSOR_KERNEL)


@cache
def dynamics_address(kernel: Any) -> int:
    """The machine code of a process model's kernel, for `call_dynamics`. Raises ModelError."""
    return _address(kernel, DYNAMICS_KERNEL)


def _call(contract: Any) -> Callable[..., Any]:
    """Code that calls the function of a contract at an address: (address, its arguments).

    Like numba's first-class functions, without their ways for addresses of other kinds, which
    take longer to compile than all around them.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address, *arguments = values
        types_ = contract.return_type, contract.args
        pointer = context.call_conv.get_function_type(*types_).as_pointer()
        function = builder.inttoptr(address, pointer)
        return call_compiled(context, builder, function, *types_, arguments)

    return generate


@intrinsic  # type: ignore[untyped-decorator]
def call_sensor(
    context: Any, address: Any, p: Any, q: Any, z: Any, x: Any, r: Any, H: Any
) -> tuple[Any, Any]:
    """Inside compiled code: what the sensor's kernel at an address does."""
    return SENSOR_KERNEL.return_type(types.int64, *SENSOR_KERNEL.args), _call(SENSOR_KERNEL)


@intrinsic  # type: ignore[untyped-decorator]
def call_dynamics(
    context: Any, address: Any, p: Any, t: Any, u: Any, x: Any, x_next: Any, F: Any, Q: Any
) -> tuple[Any, Any]:
    """Inside compiled code: what the process model's kernel at an address does."""
    return DYNAMICS_KERNEL.return_type(types.int64, *DYNAMICS_KERNEL.args), _call(DYNAMICS_KERNEL)


#: The loops of `jit_as` in the modules imported so far that helpers compile, "module:name".
_LOOPS: list[str] = []


def jit_as(
    *arguments: Any, ahead: bool = True
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Compile at the first call, for exactly these numba argument types, returning nothing.

    For the generic loops, which take a kernel by its address, so that one compiled loop
    serves every kernel. Calls skip numba's dispatch: arrays must be of the type and layout
    declared. ahead: whether helpers compile it (`announce`): not what a program calls first.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @cache
        def entry() -> Any:
            compiled: Any = compiled_once(function, wrapped=True)
            return compiled.compile(types.void(*arguments))

        @wraps(function)
        def call(*values: Any) -> None:
            entry()(*values)

        call.prepare = entry  # type: ignore[attr-defined]
        if ahead:
            _LOOPS.append(f"{function.__module__}:{function.__qualname__}")
        return call

    return decorate


def prepare(loop: Any) -> None:
    """Compile a loop of `jit_as` before it is called."""
    loop.prepare()


def announce(sensors: Iterable[Any], processes: Iterable[Any]) -> None:
    """Say, once, when these kernels will be compiled for the first time, and have other cores
    help with them and with the loops."""
    kernels = [(k, "dynamics_address") for k in processes] + [
        (k, "sensor_address") for k in sensors
    ]
    known = [(k.py_func, compiler) for k, compiler in kernels if hasattr(k, "py_func")]
    # This process simulates first, then asks for the kernels, one by one: the helpers begin
    # with the loops, which come last.
    tasks = [f"{loop}/prepare" for loop in _LOOPS]
    tasks += [f"{f.__module__}:{f.__name__}/{compiler}" for f, compiler in reversed(known)]
    compile_ahead(tasks, (f.__code__.co_filename for f, _ in known))
