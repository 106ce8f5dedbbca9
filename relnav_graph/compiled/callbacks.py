"""Python functions that compiled code calls: slow, and meant for prototypes.

A function of C's calling convention (`ctypes.CFUNCTYPE`) is known by its address, a number; so one
compiled kernel serves all Python functions, is compiled once and kept.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

__all__ = ["call_python"]


@intrinsic  # type: ignore[untyped-decorator]
def call_python(
    context: Any, address: Any, number: Any, out: Any, x: Any, q: Any
) -> tuple[Any, Any]:
    """Inside compiled code: ``status = f(number, out, x, q)`` for f at an address, all of them
    int64; out, x and q are the addresses of arrays."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        whole = ir.IntType(64)
        pointer = ir.FunctionType(whole, [whole] * 4).as_pointer()
        return builder.call(builder.inttoptr(values[0], pointer), values[1:])

    return types.int64(*[types.int64] * 5), generate
