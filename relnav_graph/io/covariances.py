"""Covariances of single observations, as columns of a sensor's table: ``cov_1_1``, ``cov_2_1``,
``cov_2_2``, ...: the lower triangle, row by row, of the rows of its residual, SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.io.tabular import Table

__all__ = ["covariance_columns", "covariances_in", "from_triangle", "of_measurements"]


def covariance_columns(rows: int) -> tuple[str, ...]:
    """Names of the columns of so many rows."""
    return tuple(f"cov_{i}_{j}" for i in range(1, rows + 1) for j in range(1, i + 1))


def from_triangle(values: Array, rows: int) -> Array:
    """Lower triangles (N, rows (rows + 1) / 2), row by row, as symmetric (N, rows, rows)."""
    out = np.zeros((len(values), rows, rows))
    i, j = np.tril_indices(rows)
    out[:, i, j] = values
    out[:, j, i] = values
    return out


def covariances_in(table: Table, rows: int) -> Array | None:
    """The covariances (N, rows, rows) in a table, SI; None where it has no such columns.

    Raises InputError where some are missing, or a variance is not above zero.
    """
    names = covariance_columns(rows)
    if not any(n in table.columns for n in names):
        return None
    table.require(names, tuple(table.columns))
    for i in range(1, rows + 1):
        table.refuse(~(table[f"cov_{i}_{i}"] > 0), f"cov_{i}_{i}", "a variance above zero")
    return from_triangle(table.stack(names), rows)


def of_measurements(name: str, measurements: Sequence[Measurement], rows: int) -> dict[str, Array]:
    """The columns (observations,) each of a sensor's measurements; none where none has its own.

    Raises InputError where some have one and others not.
    """
    found = [m.covariance for m in measurements]
    own = [P for P in found if P is not None]
    if not own:
        return {}
    if len(own) < len(found):
        k = next(k for k, P in enumerate(found) if P is None)
        raise InputError(
            f"sensor {name!r} at t = {measurements[k].t} s: found no covariance, but others of its"
            " measurements have one"
        )
    i, j = np.tril_indices(rows)
    values = np.concatenate(own)[:, i, j]
    return dict(zip(covariance_columns(rows), values.T, strict=True))
