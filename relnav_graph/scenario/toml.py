"""Scenario files as tables: reading, bases, and settings changed on the command line."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.registry import look_beside
from relnav_graph.scenario.schema import Problems, ScenarioError
from relnav_graph.scenario.shipped import by_name, near

__all__ = [
    "modules_of",
    "override",
    "refuse_modules",
    "strange_values",
]

#: What no scenario needs, and what would keep a reader of files busy for minutes or for ever:
#: bytes of a file, tables within tables, files that are each the base of the one before, files in
#: all.
_BYTES, _DEPTH, _BASES, _FILES = 16 * 2**20, 64, 16, 64
#: A dotted key of more parts than that: tomllib takes the square of their number.
_LONG_KEY = re.compile(
    rf"(?<![\w.\"'-])(?:(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*\.[ \t]*){{{_DEPTH}}}"
)


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested tables; a value in `over` wins, and false in place of a table takes that away."""
    out = dict(base)
    for key, value in over.items():
        if value is False and isinstance(out.get(key), Mapping):
            del out[key]
            continue
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = merge(out[key], value) if both else value
    return out


def text_trouble(text: str) -> str:
    """Why a text cannot go into all the files that bear it; "" when it can."""
    if "\0" in text:
        return f"found {text[:60]!r}, expected text without NUL"
    try:
        text.encode()
    except UnicodeEncodeError:
        return f"found {text[:60]!r}, expected text that is UTF-8"
    return ""


def _trouble(value: Any) -> str:
    """What is wrong with a single value, whatever it stands for; "" when nothing is."""
    if isinstance(value, str):
        return text_trouble(value)
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        return f"found an integer of {value.bit_length()} bits, expected one that a float can hold"
    return ""


def strange_values(raw: Mapping[str, Any]) -> Problems:
    """What no scenario may hold, wherever it stands, with its path: integers beyond all
    floats, text with NUL or outside UTF-8, tables nested more than 64 deep."""
    found: Problems = []
    waiting: list[tuple[str, Any, int]] = [("", raw, 0)]
    while waiting:
        path, value, depth = waiting.pop()
        if depth > _DEPTH:
            found.append((f"{path[:60]}...", f"nested more than {_DEPTH} deep"))
        elif isinstance(value, Mapping):
            for key, item in value.items():
                if trouble := text_trouble(str(key)):
                    found.append((path, f"a key: {trouble}"))
                waiting.append((f"{path}.{key}" if path else str(key), item, depth + 1))
        elif isinstance(value, (list, tuple)):
            waiting += [(f"{path}[{i}]", item, depth + 1) for i, item in enumerate(value)]
        elif trouble := _trouble(value):
            found.append((path, trouble))
    return found[::-1]


def _parse(text: str) -> dict[str, Any]:
    """The tables of TOML text. Raises ValueError, with the line."""
    long = _LONG_KEY.search(text)
    if long:
        line = text.count("\n", 0, long.start()) + 1
        raise ValueError(f"a key of more than {_DEPTH} parts (at line {line})")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError(f"nested more than {_DEPTH} deep") from error
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # Python's own: it reads no integer of so many digits
        digits = re.search(r"\d[\d_]{600}", text)
        line = text.count("\n", 0, digits.start()) + 1 if digits else 0
        raise ValueError(f"an integer of too many digits (at line {line})") from error


def _text(path: Path, of_data: bool) -> str:
    """The text of a file; of one that the user names, which may be a pipe, its beginning, so that
    one without end does not fill the memory. Raises ScenarioError (InputError of data) when it
    cannot be read, or is none."""

    def cannot(message: str, error: Exception | None = None) -> ScenarioError:
        found = ScenarioError(str(path), [("", message)])
        found.__cause__ = error
        return found

    try:
        if of_data:
            content = read_file(path, _BYTES)
        else:
            with path.open("rb") as file:
                content = file.read(_BYTES + 1)
    except IsADirectoryError as error:
        raise cannot(
            "is a folder, expected a scenario (a TOML file); a data set goes to `relnav smooth`"
            " or `validate`, or to --data",
            error,
        ) from error
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: NUL in the name
        missing = near(path) if isinstance(error, FileNotFoundError) and not of_data else ""
        reason = f"cannot be read: {getattr(error, 'strerror', error)}{missing}"
        raise cannot(reason, error) from error
    if len(content) > _BYTES:
        raise cannot(f"holds more than {_BYTES} bytes, expected a scenario")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise cannot(f"not valid TOML: {error}", error) from error


