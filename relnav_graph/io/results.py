"""Results: tracks and truth in one NetCDF-4 file.

Each track is a group of its name. The smoothed track that an online estimator ends with is a
group ``NAME_smoothed``; the truth a group ``truth``, or ``NAME_truth`` where the estimator flew
a pass of its own. Attitudes are stored as quaternions, covariances in tangent coordinates. The
definitions of the blocks stand beside the numbers, so that reading needs nothing else.

Static blocks, which have one value for the pass, are variables of their track's group like the
others, with ``static_covariance``, and ``cross_covariance`` with the states of the epochs: over
``time`` where each epoch says something else of them, over ``pass``, of length one, where all say
the same, as smoothers do. A family of numbered ones, such as the points of a map, is one variable,
with ``point_id`` and the ``point_covariance`` of each.

What follows from the blocks, such as the relative attitude, stands beside them with a covariance of
its own, ``NAME_covariance``. Innovations of a filter, or standardised residuals of a smoother, are
``innovations_SENSOR``, with their times. Observations that were not used are ``left_out_sensor``,
``left_out_time`` and ``left_out_id``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pydantic import Json

from relnav_graph.arrays import Array
from relnav_graph.constants import VERSION
from relnav_graph.core.cautions import Caution
from relnav_graph.core.numbered import members, number_in, unnumbered
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Kind, Statics, Status, Track, Truth, at_all_times
from relnav_graph.errors import InputError
from relnav_graph.io.block_variables import (
    block_of,
    block_variable,
    derived_variables,
    family_variables,
    stored_family,
)
from relnav_graph.io.innovations import innovation_variables, stored_innovations
from relnav_graph.io.left_out import left_out_variables, stored_left_out
from relnav_graph.io.netcdf import Attributes, Group, Variable, read_groups, write_groups
from relnav_graph.io.stored import Count, check_json
from relnav_graph.io.tabular import from_components, tangent_columns
from relnav_graph.scoring.deviations import derived_estimates

__all__ = ["cautions_in", "cautions_out", "read_results", "write_results"]

_FORMAT = "relnav-graph results"
_VERSION = 1
#: Attributes of the file that are not the caller's.
_OWN = ("format", "format_version", "writer", "tracks", "sha256")


def cautions_out(cautions: Iterable[Caution]) -> str:
    """Cautions as an attribute."""
    return json.dumps([vars(c) for c in cautions])


def cautions_in(where: str, text: str) -> tuple[Caution, ...]:
    """The cautions that `cautions_out` made an attribute of. Raises InputError, naming `where`, on
    another text."""
    return tuple(check_json(where, text.encode(), list[Caution]))


def _time(t: Array) -> Variable:
    long_name = "time since the epoch of the scenario"
    return Variable(("time",), np.asarray(t), {"units": "s", "long_name": long_name})


def _orders(blocks: Iterable[Block], of: str) -> Attributes:
    """What the rows and columns of a covariance are."""
    blocks = list(blocks)
    return {
        "block_order": " ".join(b.name for b in blocks),
        f"{of}_names": " ".join(f"{b.name}_{c}" for b in blocks for c in tangent_columns(b)),
    }


def _statics_variables(statics: Statics) -> dict[str, Variable]:
    blocks, x, P = statics.layout.blocks, statics.x, statics.P
    one = len(x) > 1 and bool((x == x[:1]).all() and (P[:1] == P).all())
    if one:
        x, P = x[:1], P[:1]
    over, names = ("pass" if one else "time"), _orders(blocks, "static")
    value, found = statics.layout.value, dict[str, Variable]()
    for b in blocks:
        if b.number is None:
            found[b.name] = block_variable(b, value(x, b.name), over)
    for own in members(blocks).values():
        at = [statics.layout.tangent(b.name) for b in own]
        values = np.stack([value(x, b.name) for b in own], axis=1)
        each = np.stack([P[:, rows, rows] for rows in at], axis=1)
        found |= family_variables(own, values, over, each)
    what = "covariance of the right perturbation, SI units and rad, of blocks with one value"
    joint: Attributes = {"long_name": what, **names}
    found["static_covariance"] = Variable((over, "static", "static_2"), P, joint)
    what = "covariance of the states of an epoch with blocks that have one value"
    between: Attributes = {"long_name": what, **names}
    cross = Variable(("time", "state", "static"), statics.cross, between)
    return {**found, "cross_covariance": cross}


def _track_group(track: Track, smoothed: str, truth: str) -> Group:
    blocks = list(track.layout)
    variables = {"time": _time(track.t)}
    variables |= {b.name: block_variable(b, track.value(b.name)) for b in blocks}
    covariance: Attributes = {
        "long_name": "covariance of the right perturbation, SI units and rad",
        **_orders(blocks, "state"),
    }
    # Two names for one length: xarray cannot work with a dimension that occurs twice.
    variables["covariance"] = Variable(("time", "state", "state_2"), track.P, covariance)
    if track.statics is not None:
        variables |= _statics_variables(track.statics)
    for state in derived_estimates(track).values():
        variables |= derived_variables(state.block, state.value, state.P, state.constant)
    variables |= innovation_variables(track.innovations)
    variables |= left_out_variables(track.left_out)
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
        "retired": " ".join(track.retired),
    }
    return Group(attributes, variables)


def _truth_group(truth: Truth, blocks: Mapping[str, Block]) -> Group:
    variables = {"time": _time(truth.t)}
    known = [n for n in truth.values if n in blocks and blocks[n].number is None]
    variables |= {name: block_variable(blocks[name], truth.values[name]) for name in known}
    named = {b.family: unnumbered(b) for b in blocks.values() if b.number is not None}
    parts = [(name, *number_in(name)) for name in truth.values]
    for family, block in named.items():
        own = {n: block.numbered(i) for n, f, i in parts if f == family and i is not None}
        if own:
            values, over = np.stack([truth.values[name] for name in own], axis=1), "time"
            if len(values) and (values == values[:1]).all():
                values, over = values[:1], "pass"
            variables |= family_variables(tuple(own.values()), values, over)
    variables |= _sigma_variables(truth)
    return Group({"source": truth.source}, variables)


#: How the name of the sigmas of a true block ends; they are (time, component), SI.
_SIGMA = "_sigma"


def _sigma_variables(truth: Truth) -> dict[str, Variable]:
    """How good a truth is itself, where it says so."""
    what: Attributes = {"long_name": "1-sigma of the truth itself, right perturbation, SI and rad"}
    return {
        f"{name}{_SIGMA}": Variable(("time", f"{name}_tangent"), sigma, what)
        for name, sigma in truth.sigmas.items()
    }


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
            flown = {b.name: b for b in (*blocks, *track.blocks, *track.controlled)}
            groups[flight] = _truth_group(track.truth, flown)
    if truth is not None:
        known = {b.name: b for b in (*blocks, *(b for t in tracks for b in t.blocks))}
        groups["truth"] = _truth_group(truth, known)
    for key in attributes:
        if key in _OWN:
            raise InputError(f"the attribute {key!r} is the format's own")
    order = json.dumps([track.name for track in tracks])
    own: Attributes = {"writer": f"relnav-graph {VERSION}", "tracks": order}
    groups[""] = Group({**attributes, **own})
    write_groups(path, _FORMAT, _VERSION, groups)


@dataclass(frozen=True)
class _StoredTrack:
    """The attributes of a track's group."""

    name: str
    kind: Kind
    status: Status
    message: str
    runtime_s: float
    rejected: Json[dict[str, Count]]
    downweighted: Json[dict[str, Count]] = field(default_factory=dict)
    smoothed: str = ""
    truth: str = ""
    controlled: str = ""
    cautions: Json[list[Caution]] = field(default_factory=list)
    retired: str = ""


