"""Families of numbered blocks, such as the points of a map, in tables, and as files of their own
that programs for point clouds read."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Mapping

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.constants import VERSION
from relnav_graph.core.catalogue import POINT
from relnav_graph.core.numbered import members, unnumbered
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track
from relnav_graph.files import file_in
from relnav_graph.io.atomic import atomic
from relnav_graph.io.tabular import component_columns

__all__ = ["family_table", "write_map"]


def family_table(
    t: Array, blocks: tuple[Block, ...], values: Array, P: Array | None = None
) -> dict[str, Array]:
    """The table of a family: a row per block; where it changes over t (N,), s, per time and block.

    values (N, k, dim); P (N, k, dim, dim): adds the sigmas.
    """
    names = component_columns(unnumbered(blocks[0]))
    columns = dict(zip(names, np.moveaxis(values, -1, 0), strict=True))
    if P is not None:
        with np.errstate(invalid="ignore"):  # a diverged track: NaN says so
            sigmas = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
        columns |= {f"sigma_{n}": s for n, s in zip(names, np.moveaxis(sigmas, -1, 0), strict=True)}
    one = len(t) > 0 and all((c == c[:1]).all() for c in columns.values())
    rows = 1 if one else len(t)
    ids = np.tile([b.number for b in blocks], rows)
    times = {} if one else {"t_s": np.repeat(t, len(blocks))}
    return {**times, "id": ids, **{n: c[:rows].ravel() for n, c in columns.items()}}


#: Entries of a covariance that are written: the others follow from symmetry.
_ENTRIES = {f"cov_{'xyz'[i]}{'xyz'[j]}": (i, j) for i in range(3) for j in range(i, 3)}


def _map_columns(track: Track) -> dict[str, list[float]]:
    """x, y, z, m, sigmas, covariances of each point at the last epoch; {} without finite ones."""
    blocks = members(track.mapped).get(POINT.name, ())
    end = track.at(slice(-1, None))
    X = np.array([end.value(b.name)[0] for b in blocks]).reshape(-1, 3)
    P = np.array([end.covariance(b.name)[0] for b in blocks]).reshape(-1, 3, 3)
    if not len(X) or not (np.isfinite(X).all() and np.isfinite(P).all()):
        return {}
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    found = {a: X[:, k].tolist() for k, a in enumerate("xyz")}
    found |= {f"sigma_{a}": sigma[:, k].tolist() for k, a in enumerate("xyz")}
    found |= {n: P[:, i, j].tolist() for n, (i, j) in _ENTRIES.items()}
    return {"id": [b.number for b in blocks], **found}


def write_map(folder: str | os.PathLike[str], tracks: Mapping[str, Track]) -> None:
    """Write the map of each track as ``NAME_map.ply`` and ``NAME_map.csv``; of none without points.

    A row per point of the target, in t, as at the last epoch: x, y, z and 1-sigma, m, covariances,
    m^2. PLY is ASCII, with all of it as properties of the vertices. Raises InputError when a file
    cannot be written.
    """
    for name, track in tracks.items():
        columns = _map_columns(track)
        if not columns:
            continue
        rows = list(zip(*columns.values(), strict=True))
        with atomic(file_in(folder, f"{name}_map.ply")) as staged:
            staged.write_text(
                "\n".join([*_ply_header(columns, name), *_ply_rows(rows), ""]), "ascii"
            )
        with (
            atomic(file_in(folder, f"{name}_map.csv")) as staged,
            staged.open("w", encoding="utf-8", newline="") as stream,
        ):
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow([n if n == "id" else f"{n}_{_unit(n)}" for n in columns])
            writer.writerows([[row[0], *map(repr, row[1:])] for row in rows])


def _unit(name: str) -> str:
    return "m2" if name.startswith("cov_") else "m"


def _ply_header(columns: Mapping[str, list[float]], name: str) -> list[str]:
    label = name.encode("ascii", "backslashreplace").decode()
    properties = [f"property double {n}" for n in columns if n != "id"]
    return [
        "ply",
        "format ascii 1.0",
        f"comment relnav-graph {VERSION}: points of the target by {label}, frame t, m and m^2",
        f"element vertex {len(columns['id'])}",
        *properties,
        "property int id",
        "end_header",
    ]


def _ply_rows(rows: Iterable[tuple[float, ...]]) -> list[str]:
    return [" ".join([*map(repr, row[1:]), str(row[0])]) for row in rows]
