"""Noise that a table states row by row: columns of sigmas, or of a covariance.

For the residual rows of a sensor, named by its `residual_columns` (or else its `columns`), either

- ``sigma_NAME`` for each row, such as ``sigma_range_m``, or one ``sigma_UNIT`` for all rows of a
  unit, such as ``sigma_rad``: one sigma each, in that unit; or
- ``cov_I_J``, I >= J, rows counted from 1: the lower triangle of the covariance; what is off the
  diagonal and has no column is zero.

They stand in place of what the sensor says of its noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import NamesResiduals, Sensor
from relnav_graph.errors import InputError
from relnav_graph.io.tabular import Table
from relnav_graph.units import column_unit

__all__ = ["covariance_columns", "noise_in", "noise_names"]


def _rows(sensor: Sensor) -> tuple[str, ...]:
    """Names of the residual rows, with their units."""
    named = sensor.residual_columns if isinstance(sensor, NamesResiduals) else sensor.columns
    return named if len(named) == sensor.rows else ()


def _choice(row: str) -> tuple[str, ...]:
    """Columns that may state the sigma of a row: its own, or that of all rows of its unit."""
    unit = (column_unit(row) or "").replace("/", "_").replace("^", "")
    return (f"sigma_{row}", *([f"sigma_{unit}"] if unit else []))


def noise_names(sensor: Sensor) -> tuple[str, ...]:
    """All columns that may state the noise of a sensor's rows."""
    rows, n = _rows(sensor), range(1, sensor.rows + 1)
    sigmas = dict.fromkeys(choice for name in rows for choice in _choice(name))
    return (*sigmas, *(f"cov_{i}_{j}" for i in n for j in n[:i]))


def noise_in(table: Table, sensor: Sensor) -> Array | None:
    """Covariances (k, rows, rows) of the residuals of a table's k rows; None where it has no such
    column. Raises InputError, naming file and line, on columns that are missing, that say the same
    twice, and on sigmas and variances that are not above zero."""
    given = [name for name in noise_names(sensor) if name in table.columns]
    if not given:
        return None
    variances = [name for name in given if name.startswith("cov_")]
    if variances and len(variances) < len(given):
        found = f"both {given[0]!r} and {variances[0]!r}"
        raise InputError(f"{table.path}, line 1: found {found}, expected sigmas or a covariance")
    for name in given:
        if name not in variances or len(set(name.split("_")[1:])) == 1:
            table.refuse(~(table[name] > 0), name, "a value above zero")
    return _of_sigmas(table, sensor) if not variances else _of_triangle(table, sensor)


def _of_sigmas(table: Table, sensor: Sensor) -> Array:
    R = np.zeros((len(table.lines), sensor.rows, sensor.rows))
    for i, name in enumerate(_rows(sensor)):
        choice = _choice(name)
        given = [one for one in choice if one in table.columns]
        if len(given) != 1:
            found = f"both {' and '.join(given)}" if given else f"no column {choice[0]!r}"
            raise InputError(
                f"{table.path}, line 1: found {found}, expected {' or '.join(choice)}, since the"
                " table states the noise of other rows"
            )
        R[:, i, i] = table[given[0]] ** 2
    return R


def _of_triangle(table: Table, sensor: Sensor) -> Array:
    table.require([f"cov_{i}_{i}" for i in range(1, sensor.rows + 1)], tuple(table.columns))
    R = np.zeros((len(table.lines), sensor.rows, sensor.rows))
    for i in range(sensor.rows):
        for j in range(i + 1):
            name = f"cov_{i + 1}_{j + 1}"
            if name in table.columns:
                R[:, i, j] = R[:, j, i] = table[name]
    ok = np.array([np.linalg.eigvalsh(one)[0] > 0 for one in _scaled(R)], dtype=bool)
    table.refuse(~ok, "cov_1_1", "the first entry of a positive definite covariance")
    return R


def _scaled(R: Array) -> Array:
    """Correlations of covariances (k, n, n): rows of any units side by side."""
    sigma = np.sqrt(np.einsum("kii->ki", R))
    return np.asarray(R / (sigma[:, :, None] * sigma[:, None, :]))


def covariance_columns(R: Sequence[Array | None], counts: Sequence[int]) -> dict[str, Array]:
    """Columns of the covariances of measurements, each (k, rows, rows) with k of `counts`; {} where
    none has any. Raises InputError where some have and others do not: one table says it of all."""
    known = [one for one, k in zip(R, counts, strict=True) if one is not None and k]
    if not known:
        return {}
    if len(known) < sum(k > 0 for k in counts):
        raise InputError(
            f"found covariances of {len(known)} of {len(counts)} measurements of one sensor; a"
            " table states the noise of all rows or of none"
        )
    all_rows = np.concatenate(known)
    out = {}
    for i in range(all_rows.shape[1]):
        for j in range(i + 1):
            if i == j or all_rows[:, i, j].any():
                out[f"cov_{i + 1}_{j + 1}"] = all_rows[:, i, j]
    return out
