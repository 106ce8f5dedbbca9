"""Noise that a table states row by row: columns of sigmas, or of a covariance.

For the residual rows of a sensor, named by its `residual_columns` (or else its `columns`), either

- ``sigma_NAME`` for each row, such as ``sigma_range_m``, or one ``sigma_UNIT`` for all rows of a
  unit, such as ``sigma_rad``: one sigma each, in that unit; or
- ``cov_I_J``, I >= J, rows counted from 1: the lower triangle of the covariance; what is off the
  diagonal and has no column is zero.

They stand in place of what the sensor says of its noise.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import NamesResiduals, Sensor
from relnav_graph.errors import InputError
from relnav_graph.io.covariances import covariance_columns, covariances_in
from relnav_graph.io.tabular import Table
from relnav_graph.units import column_unit

__all__ = ["noise_in", "noise_names"]


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
    sigmas = dict.fromkeys(choice for name in _rows(sensor) for choice in _choice(name))
    return (*sigmas, *covariance_columns(sensor.rows))


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
    return covariances_in(table, sensor.rows) if variances else _of_sigmas(table, sensor)


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
        table.refuse(~(table[given[0]] > 0), given[0], "a sigma above zero")
        R[:, i, i] = table[given[0]] ** 2
    return R
