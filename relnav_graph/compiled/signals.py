"""Ctrl-C inside compiled loops."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = ["give_way"]

#: Turns of a loop between two looks at the signals: a look takes 50 ns, a short step 1 us.
_OFTEN = 64


@intrinsic  # type: ignore[untyped-decorator]
def give_way(context: Any, turn: Any) -> tuple[Any, Any]:
    """Inside compiled code: let Python handle the signals that have come, as between two of its
    own instructions; in every 64th turn of a loop, `turn` being their count (0: in each, where
    one takes long).

    Whatever a handler raises (KeyboardInterrupt at Ctrl-C) ends the compiled function and its
    callers. Python notes signals, and acts on them only when it is at work itself: a compiled
    loop over a long pass would else be deaf for minutes. The caller holds the interpreter's
    lock, as all code of `jit` and `jit_loop` does.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        number, count = ir.IntType(32), values[0].type
        kind = ir.FunctionType(number, ())
        check = cgutils.get_or_insert_function(builder.module, kind, "PyErr_CheckSignals")
        due = builder.icmp_signed("==", builder.and_(values[0], count(_OFTEN - 1)), count(0))
        with cgutils.if_unlikely(builder, due):
            status = builder.call(check, ())
            with cgutils.if_unlikely(builder, builder.icmp_signed("!=", status, number(0))):
                context.call_conv.return_exc(builder)
        return context.get_dummy_value()

    return types.void(turn), generate
