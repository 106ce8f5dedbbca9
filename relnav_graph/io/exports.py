"""Tracks for pandas and xarray, with what is derived of them and all sigmas."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.numbered import members
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.io.tabular import component_columns, tangent_columns, to_components
from relnav_graph.io.track_tables import block_columns
from relnav_graph.scoring.deviations import StateEstimates, estimates

__all__ = ["columns_of", "states_of", "to_dataframe", "to_xarray"]


def states_of(track: Track) -> dict[str, StateEstimates]:
    """Each state of a track by name, derived ones included (relative attitude, position in the
    target's frame, ...), but for numbered blocks: values (N, 3, 3) or (N, dim), P (N, dim, dim)."""
    plain = Layout([b for b in track.blocks if b.number is None])
    return estimates(track, derived_quantities(plain))


def _sigma(P: Array) -> Array:
    """Sigmas (N, dim) of covariances (N, dim, dim); NaN where there is none."""
    variance = np.diagonal(P, axis1=-2, axis2=-1)
    return np.sqrt(np.where(variance >= 0, variance, np.nan))


def columns_of(states: Mapping[str, StateEstimates]) -> dict[str, Array]:
    """Components of states, and their sigmas, (N,) each: see `block_columns`."""
    columns = dict[str, Array]()
    for name, state in states.items():
        columns |= block_columns(name, state.block, state.value, state.P)
    return columns


def _library(name: str, what: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        message = f"{what} needs {name}: pip install 'relnav-graph[data]'"
        raise InputError(message) from error


def to_dataframe(track: Track) -> Any:
    """A pandas.DataFrame: a row for each epoch, by time, t_s; `columns_of` says the columns.

    Derived quantities and constants are among them; points of a map are in `to_xarray`. Raises
    InputError without pandas.
    """
    pandas = _library("pandas", "to_dataframe")
    index = pandas.Index(np.asarray(track.t), name="t_s")
    return pandas.DataFrame(columns_of(states_of(track)), index=index)


def _variables(name: str, block: Block, value: Array, P: Array) -> dict[str, Any]:
    """A state as xarray's variables: components, sigmas and covariance over time."""
    said = {"long_name": f"{name.replace('_', ' ')} {block.symbol}", "frame": block.frame}
    parts, axes = f"{name}_component", f"{name}_axis"
    quaternion = block.manifold == "SO3"
    said["units"] = "1" if quaternion else block.unit
    tangent = {"units": block.unit, "frame": block.frame}
    labels = [
        c.removeprefix("q_") if quaternion else c.split("_")[0] for c in component_columns(block)
    ]
    turned = [c.split("_")[0] for c in tangent_columns(block)]
    return {
        name: (("time", parts), to_components(block, value), said),
        f"{name}_sigma": (("time", axes), _sigma(P), tangent),
        f"{name}_covariance": (("time", axes, f"{axes}_2"), P, {"units": f"({block.unit})^2"}),
        parts: ((parts,), labels),
        axes: ((axes,), turned),
        f"{axes}_2": ((f"{axes}_2",), turned),
    }


def to_xarray(track: Track) -> Any:
    """An xarray.Dataset over `time`, s: of each state NAME its components, SI (attitudes as
    quaternions, scalar first), `NAME_sigma` and `NAME_covariance`, with labels, units and frames.

    Derived quantities and constants are among them; of a family of numbered blocks FAMILY
    (time, FAMILY_id, component) and `FAMILY_sigma`. Raises InputError without xarray.
    """
    xarray = _library("xarray", "to_xarray")
    found: dict[str, Any] = {"time": (("time",), np.asarray(track.t), {"units": "s"})}
    for name, state in states_of(track).items():
        found |= _variables(name, state.block, state.value, state.P)
    for family, blocks in members(track.blocks).items():
        dims = ("time", f"{family}_id", f"{family}_component")
        values = np.stack([track.value(b.name) for b in blocks], axis=1)
        sigmas = np.stack([_sigma(track.covariance(b.name)) for b in blocks], axis=1)
        said = {"units": blocks[0].unit, "frame": blocks[0].frame}
        labels = [c.split("_")[0] for c in component_columns(blocks[0])]
        found |= {family: (dims, values, said), f"{family}_sigma": (dims, sigmas, said)}
        found |= {dims[1]: ((dims[1],), [b.number for b in blocks]), dims[2]: ((dims[2],), labels)}
    about = {"estimator": track.name, "kind": track.kind, "status": track.status}
    coordinates = [name for name, (dims, *_) in found.items() if dims == (name,)]
    return xarray.Dataset(found, attrs=about).set_coords(coordinates)
