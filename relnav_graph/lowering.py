"""Short code for LLVM from numba: the same machine code, compiled in half the time.

To read one element of a matrix, numba writes some forty lines in LLVM's language: all fields of
the array, stored, loaded and taken apart again. LLVM removes nearly all of that, but has to
read it first. What our functions consist of is written here in as few lines as it takes:
elements of arrays, loops, arguments, calls of each other. All else is numba's, and so is the
whole compilation of a function that uses what `ShortCompiler` leaves out.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from typing import Any, cast

import numba
from llvmlite.ir.instructions import InsertValue
from numba import types
from numba.core import cgutils, codegen, imputils, ir, lowering
from numba.core import typed_passes as typed
from numba.core import untyped_passes as untyped
from numba.core.compiler import Compiler, CompilerBase
from numba.core.compiler_machinery import PassManager, register_pass

__all__ = ["ShortCompiler", "call_compiled", "caller_of"]

_LOG = logging.getLogger(__name__)


def _place(builder: Any, kind: Any) -> Any:
    """Memory on the stack, the same one in each round of a loop."""
    with builder.goto_entry_block():
        return builder.alloca(kind)


def _unpacked(builder: Any, value: Any, count: int) -> list[Any]:
    """The members of a tuple or structure; those that were just put in, as they were."""
    members: dict[int, Any] = {}
    part = value
    while isinstance(part, InsertValue) and len(part.indices) == 1:
        members.setdefault(part.indices[0], part.value)
        part = part.aggregate
    return [members.get(i) or builder.extract_value(value, i) for i in range(count)]


def _constant(value: Any) -> int | None:
    """The integer that a value is known to be, if it is; unsigned ones are not told apart."""
    number = getattr(value, "constant", None)
    return number if isinstance(number, int) and abs(number) < 2**63 else None


def call_compiled(
    context: Any, builder: Any, function: Any, returned: Any, arguments: Any, values: Any
) -> Any:
    """Code that calls a compiled function of these types; what it raises goes to the caller."""
    convention = context.call_conv
    if hasattr(builder, "_in_try_block"):
        status, value = convention.call_function(builder, function, returned, arguments, values)
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return value
    place = _place(builder, function.function_type.args[0].pointee)
    flat = convention._get_arg_packer(arguments).as_arguments(builder, values)
    exception = convention._get_excinfo_argument(builder.function)
    status = builder.call(function, [place, exception, *flat])
    with cgutils.if_unlikely(builder, builder.icmp_signed("!=", status, status.type(0))):
        builder.ret(status)
    value = builder.load(place)
    if value.type != context.get_value_type(returned):  # a truth value, which travels as a byte
        value = context.get_returned_value(builder, returned, value)
    return value


def caller_of(descriptor: Any) -> Callable[..., Any]:
    """What writes the calls of a function that numba has described."""
    returned, arguments = descriptor.restype, descriptor.argtypes
    if isinstance(returned, types.Optional):  # whose status says which of the two it is
        return cast(Callable[..., Any], imputils.user_function(descriptor, ()))

    def write(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        function = context.declare_function(builder.module, descriptor)
        return call_compiled(context, builder, function, returned, arguments, values)

    return write


class _Lower(lowering.Lower):  # type: ignore[misc]
    """Writes a function in LLVM's language."""

    def init(self) -> None:
        super().init()
        assigned = [i.target.name for b in self.blocks.values() for i in b.find_insts(ir.Assign)]
        times = Counter(assigned)
        #: Arguments that stay what they are, whose references need no counting: the caller
        #: holds its own until this function is done.
        self._borrowed = {
            inst.target.name
            for inst in self.blocks[self.firstblk].find_insts(ir.Assign)
            if isinstance(inst.value, ir.Arg) and times[inst.target.name] == 1
        }
        self._singly_assigned_vars |= self._borrowed

    def lower_assign(self, ty: Any, inst: Any) -> Any:
        name = inst.target.name
        if name in self._borrowed and self.typeof(f"arg.{inst.value.name}") == ty:
            return self.fnargs[inst.value.index]
        return super().lower_assign(ty, inst)

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        member = self._member_index(expr)
        if member is not None:
            out = self.builder.extract_value(self.loadvar(expr.value.name), member)
            self.incref(resty, out)
        elif resty == types.range_state64_type and self._is_range(expr):
            out = self._range([self._cast_var(limit, types.int64) for limit in expr.args])
        elif expr.op == "getiter" and resty == types.range_iter64_type:
            limits = self.loadvar(expr.value.name)
            out = self._range_iterator(limits) or super().lower_expr(resty, expr)
        elif expr.op == "iternext" and self.typeof(expr.value.name) == types.range_iter64_type:
            out = self._range_next(self.loadvar(expr.value.name))
        else:
            out = super().lower_expr(resty, expr)
        return out

    # Structures and elements of arrays -------------------------------------------

    def _field_index(self, kind: Any, name: str) -> int:
        """Where numba's structure for an array holds its shape, its data and so on."""
        return int(self.context.data_model_manager[kind].get_field_position(name))

    def _member_index(self, expr: Any) -> int | None:
        """The position of the member that an expression takes out of a structure, if it does."""
        if expr.op in ("pair_first", "pair_second"):
            return int(expr.op == "pair_second")
        if expr.op not in ("getattr", "static_getitem"):
            return None
        kind = self.typeof(expr.value.name)
        if expr.op == "getattr":
            if isinstance(kind, types.Array) and expr.attr == "shape":
                return self._field_index(kind, "shape")
            named = isinstance(kind, types.BaseNamedTuple) and expr.attr in kind.fields
            return kind.fields.index(expr.attr) if named else None
        place = expr.index if isinstance(kind, types.BaseTuple) else None
        return place if isinstance(place, int) and 0 <= place < len(kind) else None

    def _is_element(self, kind: Any, index: Any) -> bool:
        """Whether an index means one element of a C-contiguous array of numbers."""
        if not (isinstance(kind, types.Array) and kind.layout == "C" and kind.aligned):
            return False
        axes = index.types if isinstance(index, types.BaseTuple) else [index]
        integers = all(types.unliteral(axis) == types.int64 for axis in axes)
        numbers = kind.dtype in (types.float64, types.int64)
        return bool(numbers and integers and len(axes) == kind.ndim > 0)

    def _element_pointer(self, array: Any, index: Any) -> Any:
        """Where an element lies; None if it is none as `_is_element` wants it."""
        kind, index_kind = self.typeof(array.name), self.typeof(index.name)
        if not self._is_element(kind, index_kind):
            return None
        builder, fields, value = self.builder, self.loadvar(array.name), self.loadvar(index.name)
        several = isinstance(index_kind, types.BaseTuple)
        shape, offset = self._field_index(kind, "shape"), None
        for axis, i in enumerate(_unpacked(builder, value, kind.ndim) if several else [value]):
            known = _constant(i)
            if axis > 0 or known is None or known < 0:
                size = builder.extract_value(fields, [shape, axis])
            if known is None:  # a negative one counts from the end
                from_end = builder.icmp_signed("<", i, i.type(0))
                i = builder.select(from_end, builder.add(i, size), i)
            elif known < 0:
                i = builder.add(i, size)
            offset = i if offset is None else builder.add(builder.mul(offset, size), i)
        return builder.gep(builder.extract_value(fields, self._field_index(kind, "data")), [offset])

    def lower_getitem(self, resty: Any, expr: Any, value: Any, index: Any, signature: Any) -> Any:
        place = self._element_pointer(value, index)
        if place is None:
            return super().lower_getitem(resty, expr, value, index, signature)
        item = self.builder.load(place)
        return self.context.cast(self.builder, item, self.typeof(value.name).dtype, resty)

    def lower_setitem(self, target_var: Any, index_var: Any, value_var: Any, signature: Any) -> Any:
        place = self._element_pointer(target_var, index_var)
        if place is None:
            return super().lower_setitem(target_var, index_var, value_var, signature)
        value = self._cast_var(value_var, self.typeof(target_var.name).dtype)
        return self.builder.store(value, place)

    # Loops over a range ----------------------------------------------------------

    def _is_range(self, expr: Any) -> bool:
        """Whether an expression calls `range`, and not what returns one."""
        if expr.op != "call" or expr.kws or expr.vararg:
            return False
        return getattr(self.typeof(expr.func.name), "typing_key", None) is range

    def _range(self, limits: list[Any]) -> Any:
        """(start, stop, step)."""
        zero, one = limits[0].type(0), limits[0].type(1)
        limits = [zero, *limits] if len(limits) == 1 else limits
        return cgutils.pack_struct(self.builder, [*limits, one][:3])

    def _range_iterator(self, limits: Any) -> Any:
        """numba's iterator of a range in steps of 1 or -1: (where the next number is kept,
        stop, step, where the number of rounds to go is); None for other steps."""
        start, stop, step = _unpacked(self.builder, limits, 3)
        if _constant(step) not in (1, -1):
            return None
        first, last = (start, stop) if _constant(step) == 1 else (stop, start)
        rounds = last if _constant(first) == 0 else self.builder.sub(last, first)
        number, to_go = _place(self.builder, start.type), _place(self.builder, start.type)
        self.builder.store(start, number)
        self.builder.store(rounds, to_go)
        return cgutils.pack_struct(self.builder, [number, stop, step, to_go])

    def _range_next(self, iterator: Any) -> Any:
        """(the next number, whether there is one)."""
        builder = self.builder
        number, _, step, to_go = _unpacked(builder, iterator, 4)
        i, rounds = builder.load(number), builder.load(to_go)
        builder.store(builder.add(i, step), number)
        builder.store(builder.sub(rounds, rounds.type(1), flags=["nsw"]), to_go)
        there_is = builder.icmp_signed(">", rounds, rounds.type(0))
        return cgutils.pack_struct(builder, [i, there_is])

    # Variables, and the references that are counted ------------------------------

    def _counted(self, kind: Any) -> bool:
        return bool(self.context.data_model_manager[kind].contains_nrt_meminfo())

    def delvar(self, name: str) -> None:
        if name not in self._borrowed and self._counted(self.typeof(name)):
            super().delvar(name)

    def _references(self, kind: Any, value: Any) -> list[tuple[Any, Any]]:
        """The counted references in a value, with the type of each."""
        if isinstance(kind, types.Array):
            reference = self.builder.extract_value(value, self._field_index(kind, "meminfo"))
            return [(types.MemInfoPointer(kind.dtype), reference)]
        if isinstance(kind, types.BaseTuple) and self._counted(kind):
            members = [self.builder.extract_value(value, i) for i in range(len(kind))]
            pairs = zip(kind.types, members, strict=True)
            return [reference for pair in pairs for reference in self._references(*pair)]
        return [(kind, value)] if self._counted(kind) else []

    def incref(self, typ: Any, val: Any) -> None:
        for kind, reference in self._references(typ, val):
            super().incref(kind, reference)

    def decref(self, typ: Any, val: Any) -> None:
        for kind, reference in self._references(typ, val):
            super().decref(kind, reference)