@dataclass(frozen=True)
class _StoredFile:
    """The attributes of the file that are not the caller's."""

    tracks: Json[list[str]]


@dataclass(frozen=True)
class _StoredTruth:
    """The attributes of a truth's group."""

    source: str


def _json(attributes: Attributes) -> bytes:
    return json.dumps(attributes).encode()


def _group(path: str, groups: Mapping[str, Group], name: str) -> Group:
    if name not in groups:
        raise InputError(f"{path}: damaged: no group {name!r}; found {', '.join(groups)}")
    return groups[name]


def _variable(where: str, group: Group, name: str) -> Variable:
    if name not in group.variables:
        raise InputError(f"{where}: damaged: no variable {name!r}")
    return group.variables[name]


def _values(where: str, group: Group, name: str, shape: tuple[int, ...]) -> Array:
    """A variable of a shape; -1 stands for any length."""
    values = _variable(where, group, name).values
    if len(values.shape) != len(shape) or any(
        n not in (-1, m) for n, m in zip(shape, values.shape, strict=True)
    ):
        raise InputError(f"{where}/{name}: damaged: found {values.shape}, expected {shape}")
    return values


def _block_values(where: str, group: Group, block: Block, count: int) -> Array:
    if block.number is not None:
        ids, values = stored_family(where, group, block.family)
        at = np.flatnonzero(ids == block.number)
        if not len(at) or values.shape[::2] != (count, block.dim):
            found = f"{values.shape} of the ids {ids}"
            raise InputError(
                f"{where}/{block.family}: damaged: found {found}, expected {block.name} at {count}"
                f" times in {block.dim} components"
            )
        own: Array = values[:, at[0]]
        return own
    shape = (count, 4 if block.manifold == "SO3" else block.dim)
    return from_components(block, _values(where, group, block.name, shape))


