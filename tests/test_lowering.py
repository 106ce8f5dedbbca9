"""The short way to machine code gives what numba's own way gives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from relnav_graph.compiled import call_sensor, jit, sensor_address
from relnav_graph.lowering import ShortCompiler


class Pair(NamedTuple):
    """Two arrays in one argument."""

    a: Any
    n: Any


def elements(a: Any, n: Any, i: Any) -> Any:
    """Read with constant and variable indices, from either end."""
    return a[0, 0] + 2.0 * a[i, 1] + 3.0 * a[-1, -2] + 5.0 * a[-i, i - 2] + 7.0 * a[i][1] + n[-i]


def written(a: Any, n: Any, i: Any) -> Any:
    """Integers into an array of numbers, numbers into one of integers, in place, twice."""
    out = np.zeros((3, 4))
    out[0, 1] = i
    out[-1, i] = a[1, 1]
    out[i, -i] += 2
    out[1, 2] = out[2, 3] = -n[0]
    counts = np.zeros(4, np.int64)
    counts[i], counts[-1] = counts[0] + 3, 2.0 * i
    return out, counts


def other_arrays(a: Any, n: Any, i: Any) -> Any:
    """A transposed array, every second column, single precision, three axes, truth values."""
    cube = np.ones((2, 3, 4))
    cube[1, i, -1], cube[0, 0] = 5.0, a[0]
    flags = np.zeros(3, np.bool_)
    flags[i] = True
    single = np.zeros((2, 2), np.float32)
    single[1, 0] = 0.1
    return a.T[1, i] + a[:, ::2][i, 1] + cube[1, i, 3] + cube[0, 0, i] + single[1, 0] + flags[i]


def shapes(a: Any, n: Any, i: Any) -> Any:
    """What an array knows of itself."""
    rows, columns = a.shape
    return rows, columns, a.shape[0] + 10 * a.shape[-1] + a.size, n.shape


def ranges(a: Any, n: Any, i: Any) -> Any:
    """One after the other: what is run through, and what is left of the variable."""
    out = np.full((12, 6), -1, np.int64)
    k = 0
    for k in range(3):
        out[0, k] = k
    for j in range(i, 5):
        out[1, j] = j
    for j in range(5, i):
        out[2, j] = j
    for j in range(4, -1, -1):
        out[3, j] = 4 - j
    for j in range(0, 5, i):
        out[4, j] = j
    for j in range(5, 0, -i):
        out[5, j] = j
    for j in range(a.shape[0]):
        for l in range(j + 1, a.shape[1]):
            if l == 2:
                continue
            out[6 + j, l] = 10 * j + l
    for j in range(6):
        if j == i:
            break
        out[10, j] = j
    else:
        out[11, 0] = 1
    for j in range(-3):
        out[11, j] = 2
    twice = range(1, 4)
    for j in twice:
        out[11, j] += j
    for j in twice:
        out[11, j] += j
    return out, k


def arguments(a: Any, n: Any, i: Any) -> Any:
    """Arguments that are given other values, in one branch, in a loop, and returned."""
    if i > 1:
        a = a + 1.0
    for _ in range(2):
        i = i + 1
        n = n * i
    b = a
    a = np.ones(2)
    return a, b, n, i


def returned(a: Any, n: Any, i: Any) -> Any:
    """The caller's own array, part of it, and a copy."""
    return a, a[i], n.copy()


def tuples(a: Any, n: Any, i: Any) -> Any:
    """Members of tuples of arrays and numbers."""
    both = (a, n)
    nested = (both, (1.5, i))
    x, y = nested[0]
    return x[0, 1] + y[1] + nested[1][0] + both[-1][i] + nested[1][1], both


def conditional(a: Any, n: Any, i: Any) -> Any:
    """Arrays that exist in one branch only, or change from round to round."""
    last = np.zeros(2)
    for j in range(3):
        if j == i:
            last = np.full(3, 1.0 * j)
        part = a[j] * last[0]
        last = part[1:]
    while last.shape[0] > 1:
        last = last[1:]
    return last, i and j, i or j


@numba.njit  # type: ignore[untyped-decorator]
def interior(n: Any) -> Any:
    """What is called below, and is not `range` itself."""
    return range(1, n - 1)


def calls(a: Any, n: Any, i: Any) -> Any:
    """What returns a range, and arrays that numba's own functions make."""
    total = 0
    for j in interior(6):
        total += j
    pairs = np.zeros(3, np.int64)
    for j, number in enumerate(n):
        pairs[j % 3] += number
    for x, y in zip(a, a[::-1]):  # noqa: B905 (numba knows no strict)
        total += x[0] * y[i]
    return total, pairs, np.dot(a, a.T), a.sum(), len(interior(i + 4))


def expressions(a: Any, n: Any, i: Any) -> Any:
    """Whole arrays, in one go and in small integers, which numba widens."""
    small = n.astype(np.int32) * np.int32(100000)
    out = np.empty_like(a)
    out[:] = a * a + 2.0 * a - a / 3.0
    return out, a**3 + a**5, small * small * small // 1000, a[0] @ a[1]


UNSIGNED = np.uint64(2**64 - 1)


def constants(a: Any, n: Any, i: Any, nothing: Any = None) -> Any:
    """Branches that the types decide, and an unsigned number that means -1."""
    value: Any = 1.5
    if nothing is None:
        value = 2**60 + 1
    return value, n[np.int64(UNSIGNED)]


