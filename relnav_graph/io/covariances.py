"""Covariances of single observations, as columns of a sensor's table: ``cov_1_1``, ``cov_2_1``,
``cov_2_2``, ...: the lower triangle, row by row, of the rows of its residual, SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.io.tabular import Table

__all__ = ["covariance_columns", "covariances_in", "from_triangle", "of_measurements", "sigmas_of"]


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
    """The covariances (N, rows, rows) in a table, SI; None where it has no such columns. What is
    off the diagonal and has no column is zero.

    Raises InputError, naming file and line, where a variance has no column, or is not above zero,
    and where a covariance is not positive definite.
    """
    names = covariance_columns(rows)
    if not any(n in table.columns for n in names):
        return None
    variances = [f"cov_{i}_{i}" for i in range(1, rows + 1)]
    table.require(variances, tuple(table.columns))
    for name in variances:
        table.refuse(~(table[name] > 0), name, "a variance above zero")
    none = np.zeros(len(table.lines))
    found = from_triangle(np.column_stack([table.columns.get(n, none) for n in names]), rows)
    sigma = sigmas_of(found)
    scaled = found / (sigma[:, :, None] * sigma[:, None, :])  # rows of any units side by side
    ok = np.linalg.eigvalsh(scaled)[:, 0] > 0
    table.refuse(~ok, "cov_1_1", "the first entry of a positive definite covariance")
    return found


def sigmas_of(P: Array) -> Array:
    """The sigmas (N, n) of covariances (N, n, n)."""
    found: Array = np.sqrt(np.einsum("kii->ki", P))
    return found


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
