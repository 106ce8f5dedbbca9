"""Finding classes by their `kind`, in every package that an entry point names.

One entry per package, whose modules are walked: a new model, truth or estimator is truly
one new file, and a third party's package adds its own without touching this one.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any

from relnav_graph.errors import ModelError

__all__ = ["classes", "find_class"]


def _modules(package: str) -> Iterator[ModuleType]:
    root = importlib.import_module(package)
    yield root
    for info in pkgutil.walk_packages(getattr(root, "__path__", []), package + "."):
        yield importlib.import_module(info.name)


@cache
def classes(group: str) -> Mapping[str, type[Any]]:
    """Classes that define `kind`, by kind, of all packages in an entry-point group.

    Raises ModelError when two classes define the same kind.
    """
    found: dict[str, type[Any]] = {}
    for package in sorted({entry.value for entry in entry_points(group=group)}):
        for module in _modules(package):
            for cls in vars(module).values():
                own = isinstance(cls, type) and cls.__module__ == module.__name__
                if own and isinstance(vars(cls).get("kind"), str):
                    other = found.setdefault(cls.kind, cls)
                    if other is not cls:
                        raise ModelError(f"kind {cls.kind!r} is defined twice: {other} and {cls}")
    return dict(sorted(found.items()))


def find_class(group: str, kind: str) -> type[Any]:
    """The class of a kind, or the one named directly as ``"module:Class"``.

    Raises ModelError, listing the known kinds, when there is none.
    """
    if ":" in kind:
        module, _, name = kind.partition(":")
        try:
            cls = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, TypeError, ValueError) as error:
            raise ModelError(f"found kind {kind!r}: {error}") from error
        if not isinstance(cls, type) or not hasattr(cls, "kind"):
            raise ModelError(f"found kind {kind!r}, expected a class with a kind")
        return cls
    known = classes(group)
    if kind not in known:
        raise ModelError(f"found kind {kind!r}, expected one of: {', '.join(known)}")
    return known[kind]
