"""Results: tracks and truth in one NetCDF-4 file, or tracks as CSV tables.

Each track is a group of its name, what it ends with smoothed a group ``NAME_smoothed``,
the truth a group ``truth``. Attitudes are kept as quaternions, covariances as they are.
The definitions of the blocks stand beside the numbers, so that reading needs nothing
else, and a digest of all content, because HDF5 by itself reads flipped bits as data.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import NDArray

from relnav_graph import __version__
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.tables import component_columns, from_components, to_components, write_table
from relnav_graph.state import Block, Layout
from relnav_graph.track import Track, Truth

__all__ = ["read_results", "write_csv", "write_results"]

Array = NDArray[np.float64]
Attributes = dict[str, str | float | int]

_FORMAT = "relnav-graph results"
_VERSION = 1
#: Attributes of the file that are not the caller's.
_OWN = ("format", "format_version", "writer", "tracks", "sha256")


@dataclass(frozen=True)
class _Variable:
    dimensions: tuple[str, ...]
    values: Array
    attributes: Attributes


@dataclass(frozen=True)
class _Group:
    """What a group of the file holds; dimensions follow from the variables."""

    attributes: Attributes
    variables: dict[str, _Variable] = field(default_factory=dict)


def _block_variable(block: Block, values: Array) -> _Variable:
    """A block over time, with its definition in the attributes."""
    quaternion = block.manifold == "SO3"
    what = ", Hamilton quaternion, scalar first (q_wxyz)" if quaternion else ""
    attributes: Attributes = {
        "units": "1" if quaternion else block.unit,
        "long_name": f"{block.name.replace('_', ' ')} {block.symbol}{what}",
        "symbol": block.symbol,
        "manifold": block.manifold,
        "tangent_dim": block.dim,
        "tangent_units": block.unit,
        "frame": block.frame,
        "table_units": block.table_unit,
    }
    components = to_components(block, values)
    return _Variable(("time", f"{block.name}_component"), components, attributes)


def _block_of(name: str, variable: _Variable) -> Block:
    a = variable.attributes
    texts = {k: str(a[k]) for k in ("symbol", "frame")}
    manifold: Any = a["manifold"]
    dim, unit, table_unit = int(a["tangent_dim"]), str(a["tangent_units"]), str(a["table_units"])
    return Block(name, manifold=manifold, dim=dim, unit=unit, table_unit=table_unit, **texts)


def _tangent_columns(block: Block) -> tuple[str, ...]:
    return component_columns(replace(block, manifold="vector"))


def _time(t: Array) -> _Variable:
    long_name = "time since the epoch of the scenario"
    return _Variable(("time",), np.asarray(t), {"units": "s", "long_name": long_name})


def _track_group(track: Track, smoothed: str) -> _Group:
    blocks = list(track.layout)
    variables = {"time": _time(track.t)}
    variables |= {b.name: _block_variable(b, track.value(b.name)) for b in blocks}
    covariance: Attributes = {
        "long_name": "covariance of the right perturbation, SI units and rad",
        "block_order": " ".join(b.name for b in blocks),
        "state_names": " ".join(f"{b.name}_{c}" for b in blocks for c in _tangent_columns(b)),
    }
    # Two names for one length: xarray cannot work with a dimension that occurs twice.
    variables["covariance"] = _Variable(("time", "state", "state_2"), track.P, covariance)
    if track.step_s is not None:
        step: Attributes = {"units": "s", "long_name": "computing time of each online step"}
        variables["step_s"] = _Variable(("step",), track.step_s, step)
    attributes: Attributes = {
        "name": track.name,
        "kind": track.kind,
        "status": track.status,
        "message": track.message,
        "runtime_s": float(track.runtime_s),
        "rejected": json.dumps({k: int(v) for k, v in track.rejected.items()}),
        "smoothed": smoothed,
    }
    return _Group(attributes, variables)


def _truth_group(truth: Truth, blocks: Mapping[str, Block]) -> _Group:
    variables = {"time": _time(truth.t)}
    for name, values in truth.values.items():
        if name not in blocks:
            raise InputError(f"truth of {name!r}, which no track estimates: give its block")
        variables[name] = _block_variable(blocks[name], values)
    return _Group({"source": truth.source}, variables)


def _digest(groups: Mapping[str, _Group]) -> str:
    """SHA-256 over names, attributes and numbers, whatever order the file keeps them in."""
    sha = hashlib.sha256()
    for name, group in sorted(groups.items()):
        sha.update(repr((name, sorted(group.attributes.items()))).encode())
        for key, v in sorted(group.variables.items()):
            sha.update(repr((key, v.dimensions, v.values.shape)).encode())
            sha.update(repr(sorted(v.attributes.items())).encode())
            sha.update(np.ascontiguousarray(v.values, dtype="<f8").tobytes())
    return sha.hexdigest()


def _write_group(target: Any, group: _Group) -> None:
    target.attrs.update(group.attributes)
    for name, variable in group.variables.items():
        for dimension, size in zip(variable.dimensions, variable.values.shape, strict=True):
            if dimension not in target.dimensions:
                target.dimensions[dimension] = size
        created = target.create_variable(
            name, variable.dimensions, dtype="f8", data=np.asarray(variable.values, np.float64)
        )
        created.attrs.update(variable.attributes)


def _read_group(source: Any) -> _Group:
    def attributes(attrs: Mapping[str, Any]) -> Attributes:
        return {k: v if isinstance(v, str) else np.asarray(v).item() for k, v in attrs.items()}

    variables = {
        name: _Variable(v.dimensions, np.asarray(v[...]), attributes(v.attrs))
        for name, v in source.variables.items()
    }
    return _Group(attributes(source.attrs), variables)


def write_results(
    path: str | os.PathLike[str],
    tracks: Sequence[Track],
    truth: Truth | None,
    attributes: Mapping[str, str],
    blocks: Iterable[Block] = (),
) -> None:
    """Write tracks, truth and attributes (scenario, seed, versions) to a NetCDF-4 file.

    blocks: definitions of true quantities that no track estimates. Raises InputError when
    two groups would bear one name, when a truth has no definition, or when the file
    cannot be written; what stood there is then as before.
    """
    groups: dict[str, _Group] = {}
    for track in tracks:
        parts = [(track.name, track)]
        if track.smoothed is not None:
            parts.append((f"{track.name}_smoothed", track.smoothed))
        for name, part in parts:
            if name in groups or name == "truth" or not name or "/" in name:
                raise InputError(f"a track cannot be called {name!r}: taken, or no name of a group")
            groups[name] = _track_group(part, parts[1][0] if part is not parts[-1][1] else "")
    if truth is not None:
        known = {b.name: b for b in (*blocks, *(b for t in tracks for b in t.layout))}
        groups["truth"] = _truth_group(truth, known)
    for key in attributes:
        if key in _OWN:
            raise InputError(f"the attribute {key!r} is the format's own")
    order = json.dumps([track.name for track in tracks])
    root: Attributes = {"format": _FORMAT, "format_version": _VERSION, "tracks": order}
    groups[""] = _Group({**attributes, **root, "writer": f"relnav-graph {__version__}"})
    digest = _digest(groups)
    with atomic(path) as staged, h5netcdf.File(staged, "w", invalid_netcdf=False) as file:
        for name, group in groups.items():
            _write_group(file.create_group(name) if name else file, group)
        file.attrs["sha256"] = digest


def _track(groups: Mapping[str, _Group], name: str) -> Track:
    variables, a = groups[name].variables, groups[name].attributes
    order = str(variables["covariance"].attributes["block_order"]).split()
    layout = Layout(_block_of(key, variables[key]) for key in order)
    t = variables["time"].values
    columns = [np.zeros((len(t), 0))]
    columns += [from_components(b, variables[b.name].values).reshape(len(t), -1) for b in layout]
    kind: Any = a["kind"]
    status: Any = a["status"]
    return Track(
        name=str(a["name"]),
        kind=kind,
        layout=layout,
        t=t,
        x=np.hstack(columns),
        P=variables["covariance"].values,
        status=status,
        message=str(a["message"]),
        runtime_s=float(a["runtime_s"]),
        step_s=variables["step_s"].values if "step_s" in variables else None,
        rejected=json.loads(str(a["rejected"])),
        smoothed=_track(groups, str(a["smoothed"])) if a["smoothed"] else None,
    )


def _truth(group: _Group) -> Truth:
    values = {
        name: from_components(_block_of(name, variable), variable.values)
        for name, variable in group.variables.items()
        if name != "time"
    }
    return Truth(group.variables["time"].values, values, str(group.attributes["source"]))


def read_results(
    path: str | os.PathLike[str],
) -> tuple[list[Track], Truth | None, dict[str, str]]:
    """Tracks, truth and the attributes that :func:`write_results` was given.

    Raises InputError on a file that is missing, truncated, damaged, of another program or
    of another version.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    try:
        # Through h5py: a file that h5netcdf fails to open leaves an object that complains
        # on standard error when it is deleted.
        with h5py.File(path, "r") as raw, h5netcdf.File(raw, "r") as file:
            root = _read_group(file)
            if root.attributes.get("format") != _FORMAT:
                raise InputError(f"{path}: not a file of {_FORMAT}")
            if root.attributes.get("format_version") != _VERSION:
                found = root.attributes.get("format_version")
                raise InputError(f"{path}: found format version {found}, expected {_VERSION}")
            groups = {name: _read_group(group) for name, group in file.groups.items()}
        digest = root.attributes.pop("sha256", None)
        if _digest({**groups, "": root}) != digest:
            raise InputError(f"{path}: damaged or changed: the digest does not match its content")
        tracks = [_track(groups, name) for name in json.loads(str(root.attributes["tracks"]))]
        truth = _truth(groups["truth"]) if "truth" in groups else None
    except InputError:
        raise
    except Exception as error:  # damaged bytes lead HDF5 to all kinds of errors
        raise InputError(f"{path}: not a readable results file: {error}") from error
    return tracks, truth, {k: str(v) for k, v in root.attributes.items() if k not in _OWN}


def write_csv(folder: str | os.PathLike[str], tracks: Sequence[Track]) -> None:
    """One table per track, and per smoothed track: time, components, sigmas; SI and rad.

    Attitudes are quaternions, their sigmas rotation angles about the axes on the right of
    the frame's letters. Raises InputError when a file cannot be written.
    """
    for track in tracks:
        columns = {"t_s": track.t}
        for block in track.layout:
            components = to_components(block, track.value(block.name))
            variances = np.diagonal(track.covariance(block.name), axis1=1, axis2=2)
            with np.errstate(invalid="ignore"):  # a diverged track: NaN says so
                sigmas = np.sqrt(variances)
            for name, values in zip(component_columns(block), components.T, strict=True):
                columns[f"{block.name}_{name}"] = values
            for name, values in zip(_tangent_columns(block), sigmas.T, strict=True):
                columns[f"sigma_{block.name}_{name}"] = values
        with atomic(Path(folder) / f"{track.name}.csv") as staged:
            write_table(staged, columns)
        if track.smoothed is not None:
            write_csv(folder, [replace(track.smoothed, name=f"{track.name}_smoothed")])