FUNCTIONS = [
    *(elements, written, other_arrays, shapes, ranges, arguments, returned, tuples, conditional),
    *(calls, expressions, constants),
]
A, N = np.arange(12.0).reshape(3, 4) / 7.0, np.arange(3, 7)


def parts(value: Any) -> list[Any]:
    """A result's numbers and arrays."""
    return [p for v in value for p in parts(v)] if isinstance(value, tuple) else [value]


def short(function: Callable[..., Any]) -> Any:
    """Compiled in the short way, from Python, and nothing else."""
    return numba.njit(pipeline_class=ShortCompiler, error_model="numpy")(function)


def way(compiled: Any) -> str:
    """Which of the two ways a function was compiled in."""
    (result,) = compiled.overloads.values()
    return str(next(iter(result.metadata["pipeline_times"])))


@pytest.mark.parametrize("vectors", [0, 1], ids=["scalars", "vectors"])
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_like_numba(
    function: Callable[..., Any], vectors: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in ("LOOP_VECTORIZE", "SLP_VECTORIZE"):
        monkeypatch.setattr(numba.config, kind, vectors)
    mine, numbas = short(function), numba.njit(error_model="numpy")(function)
    for i in (2, 1):
        found, wanted = (parts(f(A.copy(), N.copy(), i)) for f in (mine, numbas))
        assert [type(p) for p in found] == [type(p) for p in wanted]
        for p, q in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(p, q)
    assert way(mine) == "short"


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_all_memory_is_given_back(function: Callable[..., Any]) -> None:
    _nrt_python.memsys_enable_stats()
    compiled = short(function)
    compiled(A, N, 2)
    before = rtsys.get_allocation_stats()
    for _ in range(50):
        compiled(A, N, 2)
    after = rtsys.get_allocation_stats()
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free
    assert after.mi_alloc - before.mi_alloc >= 100  # Python's two arrays are counted, too


@jit
def column_of(pair: Any, i: Any, seen: Any) -> Any:
    """Called below with a named tuple; fails after it has made an array."""
    out = np.empty(pair.a.shape[0])
    seen[i] += 1
    for j in range(out.shape[0]):
        out[j] = pair.a[j, i] * pair.n[i]
    if i > 2:
        raise ValueError("no such column")
    return out


@jit
def sums(pair: Any, columns: Any, seen: Any) -> Any:
    """Of some columns."""
    total = 0.0
    for i in range(columns):
        for x in column_of(pair, i, seen):
            total += x
    return total


@jit
def caught(pair: Any, columns: Any, seen: Any) -> Any:
    """The sum, or what stands for one that failed."""
    try:
        return sums(pair, columns, seen)
    except Exception:
        return -1.0


def test_calls_and_what_they_raise() -> None:
    pair, seen = Pair(A, N), np.zeros(4, np.int64)
    assert sums(pair, 3, seen) == pytest.approx(float(A.sum(0)[:3] @ N[:3]), rel=1e-14)
    with pytest.raises(ValueError, match="no such column"):
        sums(pair, 4, seen)
    np.testing.assert_array_equal(seen, [2, 2, 2, 1])
    assert caught(pair, 3, seen) == sums(pair, 3, seen)
    assert caught(pair, 4, seen) == -1.0


@jit
def refuses(p: Any, q: Any, z: Any, x: Any, r: Any, H: Any) -> Any:
    """A sensor's kernel that raises."""
    if p[0] > 0.0:
        raise ValueError("refused")
    return 7


@jit
def tried(address: Any, p: Any, H: Any) -> Any:
    """The status of a kernel, or what stands for one that raises."""
    try:
        return call_sensor(address, p, p, p, p, p, H)
    except Exception:
        return -1


def test_what_a_kernel_raises_is_caught_by_who_tries() -> None:
    address = sensor_address(refuses)
    assert tried(address, np.zeros(1), A) == 7
    assert tried(address, np.ones(1), A) == -1


def test_the_short_way_is_tried_once() -> None:
    """Not twice as often for each function further down a chain of calls."""
    tried_: Counter[str] = Counter()

    class Counting(ShortCompiler):
        def define_pipelines(self) -> Any:
            tried_[self.state.func_id.func_name] += 1
            return super().define_pipelines()

    def last(a: Any) -> Any:
        return a[0].no_such_thing

    link: Any = numba.njit(pipeline_class=Counting)(last)
    for _ in range(4):

        def chain(a: Any, callee: Any = link) -> Any:
            return callee(a)

        link = numba.njit(pipeline_class=Counting)(chain)
    with pytest.raises(numba.TypingError, match="no_such_thing"):
        link(A)
    assert tried_ == {"last": 1, "chain": 4}


def test_what_is_left_out_is_compiled_in_numbas_way() -> None:
    def squares(n: Any) -> Any:
        def square(i: Any) -> Any:
            return i * i

        return sum([square(i) for i in range(n)])

    compiled = short(squares)
    assert (compiled(4), way(compiled)) == (14, "nopython")


def test_an_error_is_numbas() -> None:
    def nonsense(a: Any) -> Any:
        return a.no_such_thing

    with pytest.raises(numba.TypingError, match="no_such_thing"):
        short(nonsense)(A)


def test_bounds_are_checked_where_numba_is_told_to(monkeypatch: pytest.MonkeyPatch) -> None:
    def beyond(a: Any, i: Any) -> Any:
        return a[i, 0]

    monkeypatch.setattr(numba.config, "BOUNDSCHECK", 1)
    monkeypatch.setenv("NUMBA_BOUNDSCHECK", "1")
    with pytest.raises(IndexError):
        short(beyond)(A, 3)
