"""Readers of recorded data: each module of this package is one, found by its name, and so is each
module of a package that the entry-point group ``relnav_graph.readers`` names.

A reader is a function ``read(path, **options) -> Recording`` in a module of its own. `path` is a
folder, in which it finds its files by pattern; where the module says ``FILES = True``, it may be a
file instead, and ``SUFFIXES = (".oem",)`` says how names of such files end. A parameter `known` is
no option: it gets what the scenario knows, as `relnav_graph.io.known.Known`. Where the data know
when t = 0 of the recording is, its `settings` say so, as ``{"time": {"epoch": str(instant)}}``.

A function ``check(known, **options)`` of such a module, if there is one, raises InputError on what
is wrong with options, by what the scenario knows, before there are files.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from inspect import Parameter
from pathlib import Path
from typing import Any

from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.known import Known
from relnav_graph.registry import (
    find_function,
    module_by_suffix,
    modules,
    options,
    wrong_options,
)

__all__ = [
    "GROUP",
    "asks",
    "by_suffix",
    "options_of",
    "options_wrong",
    "read_raw",
    "readers",
    "roles_wrong",
    "takes_files",
]

GROUP = "relnav_graph.readers"
#: The parameter of a reader that is not an option.
_KNOWN = "known"


def readers() -> Mapping[str, str]:
    """Module of each reader, by name; imported at the first use."""
    return modules(GROUP, __name__)


def _module(name: str) -> str:
    known = readers()
    if name not in known:
        raise InputError(f"unknown reader {name!r}; known are {', '.join(sorted(known))}")
    return known[name]


def takes_files(name: str) -> bool:
    """Whether a reader takes a file, not only a folder. Raises InputError on an unknown one."""
    return bool(getattr(importlib.import_module(_module(name)), "FILES", False))


def by_suffix(path: Path) -> str | None:
    """The reader of files whose name ends like that; None: there is none."""
    return module_by_suffix(readers(), path)


def asks(name: str) -> bool:
    """Whether a reader asks for what the scenario knows. Raises InputError on an unknown one."""
    return _KNOWN in options(find_function(_module(name), "read"), 1)


def options_of(name: str) -> Mapping[str, Parameter]:
    """The options of a reader, by name. Raises InputError on an unknown one."""
    taken = options(find_function(_module(name), "read"), 1)
    return {option: one for option, one in taken.items() if option != _KNOWN}


def options_wrong(name: str, options: Any) -> str:
    """What is wrong with options of a reader, or with its name; "": nothing."""
    try:
        read = find_function(_module(name), "read")
    except InputError as error:
        return str(error)
    if not isinstance(options, Mapping):
        return f"data.options: found {options!r}, expected a table"
    wrong = wrong_options(read, 1, options, [_KNOWN])
    return f"reader {name!r}: {wrong}" if wrong else ""


def roles_wrong(name: str, options: Mapping[str, Any], known: Known) -> str:
    """What the `check` of a reader, if it has one, finds wrong with its options; "": nothing."""
    check = getattr(importlib.import_module(_module(name)), "check", None)
    try:
        if check is not None:
            check(known, **options)
    except InputError as error:
        return str(error)
    return ""


def read_raw(
    name: str,
    path: str | os.PathLike[str],
    options: Mapping[str, Any] | None = None,
    known: Known | None = None,
) -> Recording:
    """The recording that the reader `name` makes of a folder or, if it takes one, of a file.

    options: keyword arguments of the reader; known: what the scenario knows, for a reader that
    asks. Raises InputError on an unknown reader or option, on what is not there, and on whatever
    the reader refuses.
    """
    options = {} if options is None else options
    if wrong := options_wrong(name, options):
        raise InputError(wrong)
    path = Path(path)
    if not (path.exists() if takes_files(name) else path.is_dir()):
        what = "no such file or folder" if takes_files(name) else "no such folder"
        raise InputError(f"{path}: {what}")
    read = find_function(_module(name), "read")
    asked = {_KNOWN: known or Known()} if asks(name) else {}
    recording: Recording = read(path, **options, **asked)
    return recording
