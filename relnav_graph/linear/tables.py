"""A pass as tables of numbers, for compiled code.

Compiled loops cannot follow Python objects. All numbers stand in one long array, and a row of
integers for each sensor, observation, process and interval says where its own numbers begin.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.compiled.contracts import (
    INDEX_MATRIX,
    INDEX_STACK,
    INDICES,
    VECTOR,
)

__all__ = [
    "TABLES",
    "Collected",
    "Tables",
    "rows_of",
]


class Tables(NamedTuple):
    """A pass for the compiled loops; the constants below name the columns.

    sensors (sensors, 9), observations (observations, 10), processes (processes, 14): a row for
    each; intervals (M, processes, 3): three for each interval and process; starts (M,): of
    the intervals, s; places: indices into a state or its tangent; numbers: constants of the
    models, data of the observations, whitening matrices and inputs, SI.
    """

    sensors: Indices
    observations: Indices
    processes: Indices
    intervals: Indices
    starts: Array
    places: Indices
    numbers: Array


TABLES = types.NamedTuple(
    (INDEX_MATRIX, INDEX_MATRIX, INDEX_MATRIX, INDEX_STACK, VECTOR, INDICES, VECTOR), Tables
)

# Columns of the tables. X is where a piece begins, X + 1 where it ends (for WHITEN and U_DATA:
# only where it begins). P, Q_DATA, Z_DATA, WHITEN and U_DATA point into the numbers; GATHER,
# COLUMNS, SCATTER and KINDS, and ROWS of a process, into the places.
ADDRESS, P, GATHER, COLUMNS = 0, 1, 3, 5  # of sensors and of processes
ROWS = 7  # of a sensor: number of rows of an observation; of a process: rows of F and Q
NUMBERED = 8  # of a sensor: size of the numbered block that each observation reads, 0 for none
SCATTER, WIDTH = 9, 11  # of processes: places of x_next; number of columns of u
KINDS = 12  # of processes: of the blocks advanced, see `relnav_graph.core.state.Layout.kinds`
SENSOR, EPOCH, ROW, Q_DATA, Z_DATA, WHITEN = 0, 1, 2, 3, 5, 7  # of observations
OWN_PLACE, OWN_COLUMN = 8, 9  # of an observation's own numbered block, where its sensor reads one
# Of intervals, for each process: where u begins, its number of rows, and whether their spreads
# (rows, channels) follow.
U_DATA, U_ROWS, SPREAD = 0, 1, 2


@jit
def rows_of(observations: Indices, sensors: Indices, first: int, i: int) -> tuple[int, int]:
    """Start and number of the rows of observation first + i, counted from the rows of `first`.

    observations: (observations, 10); sensors: (sensors, 9); see `Tables`.
    """
    one = observations[first + i]
    return one[ROW] - observations[first, ROW], sensors[one[SENSOR], ROWS]


class Collected:
    """Collects arrays into one long vector, and says where each of them stands in it."""

    def __init__(self, dtype: Any) -> None:
        self.dtype, self.size = dtype, 0
        self.parts: list[NDArray[Any]] = []

    def add(self, values: Any) -> tuple[int, int]:
        """Append values of any shape, row by row; returns where they begin and end."""
        part = np.ascontiguousarray(values, dtype=self.dtype).reshape(-1)
        self.parts.append(part)
        self.size += len(part)
        return self.size - len(part), self.size

    def array(self) -> Any:
        """All that was added, (size,)."""
        return np.concatenate([np.zeros(0, self.dtype), *self.parts])
