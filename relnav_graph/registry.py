"""Finding classes by their `kind`, and modules by their name, in every package that an entry point
names.

One entry per package, whose modules are walked: a new model, truth, estimator, reader or writer is
truly one new file, and a third party's package adds its own without touching this one.
"""

from __future__ import annotations

import difflib
import importlib.util
import inspect
import logging
import pkgutil
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from relnav_graph.errors import ModelError

__all__ = [
    "classes",
    "documented",
    "find_class",
    "find_function",
    "look_beside",
    "module_by_suffix",
    "modules",
    "options",
    "provides",
    "wrong_options",
]


#: What the docstring of a reader or writer points at.
_POINTED = re.compile(r"`(relnav_graph\.io\.[\w.]+)`")
_LOG = logging.getLogger(__name__)
#: The distribution whose own packages must be whole.
_OWN = "relnav-graph"


def _modules(package: str) -> Iterator[ModuleType]:
    root = importlib.import_module(package)
    yield root
    for info in pkgutil.walk_packages(getattr(root, "__path__", []), package + "."):
        yield importlib.import_module(info.name)


def _with_a_kind(module: ModuleType) -> Iterator[type[Any]]:
    """The classes that a module defines itself and that have a kind of their own."""
    for cls in vars(module).values():
        own = isinstance(cls, type) and cls.__module__ == module.__name__
        if own and isinstance(vars(cls).get("kind"), str):
            yield cls


def _leave_out(entry: EntryPoint, error: BaseException) -> None:
    """Say that an entry point of another distribution is left out, and why; raise an error of our
    own."""
    owner = entry.dist.name if entry.dist is not None else "unknown"
    if owner == _OWN:
        raise error
    _LOG.warning(
        f"{entry.group}: {entry.name} = {entry.value!r} of {owner} cannot be imported, and is"
        f" left out: {type(error).__name__}: {error}"
    )


def _classes_of(entry: EntryPoint) -> list[type[Any]]:
    """The classes in the package of an entry point.

    Another distribution's package that cannot be imported is named in a warning and left out:
    it must not take down what does not need it. Raises ModelError on a package without any
    such class, as where a stray file beside the user's script hides the real one.
    """
    try:
        modules = list(_modules(entry.value))
    except (Exception, SystemExit) as error:
        _leave_out(entry, error)
        return []
    found = [cls for module in modules for cls in _with_a_kind(module)]
    if not found:
        file = getattr(modules[0], "__file__", None) or list(modules[0].__path__)
        raise ModelError(
            f"{entry.group}: {entry.name} = {entry.value!r} is {file}, which holds no class with a"
            " kind; does it hide the package that was meant?"
        )
    return found


@cache
def classes(group: str) -> Mapping[str, type[Any]]:
    """Classes that define `kind`, by kind, of all packages in an entry-point group.

    Raises ModelError when two classes define the same kind, or a package defines none.
    """
    entries = {entry.value: entry for entry in entry_points(group=group)}
    found: dict[str, type[Any]] = {}
    for _, entry in sorted(entries.items()):
        for cls in _classes_of(entry):
            other = found.setdefault(cls.kind, cls)
            if other is not cls:
                raise ModelError(f"kind {cls.kind!r} is defined twice: {other} and {cls}")
    return dict(sorted(found.items()))


def look_beside(folder: Path, kinds: Iterable[str]) -> None:
    """Let modules that kinds name ("module:Class") be found in a folder, where they lie there.

    What can be imported without that goes first, as does what was imported already; a warning says
    so. The folder stands at the end of the path, so that its other files hide nothing, and worker
    processes find the same.
    """
    for kind in kinds:
        module = kind.partition(":")[0].partition(".")[0]
        own = [folder / f"{module}.py", folder / module / "__init__.py"]
        here = next((path for path in own if ":" in kind and path.is_file()), None)
        if here is None:
            continue
        loaded = sys.modules.get(module)
        spec = importlib.util.find_spec(module) if loaded is None else loaded.__spec__
        other = None if spec is None else spec.origin
        if other is None:
            sys.path.append(str(folder.resolve()))
            importlib.invalidate_caches()
        elif Path(other).resolve() != here.resolve():
            _LOG.warning(f"{kind}: {other} is taken, not {here}: rename one of them")


def find_class(group: str, kind: str, *contracts: type[Any]) -> type[Any]:
    """The class of a kind, or the one named directly as ``"module:Class"``.

    Raises ModelError, with the nearest and all known kinds, when there is none; contracts: those
    named are only the kinds that provide one of these, if any are given.
    """
    if ":" in kind:
        module, _, name = kind.partition(":")
        try:
            cls = getattr(importlib.import_module(module), name)
        except (Exception, SystemExit) as error:  # it is a stranger's code, and may do anything
            reason = f"{type(error).__name__}: {error}"
            raise ModelError(f"found kind {kind!r}, which cannot be imported: {reason}") from error
        if not isinstance(cls, type) or not isinstance(getattr(cls, "kind", None), str):
            raise ModelError(f"found kind {kind!r}, expected a class with a kind")
        return cls
    known = classes(group)
    if kind not in known:
        fit = (k for k, c in known.items() if any(provides(c, one) for one in contracts))
        own = list(fit if contracts else known)
        close = difflib.get_close_matches(kind, own, 1)
        hint = f" (is {close[0]!r} meant?)" if close else ""
        raise ModelError(f"found kind {kind!r}{hint}, expected one of: {', '.join(own)}")
    return known[kind]


