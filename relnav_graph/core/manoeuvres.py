"""Manoeuvres: thrust that is known, but for the covariance of what it misses.

As an input of a process, thrust is an acceleration and a covariance density of white noise on it,
means over intervals, in the axes in which the process has its velocity. Both add up over time to
what a table of manoeuvres says: a change of velocity, and its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import SAME_TIME, InputSeries
from relnav_graph.errors import InputError

__all__ = ["COVARIANCE", "IMPULSE", "THRUST_COLUMNS", "thrust_series"]

_PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
#: Columns of the input: acceleration, and the covariance density of its noise.
THRUST_COLUMNS = (
    *(f"a{axis}_m_s2" for axis in "xyz"),
    *(f"q{pair}_m2_s3" for pair in _PAIRS),
)
#: Where the numbers of a symmetric matrix (3, 3) stand in it, in the order of the columns.
COVARIANCE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
#: How long a step of the velocity takes, s.
IMPULSE = 1e-3


def _check(begin: float, end: float, covariance: Array, before: float) -> None:
    """Raise InputError where a manoeuvre from `begin` to `end`, s, ends before it begins, begins
    before the one `before` it has ended, s, or has a covariance (3, 3), m^2/s^2, that is none."""
    if not end > begin:
        raise InputError(f"found a manoeuvre from {begin} s to {end} s, expected a later end")
    if begin < before - SAME_TIME:
        raise InputError(
            f"found a manoeuvre from {begin} s on, expected the one before, until {before} s, to be"
            " over"
        )
    largest = np.abs(covariance).max()
    if np.linalg.eigvalsh(covariance).min() < -1e-9 * largest:
        raise InputError(f"found the covariance {covariance.tolist()} m^2/s^2, which no error has")


def thrust_series(
    name: str,
    t_start: Array,
    t_end: Array,
    delta_v: Array,
    covariance: Array,
    t_first: float,
    t_last: float,
    where: Sequence[str] | None = None,
) -> InputSeries:
    """The input that n manoeuvres are, in order of time; between them there is no thrust.

    name: of the input; t_start, t_end (n,): s; delta_v (n, 3): m/s, spread evenly over its time;
    covariance (n, 3, 3): of what delta_v misses, m^2/s^2, in the same axes; t_first, t_last: what
    the input tells of, s, extended to the manoeuvres; where: each of them in words, for messages.
    Raises InputError where one ends before it begins, begins before the one before has ended, or
    has a covariance that is none.
    """
    words = where or [f"input {name!r}, manoeuvre {k}" for k in range(len(t_start))]
    coasting, upper = np.zeros(len(THRUST_COLUMNS)), np.triu_indices(3)
    starts, ends, values = list[float](), list[float](), list[Array]()
    before, now = -np.inf, min([t_first, *t_start])

    def add(begin: float, end: float, thrust: Array) -> None:
        starts.append(begin)
        ends.append(end)
        values.append(thrust)

    for place, begin, end, dv, P in zip(words, t_start, t_end, delta_v, covariance, strict=True):
        try:
            _check(begin, end, P, before)
        except InputError as error:
            raise InputError(f"{place}: {error}") from error
        if begin > now:
            add(now, begin, coasting)
        add(begin, end, np.concatenate([dv, P[upper]]) / (end - begin))
        before = now = end
    if t_last > now:
        add(now, t_last, coasting)
    return InputSeries(name, np.array(starts), np.array(ends), np.array(values))
