"""Blocks, and families of numbered ones such as the points of a map, as variables of a group of a
NetCDF file, with their definitions beside the numbers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.numbered import unnumbered
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.io.netcdf import Attributes, Group, Variable
from relnav_graph.io.stored import check_json
from relnav_graph.io.tabular import component_columns, tangent_columns, to_components

__all__ = [
    "block_of",
    "block_variable",
    "derived_variables",
    "family_variables",
    "stored_family",
]


def _definition(block: Block) -> Attributes:
    """A block as attributes."""
    quaternion = block.manifold == "SO3"
    what = ", Hamilton quaternion, scalar first (q_wxyz)" if quaternion else ""
    return {
        "units": "1" if quaternion else block.unit,
        "long_name": f"{block.name.replace('_', ' ')} {block.symbol}{what}",
        "symbol": block.symbol,
        "manifold": block.manifold,
        "tangent_dim": block.dim,
        "tangent_units": block.unit,
        "frame": block.frame,
        "table_units": block.table_unit,
        "component_names": " ".join(component_columns(block)),
    }


def block_variable(block: Block, values: Array, over: str = "time") -> Variable:
    """A block over time, or over the pass, with its definition in the attributes."""
    components = to_components(block, values)
    return Variable((over, f"{block.name}_component"), components, _definition(block))


def derived_variables(block: Block, values: Array, P: Array, constant: bool) -> dict[str, Variable]:
    """A derived quantity, (N, 3, 3) or (N, dim), with its covariance P (N, dim, dim), over time, or
    over the pass where it is constant and all epochs say the same."""
    one = constant and len(values) > 1 and bool((values == values[:1]).all() and (P[:1] == P).all())
    if one:
        values, P = values[:1], P[:1]
    over, tangent = "pass" if one else "time", f"{block.name}_tangent"
    what: Attributes = {
        "units": f"{block.unit}^2",
        "long_name": f"covariance of {block.name}, right perturbation",
        "component_names": " ".join(tangent_columns(block)),
    }
    return {
        block.name: block_variable(block, values, over),
        f"{block.name}_covariance": Variable((over, tangent, f"{tangent}_2"), P, what),
    }


@dataclass(frozen=True)
class _StoredBlock:
    """The attributes of a block's variable that are read back."""

    symbol: str
    manifold: Literal["SO3", "vector"]
    tangent_dim: Annotated[int, Field(ge=1, le=1000)]
    tangent_units: str
    frame: str
    table_units: str


def block_of(where: str, name: str, variable: Variable) -> Block:
    """The block of a variable, without a number."""
    a = check_json(f"{where}/{name}", json.dumps(variable.attributes).encode(), _StoredBlock)
    try:
        return Block(
            *(name, a.symbol, a.manifold, a.tangent_dim),
            *(a.tangent_units, a.frame, a.table_units),
        )
    except RelnavError as error:
        raise InputError(f"{where}/{name}: damaged: {error}") from error


def _id_name(family: str) -> str:
    """The dimension, and its variable, that says which block is which."""
    return f"{family}_id"


def family_variables(
    blocks: tuple[Block, ...], values: Array, over: str, P: Array | None = None
) -> dict[str, Variable]:
    """Variables of a family: values (N, k, dim), ids (k,), and covariances P (N, k, dim, dim).

    over: the dimension of N.
    """
    family, number = blocks[0].family, _id_name(blocks[0].family)
    component = f"{family}_component"
    ids: Attributes = {
        "units": "1",
        "long_name": f"number of the {family}: its id",
    }
    found = {
        family: Variable((over, number, component), values, _definition(unnumbered(blocks[0]))),
        number: Variable((number,), np.array([float(b.number or 0) for b in blocks]), ids),
    }
    if P is not None:
        what: Attributes = {
            "units": f"{blocks[0].unit}^2",
            "long_name": f"covariance of each {family}; jointly: static_covariance",
        }
        dimensions = (over, number, component, f"{component}_2")
        found[f"{family}_covariance"] = Variable(dimensions, P, what)
    return found


def stored_family(where: str, group: Group, family: str) -> tuple[Indices, Array]:
    """Ids (k,) and values (N, k, dim) of a family of a group. Raises InputError on damaged ones."""
    number = _id_name(family)
    if number not in group.variables:
        raise InputError(f"{where}: damaged: no variable {number!r}")
    ids, values = group.variables[number].values, group.variables[family].values
    whole = ids.astype(np.int64) if np.isfinite(ids).all() else np.full(ids.shape, -1)
    if ids.ndim != 1 or (whole != ids).any() or (whole < 0).any() or len(set(whole)) < len(ids):
        raise InputError(f"{where}/{number}: damaged: found {ids}, expected numbers, each once")
    if values.ndim != 3 or values.shape[1] != len(ids):
        expected = f"(times, {len(ids)}, components)"
        raise InputError(f"{where}/{family}: damaged: found {values.shape}, expected {expected}")
    return whole, values