def _layout(where: str, group: Group, covariance: str) -> Layout:
    """Of the blocks that a covariance names."""
    order = str(_variable(where, group, covariance).attributes.get("block_order", "")).split()
    blocks = []
    for key in order:
        name, number = number_in(key)
        block = block_of(where, name, _variable(where, group, name))
        blocks.append(block if number is None else block.numbered(number))
    return Layout(blocks)


def _stored_states(where: str, group: Group, layout: Layout, count: int) -> Array:
    columns = [np.zeros((count, 0))]
    columns += [_block_values(where, group, b, count).reshape(count, -1) for b in layout]
    return np.hstack(columns)


def _statics(where: str, group: Group, layout: Layout, count: int) -> Statics | None:
    """The static blocks of a group whose epochs, `count` of them, have a layout."""
    kept = {"static_covariance", "cross_covariance"} & set(group.variables)
    if not kept:
        return None
    own = _layout(where, group, "static_covariance")
    both = [b.name for b in own if b.name in layout]
    if both or not own:
        found = f"{both[0]!r}, a block of the epochs too" if both else "no block"
        raise InputError(f"{where}/static_covariance: damaged: block_order: found {found}")
    values = _variable(where, group, "static_covariance")
    rows = 1 if values.dimensions[:1] == ("pass",) else count
    x = _stored_states(where, group, own, rows)
    P = _values(where, group, "static_covariance", (rows, own.dim, own.dim))
    cross = _values(where, group, "cross_covariance", (count, layout.dim, own.dim))
    x, P = (np.broadcast_to(a, (count, *a.shape[1:])) for a in (x, P))
    return Statics(own, x, P, cross)


def _track(path: str, groups: Mapping[str, Group], name: str, nested: bool = False) -> Track:
    where, group = f"{path}, {name}", _group(path, groups, name)
    a = check_json(where, _json(group.attributes), _StoredTrack)
    layout = _layout(where, group, "covariance")
    t = _values(where, group, "time", (-1,))
    if nested and a.smoothed:
        raise InputError(f"{where}: damaged: smoothed: found {a.smoothed!r}, of a smoothed track")
    truth = _group(path, groups, a.truth) if a.truth else None
    controlled = a.controlled.split() if truth is not None else []
    return Track(
        name=a.name,
        kind=a.kind,
        layout=layout,
        t=t,
        x=_stored_states(where, group, layout, len(t)),
        P=_values(where, group, "covariance", (len(t), layout.dim, layout.dim)),
        status=a.status,
        message=a.message,
        runtime_s=a.runtime_s,
        step_s=_values(where, group, "step_s", (-1,)) if "step_s" in group.variables else None,
        rejected=a.rejected,
        downweighted=a.downweighted,
        smoothed=_track(path, groups, a.smoothed, True) if a.smoothed else None,
        truth=_truth(f"{path}, {a.truth}", truth) if truth is not None else None,
        controlled=tuple(
            block_of(where, n, _variable(where, truth, n)) for n in controlled if truth is not None
        ),
        left_out=stored_left_out(where, group),
        innovations=stored_innovations(where, group),
        retired=tuple(a.retired.split()),
        cautions=tuple(a.cautions),
        statics=_statics(where, group, layout, len(t)),
    )


def _truth(where: str, group: Group) -> Truth:
    t = _values(where, group, "time", (-1,))
    values: dict[str, Array] = {}
    sigmas: dict[str, Array] = {}
    for name, variable in group.variables.items():
        if name.endswith(_SIGMA) and "manifold" not in variable.attributes:
            sigmas[name.removesuffix(_SIGMA)] = _values(where, group, name, (len(t), -1))
        if "manifold" not in variable.attributes:
            continue  # the times, and the ids of a family
        block = block_of(where, name, variable)
        if variable.values.ndim < 3:
            values[name] = _block_values(where, group, block, len(t))
            continue
        ids, rows = stored_family(where, group, name)
        for i in ids.tolist():
            own = block.numbered(i)
            known = _block_values(where, group, own, len(rows))
            values[own.name] = at_all_times(known[0], len(t)) if len(rows) == 1 else known
    source = check_json(where, _json(group.attributes), _StoredTruth).source
    return Truth(t, values, source, sigmas)


def read_results(
    path: str | os.PathLike[str],
) -> tuple[list[Track], Truth | None, dict[str, str]]:
    """Tracks, truth and the attributes that :func:`write_results` was given.

    Raises InputError on a file that is missing, truncated, damaged, of another program or
    of another version.
    """
    groups, file = read_groups(path, _FORMAT, _VERSION), os.fspath(path)
    attributes = groups[""].attributes
    names = check_json(file, _json(attributes), _StoredFile).tracks
    tracks = [_track(file, groups, name) for name in names]
    truth = _truth(f"{file}, truth", groups["truth"]) if "truth" in groups else None
    return tracks, truth, {k: str(v) for k, v in attributes.items() if k not in _OWN}
