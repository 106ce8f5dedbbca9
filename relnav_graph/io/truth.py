"""Truth tables of a data set: read, and brought to the epochs of the pass."""

from __future__ import annotations

import logging
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.state import UNIT_QUATERNION, Block, Layout
from relnav_graph.core.track import Truth, at_all_times
from relnav_graph.errors import InputError
from relnav_graph.io.tabular import (
    Table,
    component_columns,
    from_components,
    note,
    read_table,
    sigma_columns,
)

__all__ = ["at_epochs", "between", "block_like", "read_truth"]

_LOG = logging.getLogger(__name__)

#: Rows further apart than so many of the table's median steps have a gap between them.
_GAP = 1.5
#: Attitudes further apart than that, rad, may have turned either way in between.
_TURN = 2.0


def between(block: Block, t: Array, values: Array, times: Array, gap: float | None = None) -> Array:
    """Values at `times` (M,), s, between rows at t (N,), s: (N, ...) gives (M, ...).

    The cubic through the two rows before and the two after, in the tangent space of the row
    before (Lagrange; on SO(3) with two rows this is SLERP); of lower order where a row is
    missing there. NaN before the first row, after the last, in gaps (more than `gap`, s, by
    default 1.5 times the median step) and where an attitude turns by more than 2 rad from row to
    row.
    """
    n, out = len(t), np.full((len(times), *values.shape[1:]), np.nan)
    if n < 2:
        return out
    layout, x, step = Layout([block]), values.reshape(n, -1), np.diff(t)
    size = np.linalg.norm(layout.local(x[:-1], x[1:]), axis=1)
    near = step <= (_GAP * np.median(step) if gap is None else gap)
    if block.manifold == "SO3":
        near &= size <= _TURN
    k = np.searchsorted(t, times, side="right") - 1
    inside = np.flatnonzero((k >= 0) & (k < n - 1))
    inside = inside[near[k[inside]]]
    if not len(inside):
        return out
    k, tau = k[inside], times[inside]

    def joined(interval: Indices) -> Any:
        """Whether an interval beside is there, and not so short that it tells little of the
        slope and much of the noise."""
        there = (interval >= 0) & (interval < n - 1)
        j = np.clip(interval, 0, n - 2)
        short = step[j] < 0.5 * step[k]
        turned = (size[j] + size[k] > _TURN) & (block.manifold == "SO3")
        return there & near[j] & ~short & ~turned

    rows = np.clip(k + np.arange(-1, 3)[:, None], 0, n - 1)  # (4, m)
    used = np.array([joined(k - 1), k >= 0, k >= 0, joined(k + 1)])
    d = np.zeros((len(k), layout.dim))
    for j in range(4):
        weight = used[j].astype(np.float64)
        for m in range(4):
            if m != j:
                apart = np.where(used[j] & used[m], t[rows[j]] - t[rows[m]], 1.0)
                weight *= np.where(used[m], (tau - t[rows[m]]) / apart, 1.0)
        d += weight[:, None] * layout.local(x[k], x[rows[j]])
    out[inside] = layout.retract(x[k], d).reshape(len(k), *values.shape[1:])
    return out


def block_like(name: str, value: Array) -> Block:
    """What there is to know of true values (N, ...) that are of no block of the state: how to
    interpolate them."""
    turns = value.ndim == 3
    return Block(name, name, "SO3" if turns else "vector", value.shape[-1], "1", "-", "1")


def _table(folder: Path, block: Block, constant: bool, sort: bool, origin: float) -> Table | None:
    table = read_table(folder, f"truth_{block.name}", origin)
    if table is None:
        return None
    columns, sigmas = component_columns(block), sigma_columns(block)
    if constant and len(table.lines) == 1 and "t_s" not in table.columns:
        table.require(columns, sigmas)
    else:
        table.require(("t_s", *columns), sigmas)
        if sort:
            table = table.sorted_by("t_s")
        table.increasing("t_s")
    if block.manifold == "SO3":
        norm = np.linalg.norm(table.stack(columns), axis=1)
        table.refuse(
            np.abs(norm - 1) > UNIT_QUATERNION, "q_w", "a quaternion of length one within 1e-3"
        )
    return table


def _missed(block: Block, t: Array, values: Array) -> str:
    """By how much, in table units (a norm over the axes, rms), every second row is missed when
    it is left out and interpolated: far more than what lies between all rows is. In brackets;
    nothing of a table that has no such rows."""
    if len(t) < 3:
        return ""
    found = between(block, t[::2], values[::2], t[1::2])
    known = np.isfinite(found).all(axis=tuple(range(1, found.ndim)))
    if not known.any():
        return ""
    d = block.local(found[known], values[1::2][known])
    missed = block.table_scale * float(np.sqrt((d**2).sum(axis=1).mean()))
    return f" (left out, its own rows would be missed by {missed:.2g} {block.table_unit})"


def _say_others(folder: Path, known: Container[str]) -> None:
    """Say once which tables of truth are of no state of the pass, and are not read."""
    others = [p for p in sorted(folder.glob("truth_*")) if p.suffix in (".csv", ".parquet")]
    for path in others:
        if path.stem.removeprefix("truth_") not in known:
            note(f"{path}: not read: no state has that name")


