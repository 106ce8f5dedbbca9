"""Scenario files as tables: reading, bases, and settings changed on the command line."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.scenario.schema import ScenarioError

__all__ = ["override", "refuse_modules"]

#: Bytes that a TOML file may have.
_MOST = 16_000_000


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Two trees of nested tables as one; where both have a value, that of `over` wins."""
    out = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = merge(out[key], value) if both else value
    return out


def _content(path: Path, of_data: bool) -> bytes:
    """The content of a file; of one that the user names, which may be a pipe, its beginning,
    so that one without end does not fill the memory."""
    if of_data:
        return read_file(path, _MOST)
    try:
        with path.open("rb") as stream:
            content = stream.read(_MOST + 1)
    except OSError as error:
        raise ScenarioError(str(path), [("", f"cannot be read: {error.strerror}")]) from error
    if len(content) > _MOST:
        raise ScenarioError(str(path), [("", f"found more than {_MOST} bytes: no scenario")])
    return content


def read_toml(path: Path, above: tuple[Path, ...] = (), of_data: bool = False) -> dict[str, Any]:
    """The tables of a TOML file, over those of the file that it names as `base`.

    above: the files that have named this one; of_data: it lies in a data set. Raises
    ScenarioError (InputError of data) when one cannot be read or names one of those.
    """
    try:
        raw = tomllib.loads(_content(path, of_data).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(str(path), [("", f"not valid TOML: {error}")]) from error
    base = raw.pop("base", None)
    if base is None:
        return raw
    other = path.parent / str(base)
    above = (*above, path.resolve())
    if not isinstance(base, str) or other.resolve() in above:
        raise ScenarioError(str(path), [("base", f"found {base!r}, expected another file")])
    return merge(read_toml(other, above, of_data), raw)


def override(raw: Mapping[str, Any], assignments: Sequence[str]) -> dict[str, Any]:
    """The tables with ``key.path=value`` assignments made; values as in TOML, else text.

    Raises InputError on an assignment that cannot be read.
    """
    out = dict(raw)
    for text in assignments:
        key, equals, value = text.partition("=")
        parts = key.strip().split(".")
        if not equals or not all(parts):
            raise InputError(f"--set: found {text!r}, expected key.path=value")
        try:
            parsed: Any = tomllib.loads(f"v = {value}")["v"]
        except tomllib.TOMLDecodeError:
            parsed = value.strip()
        nested: Any = parsed
        for part in reversed(parts):
            nested = {part: nested}
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


def refuse_modules(where: str, tables: Mapping[str, Any]) -> None:
    """Raise InputError when tables that came with data name a module, as "module:Class": to
    import it is to run it, and data are not to say what runs."""
    for path, name in _modules("", tables):
        raise InputError(
            f"{where}: {path}: found {name!r}, which has a module imported, and so run; data may"
            " not, unless you trust them and say so (--trust)"
        )
