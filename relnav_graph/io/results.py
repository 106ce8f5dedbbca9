"""Results: tracks and truth in one NetCDF-4 file, or tracks as CSV tables.

Each track is a group of its name. The smoothed track that an online estimator ends with is a
group ``NAME_smoothed``; the truth a group ``truth``, or ``NAME_truth`` where the estimator flew
a pass of its own. Attitudes are stored as quaternions, covariances in tangent coordinates. The
definitions of the blocks stand beside the numbers, so that reading needs nothing else.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.constants import VERSION
from relnav_graph.core.cautions import Caution
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.netcdf import Attributes, Group, Variable, read_groups, write_groups
from relnav_graph.io.tabular import component_columns, from_components, to_components, write_table

__all__ = ["cautions_in", "cautions_out", "read_results", "write_csv", "write_results"]


_FORMAT = "relnav-graph results"
_VERSION = 1
#: Attributes of the file that are not the caller's.
_OWN = ("format", "format_version", "writer", "tracks", "sha256")


def _block_variable(block: Block, values: Array) -> Variable:
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
    return Variable(("time", f"{block.name}_component"), components, attributes)


def _block_of(name: str, variable: Variable) -> Block:
    a = variable.attributes
    texts = {k: str(a[k]) for k in ("symbol", "frame")}
    manifold: Any = a["manifold"]
    dim, unit, table_unit = int(a["tangent_dim"]), str(a["tangent_units"]), str(a["table_units"])
    return Block(name, manifold=manifold, dim=dim, unit=unit, table_unit=table_unit, **texts)


def cautions_out(cautions: Iterable[Caution]) -> str:
    """Cautions as an attribute."""
    return json.dumps([vars(c) for c in cautions])


def cautions_in(text: str) -> tuple[Caution, ...]:
    """The cautions that `cautions_out` made an attribute of."""
    return tuple(Caution(**c) for c in json.loads(text))


def _tangent_columns(block: Block) -> tuple[str, ...]:
    return component_columns(replace(block, manifold="vector"))


def _time(t: Array) -> Variable:
    long_name = "time since the epoch of the scenario"
    return Variable(("time",), np.asarray(t), {"units": "s", "long_name": long_name})


def _track_group(track: Track, smoothed: str, truth: str) -> Group:
    blocks = list(track.layout)
    variables = {"time": _time(track.t)}
    variables |= {b.name: _block_variable(b, track.value(b.name)) for b in blocks}
    covariance: Attributes = {
        "long_name": "covariance of the right perturbation, SI units and rad",
        "block_order": " ".join(b.name for b in blocks),
        "state_names": " ".join(f"{b.name}_{c}" for b in blocks for c in _tangent_columns(b)),
    }
    # Two names for one length: xarray cannot work with a dimension that occurs twice.
    variables["covariance"] = Variable(("time", "state", "state_2"), track.P, covariance)
    if track.step_s is not None:
        step: Attributes = {"units": "s", "long_name": "computing time of each online step"}
        variables["step_s"] = Variable(("step",), track.step_s, step)
    attributes: Attributes = {
        "name": track.name,
        "kind": track.kind,
        "status": track.status,
        "message": track.message,
        "runtime_s": float(track.runtime_s),
        "rejected": json.dumps({k: int(v) for k, v in track.rejected.items()}),
        "downweighted": json.dumps({k: int(v) for k, v in track.downweighted.items()}),
        "smoothed": smoothed,
        "truth": truth,
        "controlled": " ".join(b.name for b in track.controlled),
        "cautions": cautions_out(track.cautions),
    }
    return Group(attributes, variables)


def _truth_group(truth: Truth, blocks: Mapping[str, Block]) -> Group:
    variables = {"time": _time(truth.t)}
    known = [name for name in truth.values if name in blocks]
    variables |= {name: _block_variable(blocks[name], truth.values[name]) for name in known}
    return Group({"source": truth.source}, variables)


def _add_track(
    groups: dict[str, Group], name: str, track: Track, smoothed: str, truth: str
) -> None:
    if name in groups or name in ("", "truth") or "/" in name:
        raise InputError(f"a track cannot be called {name!r}: taken, or no name of a group")
    groups[name] = _track_group(track, smoothed, truth)


def write_results(
    path: str | os.PathLike[str],
    tracks: Sequence[Track],
    truth: Truth | None,
    attributes: Mapping[str, str],
    blocks: Iterable[Block] = (),
) -> None:
    """Write tracks, truth and attributes (scenario, seed, versions) to a NetCDF-4 file.

    blocks: definitions of true quantities that no track estimates; a truth without one is
    left out, since its units are not known. Raises InputError when two groups would bear
    one name, or when the file cannot be written; what stood there is then as before.
    """
    groups: dict[str, Group] = {}
    for track in tracks:
        smoothed = f"{track.name}_smoothed" if track.smoothed is not None else ""
        flight = f"{track.name}_truth" if track.truth is not None else ""
        _add_track(groups, track.name, track, smoothed, flight)
        if track.smoothed is not None:
            _add_track(groups, smoothed, track.smoothed, "", flight)
        if track.truth is not None:
            flown = {b.name: b for b in (*blocks, *track.layout, *track.controlled)}
            groups[flight] = _truth_group(track.truth, flown)
    if truth is not None:
        known = {b.name: b for b in (*blocks, *(b for t in tracks for b in t.layout))}
        groups["truth"] = _truth_group(truth, known)
    for key in attributes:
        if key in _OWN:
            raise InputError(f"the attribute {key!r} is the format's own")
    order = json.dumps([track.name for track in tracks])
    own: Attributes = {"writer": f"relnav-graph {VERSION}", "tracks": order}
    groups[""] = Group({**attributes, **own})
    write_groups(path, _FORMAT, _VERSION, groups)


def _track(groups: Mapping[str, Group], name: str) -> Track:
    variables, a = groups[name].variables, groups[name].attributes
    order = str(variables["covariance"].attributes["block_order"]).split()
    layout = Layout(_block_of(key, variables[key]) for key in order)
    t = variables["time"].values
    columns = [np.zeros((len(t), 0))]
    columns += [from_components(b, variables[b.name].values).reshape(len(t), -1) for b in layout]
    kind: Any = a["kind"]
    status: Any = a["status"]
    truth = groups[str(a["truth"])] if a.get("truth") else None
    controlled = str(a.get("controlled", "")).split()
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
        downweighted=json.loads(str(a.get("downweighted", "{}"))),
        smoothed=_track(groups, str(a["smoothed"])) if a["smoothed"] else None,
        truth=_truth(truth) if truth is not None else None,
        controlled=tuple(_block_of(n, truth.variables[n]) for n in controlled if truth is not None),
        cautions=cautions_in(str(a.get("cautions", "[]"))),
    )


def _truth(group: Group) -> Truth:
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
    groups = read_groups(path, _FORMAT, _VERSION)
    attributes = groups[""].attributes
    tracks = [_track(groups, name) for name in json.loads(str(attributes["tracks"]))]
    truth = _truth(groups["truth"]) if "truth" in groups else None
    return tracks, truth, {k: str(v) for k, v in attributes.items() if k not in _OWN}


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
