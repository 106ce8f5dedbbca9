"""Kernels: compiled functions of one signature per contract, and how loops call them.

A *kernel* is the one place where a model's formula stands. Each contract has one
fixed signature, so that the generic loops call kernels by their address and are
themselves compiled once, whatever models a problem uses.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.errors import NumbaError
from numba.experimental.function_type import _get_jit_address
from numba.extending import intrinsic

from relnav_graph.errors import ModelError

__all__ = [
    "DEGENERATE",
    "DYNAMICS_KERNEL",
    "GUARD",
    "INDEX_MATRIX",
    "INDEX_STACK",
    "INDICES",
    "MARK",
    "MATRIX",
    "SENSOR_KERNEL",
    "STACK",
    "VECTOR",
    "call_dynamics",
    "call_sensor",
    "dynamics_address",
    "sensor_address",
]

VECTOR = types.Array(types.float64, 1, "C")
MATRIX = types.Array(types.float64, 2, "C")
STACK = types.Array(types.float64, 3, "C")
INDICES = types.Array(types.int64, 1, "C")
INDEX_MATRIX = types.Array(types.int64, 2, "C")
INDEX_STACK = types.Array(types.int64, 3, "C")

#: Numbers before and after each array that a kernel fills, and their value: a kernel that
#: writes past its arrays is found out, before it can spoil anybody else's memory.
GUARD, MARK = 64, 1.2345678901234567e300

#: Statuses of a sensor's kernel from here on say that the geometry is degenerate at this state,
#: as when a length is zero that it divides by: that ends an estimate, which could not move away
#: from there. Lower ones say that the observation is impossible, such as a point behind the
#: camera: it is left out.
DEGENERATE = 100

#: ``status = kernel(p, q, z, x, r, H)``: one observation (one beacon, one point, one fix).
#: p constants of the sensor, q data of this observation, z measured value, x stored values
#: of the blocks read, one after the other; fills all of r (residual, prediction minus
#: measured) and of H (dr/dx in tangent coordinates), which come filled with NaN. A status
#: other than 0 names a geometry failure, see `DEGENERATE`.
SENSOR_KERNEL = types.int64(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, MATRIX)

#: ``status = kernel(p, t, u, x, x_next, F, Q)``: one interval from time t. u has one row
#: per sub-interval: its length in seconds, then the inputs that hold in it. Fills all of
#: x_next (stored values of the advanced blocks), F (their sensitivity to all blocks read) and Q.
DYNAMICS_KERNEL = types.int64(VECTOR, types.float64, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX)


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
        status, out = context.call_conv.call_function(builder, function, *types_, arguments)
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return out

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
