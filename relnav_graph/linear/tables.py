"""A pass as tables of numbers, for compiled code.

One row of integers per sensor, observation, process and interval says where each one's numbers
stand in one long array.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import types

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
    "Tables",
    "rows_of",
]


class Tables(NamedTuple):
    """A pass for the compiled loops; what the columns are stands below.

    sensors, observations, processes: one row each; intervals: one row each, of one pair for
    each process; starts: of the intervals, s; places: in the state; numbers: all others.
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

# Columns of the tables. X, X + 1: where X begins and ends, p, q, z, the whitening and u in
# the numbers, the others in the places.
ADDRESS, P, GATHER, COLUMNS = 0, 1, 3, 5  # of sensors and of processes
ROWS = 7  # of a sensor: rows of an observation; of a process: places of the rows of F and Q
SCATTER, WIDTH = 9, 11  # of processes; the width of u
SENSOR, EPOCH, ROW, Q_DATA, Z_DATA, WHITEN = 0, 1, 2, 3, 5, 7  # of observations
U_DATA, U_ROWS = 0, 1  # of intervals, one pair for each process


@jit
def rows_of(observations: Indices, sensors: Indices, first: int, i: int) -> tuple[int, int]:
    """Where the rows of observation first + i begin, counted from those of `first`, and how
    many they are."""
    one = observations[first + i]
    return one[ROW] - observations[first, ROW], sensors[one[SENSOR], ROWS]