class _Library(codegen.JITCodeLibrary):  # type: ignore[misc]
    """A function's machine code, optimised in one round. numba has LLVM go through it three
    times, to find more in what was copied from other functions; ours are called, not copied.

    Where vectors are wanted the round is that of whole modules, which alone makes them; else
    that of single functions, which takes half the time.
    """

    @property
    def _vectors(self) -> bool:
        return bool(numba.config.LOOP_VECTORIZE or numba.config.SLP_VECTORIZE)

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout
        if not self._vectors:
            for function in ll_module.functions:
                if not function.is_declaration:
                    passes, builder = self._codegen._function_pass_manager()
                    passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        if self._vectors:
            passes, builder = self._codegen._module_pass_manager()
            passes.run(self._final_module, builder)


@register_pass(mutates_CFG=False, analysis_only=False)
class _Compilation(typed.BaseNativeLowering):  # type: ignore[misc]
    """From numba's own form of a function to machine code."""

    _name = "short_compilation"

    @property
    def lowering_class(self) -> Any:
        return _Lower

    def run_pass(self, state: Any) -> bool:
        state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        super().run_pass(state)
        return bool(typed.NoPythonBackend().run_pass(state))


#: Functions, with the types of their arguments, that `ShortCompiler` could not compile.
_LEFT_TO_NUMBA: set[tuple[Any, Any]] = set()


