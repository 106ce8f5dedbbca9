"""Mutations of values, JSON lines and texts, each drawn with a generator of its own seed."""

from __future__ import annotations

import copy
import json
import random
from typing import Any

__all__ = ["mutated_bytes", "mutated_line", "mutated_object"]

#: Numbers as they come in JSON, which Python would not write so.
RAW = (
    *("1e308", "-1e308", "1e400", "-1e999", "-0", "-0.0", "0", "1e-320", "NaN", "Infinity"),
    *("-Infinity", "1e5", "1.7e9", "1700000000123", "1.7e18", "1E+2", "true", "null", "0.1e1"),
    *(str(2**63), str(-(2**63) - 1), str(2**53 + 1), "1" + 309 * "0", "-1" + 309 * "0"),
    *("9" * 4300, "9" * 4301, "9" * 4305, "9" * 4310, "1" + 400 * "0" + ".5", "9" * 20_000),
    *(150 * "[" + 150 * "]", 99 * '{"a":' + "1" + 99 * "}", "3e-7", "1e-6", "123456789.123456789"),
)
VALUES: tuple[Any, ...] = (
    *("", "1", "NaN", "x", "\x00", "\ud83d\ude00", "é" * 100, "a" * 5000, "$x$", "../x", "1 m"),
    *([], {}, [[]], [{}], {"a": {}}, {"": []}, [1], [[1.0]], [None], [True], -1, 1, 2, 1e30, 1e31),
    *(None, True, False, 0.5, -1e-9, 1e9, 1e10, 1e11, 65536, 2**31, 2**62),
)
BYTES = (b"9" * 320, b"\x00", b"\xef\xbb\xbf", b"\xff\xfe", b"{", b"[", b'"', b"e999", b",,")


class _Raw(str):
    """What stands in the text as it is."""


def _paths(value: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [above] if above else []
    if not isinstance(value, dict | list):
        return found
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        found += _paths(inner, (*above, key))
    return found


def _number(rng: random.Random, value: float) -> Any:
    """Another number near, or far from, one that was there."""
    kind = rng.randrange(6)
    if kind == 0:
        return -value
    if kind == 1:
        return value * 10.0 ** rng.randint(-12, 12)
    if kind == 2:
        return value + rng.choice((-1, 1)) * 10.0 ** rng.uniform(-9, 12)
    if kind == 3:
        return value + rng.gauss(0, 1)
    if kind == 4:
        return int(value) if abs(value) < 1e15 else 0
    return value * (1 + 1e-15)


def mutated_object(rng: random.Random, value: Any, raw: bool = False) -> Any:
    """A copy with one to three changes. raw: also numbers that only a text can hold."""
    out = copy.deepcopy(value)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        paths = _paths(out)
        if not paths:
            return out
        *above, last = rng.choice(paths)
        inner = out
        for key in above:
            inner = inner[key]
        kind = rng.randrange(10)
        if kind == 0:
            del inner[last]
        elif kind == 1 and isinstance(inner, list):
            inner.insert(rng.randrange(len(inner) + 1), copy.deepcopy(rng.choice(inner)))
        elif kind == 1:
            inner[rng.choice(("x", "", "t", "n", "t_arrival", "kind", "settings"))] = inner[last]
        elif kind <= 4 and isinstance(inner[last], int | float):
            inner[last] = _number(rng, inner[last])
        elif kind <= 7 and raw:
            inner[last] = _Raw(rng.choice(RAW))
        else:
            inner[last] = copy.deepcopy(rng.choice(VALUES))
    return out


def _text(value: Any) -> str:
    """JSON, with raw texts as they are."""
    if isinstance(value, _Raw):
        return str.__str__(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)}: {_text(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_text, value)) + "]"
    return json.dumps(value)


def mutated_bytes(rng: random.Random, text: bytes) -> bytes:
    """Bytes flipped, cut out, put in, or doubled."""
    out = bytearray(text)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(out) + 1)
        kind = rng.randrange(6)
        if kind == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del out[at:]
        elif kind == 2:
            del out[at : at + rng.randrange(1, 20)]
        elif kind == 3:
            out[at:at] = rng.randbytes(rng.randrange(1, 4))
        elif kind == 4:
            out[at:at] = rng.choice(
                (b"9" * 320, b"\x00", b"\xef\xbb\xbf", b"{", b"[", b'"', b"e999")
            )
        else:
            out[at:at] = out[: rng.randrange(len(out) + 1)]
    return bytes(out)


def mutated_line(rng: random.Random, line: str) -> bytes:
    """A JSON line with something wrong in it, most of the time."""
    if rng.random() < 0.15:
        return mutated_bytes(rng, line.encode()).replace(b"\n", b" ")
    return _text(mutated_object(rng, json.loads(line), raw=True)).encode()