def read_toml(path: Path, of_data: bool = False) -> dict[str, Any]:
    """The tables of a TOML file, or of the scenario of that name that comes with the package (a
    path beats a name), over those of the file, or the list of files, that it names as
    `base`, later ones over earlier ones: see `merge`.

    of_data: it lies in a data set; else modules that it names ("module:Class") may lie beside it.
    Raises ScenarioError (InputError of data) when a file cannot be
    read, holds what no scenario may, or is its own base.
    """
    return _read(path if of_data else by_name(path), (), [], of_data)


def _read(path: Path, above: tuple[Path, ...], read: list[Path], of_data: bool) -> dict[str, Any]:
    """`read_toml`, of a base of others. above: the files that lead to this one; read: all that have
    been read so far, to which this one is added."""
    text = _text(path, of_data)
    read.append(path)
    try:
        raw = _parse(text)
    except ValueError as error:
        raise ScenarioError(str(path), [("", f"not valid TOML: {error}")]) from error
    if problems := strange_values(raw):
        raise ScenarioError(str(path), problems)
    if not of_data:
        look_beside(path.parent, modules_of(raw))
    base, found = raw.pop("base", []), dict[str, Any]()
    above = (*above, path.resolve())
    for i, one in enumerate(base if isinstance(base, list) else [base]):
        where = f"base[{i}]" if isinstance(base, list) else "base"
        problem = f"found {one!r}, expected another file"
        try:
            other = path.parent / str(one)
            known = not isinstance(one, str) or other.resolve() in above
        except (OSError, RuntimeError) as error:  # links that lead to each other
            raise ScenarioError(str(path), [(where, f"{problem}: {error}")]) from error
        if len(above) > _BASES:
            problem = f"found more than {_BASES} files, each the base of the one before"
        elif len(read) >= _FILES:
            problem = f"found more than {_FILES} files, expected fewer"
        elif not known:
            found = merge(found, _read(other, above, read, of_data))
            continue
        raise ScenarioError(str(path), [(where, problem)])
    return merge(found, raw)


def override(raw: Mapping[str, Any], assignments: Sequence[str]) -> dict[str, Any]:
    """The tables with ``key.path=value`` assignments made; values as in TOML, else text.

    Raises InputError on an assignment that cannot be read.
    """
    out = dict(raw)
    for text in assignments:
        key, equals, value = text.partition("=")
        parts = key.strip().split(".")
        if not equals or not all(parts) or len(parts) > _DEPTH:
            raise InputError(f"--set: found {text[:200]!r}, expected key.path=value")
        try:
            parsed: Any = _parse(f"v = {value}")["v"]
        except tomllib.TOMLDecodeError:
            parsed = value.strip()
        except ValueError as error:
            raise InputError(f"--set {key}: {error}") from error
        nested: Any = parsed
        for part in reversed(parts):
            nested = {part: nested}
        if problems := strange_values(nested):
            path, message = problems[0]
            raise InputError(f"--set {path}: {message}")
        out = merge(out, nested)
    return out


def _modules(path: str, found: Any) -> Iterator[tuple[str, str]]:
    """Where tables name a module: any text "module:Class" that a kind can be."""
    if isinstance(found, Mapping):
        for key, value in found.items():
            inner = f"{path}.{key}" if path else str(key)
            listed = value if isinstance(value, list) else [value]
            if key in ("kind", "estimators"):
                yield from ((inner, v) for v in listed if isinstance(v, str) and ":" in v)
            yield from _modules(inner, value)
    elif isinstance(found, list):
        for i, value in enumerate(found):
            yield from _modules(f"{path}[{i}]", value)


def modules_of(tables: Mapping[str, Any]) -> list[str]:
    """What tables name as "module:Class"."""
    return [name for _, name in _modules("", tables)]


def refuse_modules(where: str, tables: Mapping[str, Any]) -> None:
    """Raise InputError when tables that came with data name a module, as "module:Class": to
    import it is to run it, and data are not to say what runs."""
    for path, name in _modules("", tables):
        raise InputError(
            f"{where}: {path}: found {name!r}, which has a module imported, and so run; only a"
            " scenario file may, or data that a command is told to --trust"
        )