def provides(cls: type[Any], contract: type[Any]) -> bool:
    """Whether a class has all that a Protocol names. (`issubclass` refuses Protocols with
    attributes.)"""
    named = {*vars(contract), *getattr(contract, "__annotations__", {})}
    return all(hasattr(cls, name) for name in named if not name.startswith("_"))


def _names_in(package: str) -> dict[str, str]:
    """Modules of a package, by their last name, without those that begin with an underscore; of a
    single module itself."""
    root = importlib.import_module(package)
    if not hasattr(root, "__path__"):
        return {package.rpartition(".")[2]: package}
    found = (info.name for info in pkgutil.iter_modules(root.__path__))
    return {name: f"{package}.{name}" for name in found if not name.startswith("_")}


@cache
def modules(group: str, own: str) -> Mapping[str, str]:
    """Modules by name: of the package `own`, and of all that an entry-point group names, each a
    package with a module for each thing, or one module.

    They are imported at their first use. Another distribution's package that cannot be imported is
    named in a warning and left out. Raises ModelError on a name that two of them have.
    """
    found = _names_in(own)
    for value, entry in sorted({e.value: e for e in entry_points(group=group)}.items()):
        try:
            others = _names_in(value)
        except (Exception, SystemExit) as error:
            _leave_out(entry, error)
            continue
        for name, module in others.items():
            if found.setdefault(name, module) != module:
                raise ModelError(f"{group}: {name!r} is there twice: {found[name]} and {module}")
    return dict(sorted(found.items()))


def suffixes(found: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """The SUFFIXES of the modules found, by name; of those that cannot be imported none."""
    ends = {}
    for name, module in found.items():
        try:
            ends[name] = tuple(getattr(importlib.import_module(module), "SUFFIXES", ()))
        except (Exception, SystemExit) as error:  # it may be a stranger's code
            _LOG.warning(f"{module} cannot be imported: {type(error).__name__}: {error}")
    return ends


def module_by_suffix(found: Mapping[str, str], path: Path) -> str | None:
    """The name of the module, of those found, whose SUFFIXES has the end of the name of a file;
    None: there is none."""
    name = path.name.lower()
    return next((one for one, ends in suffixes(found).items() if name.endswith(ends)), None)


def find_function(module: str, name: str) -> Callable[..., Any]:
    """A function of a module, for which others count on it. Raises ModelError when the module
    cannot be imported, or has none."""
    try:
        function = getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # it may be a stranger's code
        reason = f"{type(error).__name__}: {error}"
        raise ModelError(f"{module}: {name}() cannot be had: {reason}") from error
    if not callable(function):
        raise ModelError(f"{module}: {name} is {function!r}, expected a function")
    found: Callable[..., Any] = function
    return found


def options(function: Callable[..., Any], first: int) -> Mapping[str, inspect.Parameter]:
    """The options that a function takes, by name: its parameters after the `first` ones."""
    return dict(list(inspect.signature(function).parameters.items())[first:])


def wrong_options(
    function: Callable[..., Any], first: int, given: Iterable[str], besides: Iterable[str] = ()
) -> str:
    """What is wrong with the names of options `given` to a function: one that it does not take, or
    none that it needs; "" where nothing is. besides: parameters that are no options."""
    taken = options(function, first)
    names = [name for name in taken if name not in set(besides)]
    given = list(given)
    unknown = [name for name in given if name not in names]
    if unknown:
        return f"unknown option {unknown[0]!r}; known are {names}"
    lacks = [n for n in names if n not in given and taken[n].default is inspect.Parameter.empty]
    return f"found no option {lacks[0]!r}, expected it; known are {names}" if lacks else ""


def documented(found: Mapping[str, str], name: str, function: str) -> dict[str, str]:
    """What docstrings say of one of the modules found, and of its function: under "", and then of
    what these point at in `relnav_graph.io`, and what that points at, by its name there.

    Raises ModelError when the module cannot be imported, or has no such function.
    """
    own = find_function(found[name], function)
    texts = {"": "\n\n".join(inspect.getdoc(a) or "" for a in (sys.modules[found[name]], own))}
    waiting = _POINTED.findall(texts[""])
    while waiting:
        name = waiting.pop(0)
        if name in texts:
            continue
        try:
            thing: Any = importlib.import_module(name)
        except ImportError:
            module, _, attribute = name.rpartition(".")
            thing = getattr(importlib.import_module(module), attribute)
        texts[name] = inspect.getdoc(thing) or ""
        waiting += _POINTED.findall(texts[name])
    return texts
