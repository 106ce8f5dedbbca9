"""Readers of raw data folders: each module of this package is one, found by its name.

A reader is a function ``read(folder, **options) -> Recording``; it finds its files by
pattern, so that a folder need not bear particular file names.
"""

from __future__ import annotations

import importlib
import inspect
import os
import pkgutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError

__all__ = ["READERS", "read_raw"]

#: Module of each reader, by name; imported at the first use.
READERS: Mapping[str, str] = {
    module.name: f"{__name__}.{module.name}" for module in pkgutil.iter_modules(__path__)
}


def read_raw(
    name: str, folder: str | os.PathLike[str], options: Mapping[str, Any] | None = None
) -> Recording:
    """The recording that the reader `name` makes of a folder.

    options: keyword arguments of the reader. Raises InputError on an unknown reader or
    option, on a folder that does not exist, and on whatever the reader refuses.
    """
    if name not in READERS:
        raise InputError(f"unknown reader {name!r}; known are {', '.join(sorted(READERS))}")
    if not Path(folder).is_dir():
        raise InputError(f"{folder}: no such folder")
    read = importlib.import_module(READERS[name]).read
    known = list(inspect.signature(read).parameters)[1:]
    if options is not None and not isinstance(options, Mapping):
        raise InputError(f"data.options: found {options!r}, expected a table")
    unknown = [key for key in options or {} if key not in known]
    if unknown:
        raise InputError(f"reader {name!r}: unknown option {unknown[0]!r}; known are {known}")
    recording: Recording = read(Path(folder), **(options or {}))
    return recording