class ShortCompiler(CompilerBase):  # type: ignore[misc]
    """numba's compiler for functions of numbers, arrays and tuples.

    numba's own one takes over where this one fails, and where bounds are checked or a debugger
    is to follow. Of its passes those are left out that serve functions within a function, with
    statements, isinstance, loops over mixed tuples and parallel loops, and second rounds.
    """

    _PASSES = (
        *(untyped.TranslateByteCode, untyped.FixupArgs, untyped.RewriteSemanticConstants),
        *(untyped.DeadBranchPrune, untyped.GenericRewrites, untyped.ReconstructSSA),
        *(typed.NopythonTypeInference, typed.PreLowerStripPhis, typed.NopythonRewrites),
        *(typed.IRLegalization, typed.AnnotateTypes, _Compilation),
    )

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._given = given

    def define_pipelines(self) -> list[Any]:
        passes = PassManager("short")
        for kind in self._PASSES:
            passes.add_pass(kind, kind._name)
        passes.finalize()
        return [passes]

    def compile_extra(self, func: Any) -> Any:
        flags, this = self.state.flags, (func, self.state.args)
        checked = flags.debuginfo or flags.boundscheck or numba.config.BOUNDSCHECK
        if not checked and this not in _LEFT_TO_NUMBA:
            try:
                return super().compile_extra(func)
            except Exception as error:  # numba says better what is wrong, if anything is
                _LOG.debug("%s is left to numba: %s", func.__qualname__, error)
                _LEFT_TO_NUMBA.add(this)
        return Compiler(*self._given).compile_extra(func)
