"""Writers of tracks: each module of this package is one, found by its name, and so is each module
of a package that the entry-point group ``relnav_graph.writers`` names.

A writer is a function ``write(track, path, **options) -> None`` in a module of its own. What it
writes appears complete or not at all (`relnav_graph.io.atomic`); it replaces what it would itself
have written, and refuses to write over anything else. It raises InputError on what the track lacks.
The module may say ``SUFFIXES = (".oem",)``: how names of such files end; and ``FOLDER = True``:
under another name it writes into a folder, beside what is there of other tracks.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from inspect import Parameter
from pathlib import Path
from typing import Any

from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.registry import (
    find_function,
    module_by_suffix,
    modules,
    options,
    wrong_options,
)

__all__ = ["GROUP", "by_suffix", "fills_folder", "options_of", "write_track", "writers"]

GROUP = "relnav_graph.writers"


def writers() -> Mapping[str, str]:
    """Module of each writer, by name; imported at the first use."""
    return modules(GROUP, __name__)


def by_suffix(path: Path) -> str | None:
    """The writer of files whose name ends like that; None: there is none."""
    return module_by_suffix(writers(), path)


def options_of(name: str) -> Mapping[str, Parameter]:
    """The options of a writer, by name. Raises InputError on an unknown one."""
    return options(find_function(_module(name), "write"), 2)


def fills_folder(name: str, path: Path) -> bool:
    """Whether a writer makes a folder of `path`, beside what is there of other tracks: not where it
    ends as names of its files do, unless it is one. Raises InputError on an unknown writer."""
    module = importlib.import_module(_module(name))
    ends = tuple(getattr(module, "SUFFIXES", ()))
    of_file = path.name.lower().endswith(ends) and not path.is_dir()
    return bool(getattr(module, "FOLDER", False)) and not of_file


def _module(name: str) -> str:
    known = writers()
    if name not in known:
        raise InputError(f"unknown writer {name!r}; known are {', '.join(known) or 'none'}")
    return known[name]


def write_track(name: str, track: Track, path: str | os.PathLike[str], **options: Any) -> None:
    """Write a track with the writer `name`, as a file or folder of its format.

    options: keyword arguments of the writer. Raises InputError on an unknown writer or option, on
    what the track lacks, on a place that others' files hold, and where nothing can be written.
    """
    write = find_function(_module(name), "write")
    if wrong := wrong_options(write, 2, options):
        raise InputError(f"writer {name!r}: {wrong}")
    write(track, Path(path), **options)
