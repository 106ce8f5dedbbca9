"""Tracks as CSV tables, for spreadsheets and programs that read nothing else."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.numbered import members
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.files import file_in
from relnav_graph.io.atomic import atomic
from relnav_graph.io.maps import family_table
from relnav_graph.io.tabular import (
    Format,
    component_columns,
    tangent_columns,
    to_components,
    write_table,
)
from relnav_graph.scoring.deviations import derived_estimates

__all__ = ["block_columns", "write_csv", "write_one"]


def write_csv(
    folder: str | os.PathLike[str], tracks: Sequence[Track], tables: Format = "csv"
) -> None:
    """One table per track, and per smoothed track: time, components, sigmas; SI and rad; of the
    blocks, and of what is derived of them, such as the relative attitude.

    Attitudes are quaternions, their sigmas rotation angles about the axes on the right of
    the frame's letters. Static blocks have a table ``NAME_statics`` of their own: one row without
    time where all epochs of the track say the same of them, as smoothers do; a family of numbered
    ones a table ``NAME_FAMILY`` with a row for each, by its id. Raises InputError
    when a file cannot be written, or would lie elsewhere, or when two would bear one name.
    """
    found: dict[str, dict[str, Array]] = {}
    for track in tracks:
        _add(found, track.name, track)
        if track.smoothed is not None:
            _add(found, f"{track.name}_smoothed", track.smoothed)
    files = {name: file_in(folder, f"{name}.{tables}") for name in found}
    for name, columns in found.items():
        with atomic(files[name]) as staged:
            write_table(staged, columns)


def write_one(path: Path, track: Track, tables: Format = "csv") -> None:
    """The table of one track as the file `path`, without its smoothed one; those of static blocks
    lie beside it, ``NAME_statics``, ``NAME_FAMILY``. Raises InputError as `write_csv`."""
    write_csv(path.parent, [replace(track, name=path.stem, smoothed=None)], tables)


def _add(tables: dict[str, dict[str, Array]], name: str, track: Track) -> None:
    """The tables of one track."""
    derived = derived_estimates(track).values()
    found = {name: {"t_s": track.t, **_columns(track, track.layout)}}
    for state in derived:
        if not state.constant:
            found[name] |= block_columns(state.block.name, state.block, state.value, state.P)
    if track.statics is not None:
        layout = track.statics.layout
        own = _columns(track, [b for b in layout if b.number is None])
        for state in derived:
            if state.constant:
                own |= block_columns(state.block.name, state.block, state.value, state.P)
        one = len(track.t) > 0 and all((c == c[0]).all() for c in own.values())
        if own:
            found[f"{name}_statics"] = (
                {n: c[:1] for n, c in own.items()} if one else {"t_s": track.t, **own}
            )
        for family, blocks in members(layout).items():
            values = np.stack([track.value(b.name) for b in blocks], axis=1)
            P = np.stack([track.covariance(b.name) for b in blocks], axis=1)
            found[f"{name}_{family}"] = family_table(track.t, blocks, values, P)
    for key, columns in found.items():
        if key in tables:
            raise InputError(f"{key!r} cannot name a table: taken twice")
        tables[key] = columns


def _columns(track: Track, blocks: Iterable[Block]) -> dict[str, Array]:
    """Components of blocks, and their sigmas, (N,) each."""
    columns = dict[str, Array]()
    for block in blocks:
        columns |= block_columns(
            block.name, block, track.value(block.name), track.covariance(block.name)
        )
    return columns


def block_columns(name: str, block: Block, value: Array, P: Array) -> dict[str, Array]:
    """Components (N,) of a state and their sigmas, by the names of columns: SI and rad; attitudes
    as quaternions, their sigmas angles about the axes on the right of their frame.

    value: (N, 3, 3) or (N, dim); P: (N, dim, dim). NaN is the sigma of what has none.
    """
    components = to_components(block, value)
    variances = np.diagonal(P, axis1=1, axis2=2)
    sigmas = np.sqrt(np.where(variances >= 0, variances, np.nan))
    columns = {
        f"{name}_{column}": values
        for column, values in zip(component_columns(block), components.T, strict=True)
    }
    for column, values in zip(tangent_columns(block), sigmas.T, strict=True):
        columns[f"sigma_{name}_{column}"] = values
    return columns
