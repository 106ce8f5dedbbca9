"""Groups of arrays with attributes in one NetCDF-4 file, with a digest of all content.

HDF5 by itself reads flipped bits as data, and damaged structures may keep it busy for good. So
the file ends with a line that bears the SHA-256 of all bytes before it, which is checked
before HDF5 sees them (what stands behind its end of file HDF5 ignores). A file without that
line, of a version before 0.2, or damaged just there, is first read in a process of its own,
which is given up when it takes too long. An attribute of the file bears a digest of the content,
which must be right in either case.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.files import printable, read_file
from relnav_graph.io.atomic import atomic
from relnav_graph.memory import check_room

__all__ = ["Attributes", "Group", "Variable", "read_groups", "write_groups"]

Attributes = dict[str, str | float | int]

_SEAL = re.compile(rb"\nsha256 of all before this line: ([0-9a-f]{64})\n\Z")
#: For a file without a seal: seconds to start a process and to read, and bytes read per second.
_START, _SPEED = 30.0, 1e7


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


def _sealed(content: bytes) -> bytes:
    digest = hashlib.sha256(content).hexdigest()
    return content + f"\nsha256 of all before this line: {digest}\n".encode()


def _printable(group: Group) -> Group:
    """The group with texts that HDF5 can hold."""

    def texts(attributes: Attributes) -> Attributes:
        return {k: printable(v) if isinstance(v, str) else v for k, v in attributes.items()}

    variables = {
        n: Variable(v.dimensions, v.values, texts(v.attributes)) for n, v in group.variables.items()
    }
    return Group(texts(group.attributes), variables)


#: How a dimension without values of its own is called, with its length, and what a variable begins
#: with that bears the name of a dimension but is not its values (netCDF-4, appendix on HDF5).
_NO_VALUES = "This is a netCDF dimension but not a netCDF variable.%10d"
_NO_COORDINATE = "_nc4_non_coord_"


def _write_group(target: Any, group: Group, first: int) -> int:
    """Write a group, whose dimensions are numbered from `first`; gives the number of the next.

    By h5py itself: h5netcdf, which looks for each dimension anew for each variable, takes four
    times as long.
    """
    target.attrs.update(group.attributes)
    sizes = {
        dimension: size
        for v in group.variables.values()
        for dimension, size in zip(v.dimensions, np.shape(v.values), strict=True)
    }
    stored, scales = dict[str, Any](), dict[str, Any]()
    for name, variable in group.variables.items():
        values = np.asarray(variable.values, dtype="<f8")
        coordinate = variable.dimensions == (name,)
        key = name if coordinate or name not in sizes else _NO_COORDINATE + name
        most = None if all(values.shape) else tuple(size or None for size in values.shape)
        stored[name] = target.create_dataset(key, data=values, maxshape=most, track_order=True)
        stored[name].attrs.update(variable.attributes)
        if coordinate:
            stored[name].make_scale(name)
            scales[name] = stored[name]
    for dimension, size in sizes.items():
        if dimension not in scales:
            # What has no elements may grow, in netCDF.
            most = None if size else (None,)
            own = {"maxshape": most, "track_order": True}
            scales[dimension] = target.create_dataset(dimension, (size,), ">f4", **own)
            scales[dimension].make_scale(_NO_VALUES % size)
        scales[dimension].attrs["_Netcdf4Dimid"] = np.int32(first)
        first += 1
    for name, variable in group.variables.items():
        if variable.dimensions != (name,):
            for axis, dimension in enumerate(variable.dimensions):
                stored[name].dims[axis].attach_scale(scales[dimension])
    return first


def write_groups(
    path: str | os.PathLike[str], file_format: str, version: int, groups: Mapping[str, Group]
) -> None:
    """Write groups by name; the group "" holds the attributes of the file itself.

    Raises InputError when the file cannot be written; what stood there is then as before.
    """
    groups = {name: _printable(group) for name, group in groups.items()}
    stamp: Attributes = {"format": file_format, "format_version": version}
    root = Group({**groups[""].attributes, **stamp})
    digest = _digest({**groups, "": root})
    # In memory first: HDF5 crashes the interpreter when the disk is full.
    image = io.BytesIO()
    with h5py.File(image, "w", track_order=True) as file:
        first = 0
        for name, group in groups.items():
            if name:
                first = _write_group(file.create_group(name, track_order=True), group, first)
        file.attrs.update({**root.attributes, "sha256": digest})
    with atomic(path) as staged:
        staged.write_bytes(_sealed(image.getvalue()))


def _read_attributes(attributes: Mapping[str, Any]) -> Attributes:
    return {k: v if isinstance(v, str) else np.asarray(v).item() for k, v in attributes.items()}


def _read_variable(source: Any) -> Variable:
    check_room(f"{source.shape} numbers of {source.name}", math.prod(map(float, source.shape)))
    return Variable(source.dimensions, np.asarray(source[...]), _read_attributes(source.attrs))


def _read_group(source: Any) -> Group:
    variables = {name: _read_variable(v) for name, v in source.variables.items()}
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


def _read(path: str, content: bytes, file_format: str, version: int) -> dict[str, Group]:
    """The groups in a file's content, checked by the digest in it."""
    try:
        # h5py looks at the attributes first: h5netcdf, should it fail half open, leaves an
        # object that complains on standard error when it is deleted.
        with h5py.File(io.BytesIO(content), "r") as raw:
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


def _try_apart(path: str, content: bytes, file_format: str, version: int) -> None:
    """Read a file's content in a process of its own. Raises InputError when that fails, dies or
    does not end."""
    limit = _START + len(content) / _SPEED
    command = [sys.executable, "-m", __name__, path, file_format, str(version)]
    # As this process finds its modules, so shall that one.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(
            command, input=content, capture_output=True, timeout=limit, check=False, env=environment
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"{path}: damaged: HDF5 did not end within {limit:.0f} s, and was given up"
        ) from error
    if done.returncode == 2:
        raise InputError(done.stdout.decode("utf-8", "replace"))
    if done.returncode != 0:
        raise InputError(f"{path}: damaged: reading it ended with code {done.returncode}")


def read_groups(path: str | os.PathLike[str], file_format: str, version: int) -> dict[str, Group]:
    """The groups that :func:`write_groups` was given.

    Raises InputError on a file that is missing, truncated, damaged, of another program or
    of another version, also where HDF5 would crash on it or not come back.
    """
    if not Path(path).exists():
        raise InputError(f"{path}: no such file")
    content, name = read_file(path), os.fspath(path)
    seal = _SEAL.search(content[-100:])
    if seal is None:
        _try_apart(name, content, file_format, version)
    else:
        content = content[: len(content) - len(seal[0])]
        if hashlib.sha256(content).hexdigest().encode() != seal[1]:
            raise InputError(f"{path}: damaged or changed: its bytes do not match their digest")
    return _read(name, content, file_format, version)


if __name__ == "__main__":
    try:
        _read(sys.argv[1], sys.stdin.buffer.read(), sys.argv[2], int(sys.argv[3]))
    except InputError as error:
        sys.stdout.buffer.write(str(error).encode("utf-8", "backslashreplace"))
        sys.exit(2)