def at_epochs(
    where: str, block: Block, t: Array, values: Array, epochs: Array, gap: float | None = None
) -> Array:
    """Values at `epochs` (M,), s, of rows at t (N,), s: (N, ...) gives (M, ...): of the row of that
    time, or between rows (`between`), NaN elsewhere. Says what is not of a row, as of `where`."""
    if not len(epochs):  # of a truth alone
        return values[:0]
    rows, same = Truth(t, {}).at(epochs)
    found = between(block, t, values, epochs, gap)
    made = np.isfinite(found.reshape(len(epochs), -1)).all(axis=1) & ~same
    if len(t):
        found[same] = values[rows[same]]
    if not (same | made).any():
        span = f", t = {t[0]:.9g} to {t[-1]:.9g} s," if len(t) else ""
        _LOG.warning(
            f"{where}: none of its {len(t)} rows{span} is at an epoch or about one, t ="
            f" {epochs[0]:.9g} to {epochs[-1]:.9g} s: it scores nothing"
        )
    elif not same.all():
        unknown = int((~(same | made)).sum())
        _LOG.info(
            f"{where}: of {len(epochs)} epochs {int(made.sum())} are between its rows and"
            f" interpolated{_missed(block, t, values)}, {unknown} are outside or in gaps"
        )
    return found


def read_truth(
    folder: Path,
    blocks: Mapping[str, Block],
    epochs: Array,
    source: str,
    statics: Container[str] = (),
    numbered: Mapping[str, Block] | None = None,
    gap: float | None = None,
    sort: bool = False,
    origin: float = 0.0,
) -> Truth | None:
    """Truth of those of `blocks` that have a table ``truth_NAME``, at all their times, and at the
    `epochs` (M,), s, between them.

    source: where it is from; statics: names of static blocks, which are known at all times where
    all rows of their table are the same; one row needs no time; numbered: families of numbered
    blocks, whose table has a row for each, by its id; gap: s, between rows further apart nothing is
    interpolated; sort: put rows in order of time; origin: s, taken off all times. Columns of sigmas
    (`sigma_columns`), all or none, say how good the truth itself is. None without any table. Raises
    InputError, naming file, line and column, on a table with other columns, times that do not
    increase, or a quaternion whose length is not one within 1e-3; it is normalised.
    """
    _say_others(folder, {*blocks, *(numbered or {})})
    found = {}
    for name, block in blocks.items():
        table = _table(folder, block, name in statics, sort, origin)
        if table is not None:
            known = from_components(block, table.stack(component_columns(block)))
            found[name] = table, known
    maps: dict[str, Array] = {}
    sigmas: dict[str, Array] = {}
    for name, block in (numbered or {}).items():
        table = read_table(folder, f"truth_{name}")
        if table is not None:
            points, their_sigmas = _members(table, block)
            maps, sigmas = maps | points, sigmas | their_sigmas
    if not found and not maps:
        return None
    timed = [table["t_s"] for table, _ in found.values() if "t_s" in table.columns]
    own = np.unique(np.concatenate([np.zeros(0), *timed]))
    lacking = epochs[~Truth(own, {}).at(epochs)[1]]
    times = np.sort(np.concatenate([own, lacking]))
    at, _ = Truth(times, {}).at(epochs)
    values = {}
    for name, (table, known) in found.items():
        sigma = table.sigmas(blocks[name])
        if sigma is not None:
            sigmas[name] = _sigmas_at(table, sigma, times)
        if name in statics and len(known) and (known == known[0]).all():
            values[name] = at_all_times(known[0], len(times))
            continue
        values[name] = np.full((len(times), *known.shape[1:]), np.nan)
        where = str(table.path)
        values[name][at] = at_epochs(where, blocks[name], table["t_s"], known, epochs, gap)
        values[name][np.searchsorted(times, table["t_s"])] = known
    values |= {name: at_all_times(X, len(times)) for name, X in maps.items()}
    tiled = {n: S if S.ndim > 1 else at_all_times(S, len(times)) for n, S in sigmas.items()}
    return Truth(times, values, source, tiled)


def _sigmas_at(table: Table, sigma: Array, times: Array) -> Array:
    """Sigmas (M, dim) at `times` (M,), s, of those of the rows (rows, dim), linear in between."""
    if "t_s" not in table.columns or not len(sigma):
        return np.tile(sigma[:1], (len(times), 1))
    return np.column_stack([np.interp(times, table["t_s"], one) for one in sigma.T])


def _members(table: Table, block: Block) -> tuple[dict[str, Array], dict[str, Array]]:
    """True values (dim,) of numbered blocks, and their sigmas (dim,) where given, by name."""
    columns = component_columns(block)
    table.require(("id", *columns), sigma_columns(block))
    if "t_s" in table.columns:
        raise InputError(
            f"{table.path}, line 1: found a column t_s, expected none: points are fixed"
        )
    ids = table["id"]
    whole = (ids >= 0) & (ids < 2.0**53) & (ids == np.rint(ids))
    table.refuse(~whole, "id", "a number of a block, 0 or more, below 2^53")
    first = np.unique(ids, return_index=True)[1]
    table.refuse(~np.isin(np.arange(len(ids)), first), "id", "each number once")
    names = [block.numbered(int(i)).name for i in ids]
    sigma = table.sigmas(block)
    rows = dict(zip(names, table.stack(columns), strict=True))
    return rows, {} if sigma is None else dict(zip(names, sigma, strict=True))
