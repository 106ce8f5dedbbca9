"""Scenario files as tables: reading, bases, and settings changed on the command line."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from relnav_graph.errors import InputError
from relnav_graph.scenario.schema import ScenarioError

__all__ = [
    "override",
]


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Two trees of nested tables as one; where both have a value, that of `over` wins."""
    out = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = merge(out[key], value) if both else value
    return out


def read_toml(path: Path, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """The tables of a TOML file, over those of the file that it names as `base`.

    above: the files that have named this one. Raises ScenarioError when one cannot be read
    or names one of those.
    """
    try:
        raw = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ScenarioError(str(path), [("", f"cannot be read: {error.strerror}")]) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(str(path), [("", f"not valid TOML: {error}")]) from error
    base = raw.pop("base", None)
    if base is None:
        return raw
    other = path.parent / str(base)
    above = (*above, path.resolve())
    if not isinstance(base, str) or other.resolve() in above:
        raise ScenarioError(str(path), [("base", f"found {base!r}, expected another file")])
    return merge(read_toml(other, above), raw)


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
