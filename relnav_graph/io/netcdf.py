"""Groups of arrays with attributes in one NetCDF-4 file, with a digest of all content.

The digest is there because HDF5 by itself reads flipped bits as data.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic

__all__ = ["Attributes", "Group", "Variable", "read_groups", "write_groups"]

Attributes = dict[str, str | float | int]


@dataclass(frozen=True)
class Variable:
    """An array of numbers, one name per axis, and its attributes."""

    dimensions: tuple[str, ...]
    values: Array
    attributes: Attributes


@dataclass(frozen=True)
class Group:
    """What a group of a file holds; the sizes of its dimensions follow from the variables."""

    attributes: Attributes
    variables: Mapping[str, Variable] = field(default_factory=dict)


def _digest(groups: Mapping[str, Group]) -> str:
    """SHA-256 over names, attributes and numbers, whatever order the file keeps them in."""
    sha = hashlib.sha256()
    for name, group in sorted(groups.items()):
        sha.update(repr((name, sorted(group.attributes.items()))).encode())
        for key, v in sorted(group.variables.items()):
            sha.update(repr((key, v.dimensions, v.values.shape)).encode())
            sha.update(repr(sorted(v.attributes.items())).encode())
            sha.update(np.ascontiguousarray(v.values, dtype="<f8").tobytes())
    return sha.hexdigest()


def _write_group(target: Any, group: Group) -> None:
    target.attrs.update(group.attributes)
    for name, variable in group.variables.items():
        values = np.asarray(variable.values, dtype=np.float64)
        for dimension, size in zip(variable.dimensions, values.shape, strict=True):
            if dimension not in target.dimensions:
                target.dimensions[dimension] = size
        created = target.create_variable(name, variable.dimensions, dtype="f8", data=values)
        created.attrs.update(variable.attributes)


def write_groups(
    path: str | os.PathLike[str], file_format: str, version: int, groups: Mapping[str, Group]
) -> None:
    """Write groups by name; the group "" holds the attributes of the file itself.

    Raises InputError when the file cannot be written; what stood there is then as before.
    """
    stamp: Attributes = {"format": file_format, "format_version": version}
    root = Group({**groups[""].attributes, **stamp})
    digest = _digest({**groups, "": root})
    # In memory first: HDF5 crashes the interpreter when the disk is full.
    image = io.BytesIO()
    with h5netcdf.File(image, "w", invalid_netcdf=False) as file:
        for name, group in groups.items():
            if name:
                _write_group(file.create_group(name), group)
        file.attrs.update({**root.attributes, "sha256": digest})
    with atomic(path) as staged:
        staged.write_bytes(image.getbuffer())


def _read_attributes(attributes: Mapping[str, Any]) -> Attributes:
    return {k: v if isinstance(v, str) else np.asarray(v).item() for k, v in attributes.items()}


def _read_group(source: Any) -> Group:
    variables = {
        name: Variable(v.dimensions, np.asarray(v[...]), _read_attributes(v.attrs))
        for name, v in source.variables.items()
    }
    return Group(_read_attributes(source.attrs), variables)


def _check_format(path: str | os.PathLike[str], raw: Any, file_format: str, version: int) -> None:
    stamp = {k: v for k, v in dict(raw.attrs).items() if k in ("format", "format_version")}
    found = _read_attributes(stamp)
    if found.get("format") != file_format:
        raise InputError(f"{path}: not a file of {file_format}")
    if found.get("format_version") != version:
        raise InputError(
            f"{path}: found format version {found.get('format_version')}, expected {version}"
        )


def read_groups(path: str | os.PathLike[str], file_format: str, version: int) -> dict[str, Group]:
    """The groups that :func:`write_groups` was given.

    Raises InputError on a file that is missing, truncated, damaged, of another program or
    of another version.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    try:
        # h5py looks at the attributes first: h5netcdf, should it fail half open, leaves an
        # object that complains on standard error when it is deleted.
        with h5py.File(path, "r") as raw:
            _check_format(path, raw, file_format, version)
            with h5netcdf.File(raw, "r") as file:
                groups = {"": _read_group(file)}
                groups |= {name: _read_group(group) for name, group in file.groups.items()}
    except InputError:
        raise
    except Exception as error:  # damaged bytes lead HDF5 to all kinds of errors
        raise InputError(f"{path}: not a readable file of {file_format}: {error}") from error
    digest = groups[""].attributes.pop("sha256", None)
    if digest != _digest(groups):
        raise InputError(f"{path}: damaged or changed: its content does not match its digest")
    return groups
