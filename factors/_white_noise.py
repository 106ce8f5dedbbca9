"""What the process models share: intervals, and white noise integrated twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relnav_graph.compiled import jit_inner

Array = NDArray[np.float64]


@jit_inner
def duration(u: Array) -> float:
    """Length of an interval, s: the sum over its sub-intervals."""
    out = 0.0
    for row in range(u.shape[0]):
        out += u[row, 0]
    return out


@jit_inner
def step_count(length: float, longest: float) -> int:
    """Number of equal steps of at most `longest` in `length`; rounding adds none."""
    return max(1, int(np.ceil(length / longest - 1e-9)))


@jit_inner
def add_integrated_white_noise(Q: Array, row: int, variance: float, h: float) -> None:
    """Add the noise of three axes whose rate is a random walk, over h seconds.

    Values stand at `row`, their rates at ``row + 3``; variance: squared density of the
    white noise that drives the rates (Bar-Shalom, Li, Kirubarajan 2001, eq. 6.2.2-12).
    """
    for i in range(row, row + 3):
        Q[i, i] += variance * h**3 / 3
        Q[i, 3 + i] += variance * h**2 / 2
        Q[3 + i, i] += variance * h**2 / 2
        Q[3 + i, 3 + i] += variance * h
