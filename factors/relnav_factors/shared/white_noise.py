"""What the process models share: intervals, and white noise integrated twice."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.maths import dense


@jit
def duration(u: Array) -> float:
    """Length of an interval, s: the sum over its sub-intervals.

    u: (rows, 1 + channels), the length of each sub-interval first, s.
    """
    out = 0.0
    for row in range(u.shape[0]):
        out += u[row, 0]
    return out


@jit
def step_count(length: float, longest: float) -> int:
    """Number of equal steps of at most `longest` in `length`; rounding adds none."""
    return max(1, int(np.ceil(length / longest - 1e-9)))


@jit
def add_driven_pair(Q: Array, value: int, rate: int, variance: float, h: float) -> None:
    """`add_integrated_white_noise` of one axis: its value and its rate stand anywhere in Q."""
    of_rate = variance * h
    joint = of_rate * h / 2
    Q[value, value] += joint * h * 2 / 3
    Q[value, rate] += joint
    Q[rate, value] += joint
    Q[rate, rate] += of_rate


@jit
def add_integrated_white_noise(Q: Array, row: int, variance: float, h: float) -> None:
    """Add to Q the noise of three axes whose rate is a random walk, over h seconds.

    Q: (n, n), changed in place: values stand at `row`, their rates at ``row + 3``; variance:
    squared density S of the white noise that drives the rates, such as m^2/s^3; h: s.

        Q_vv += S h^3 / 3,  Q_vr += S h^2 / 2,  Q_rr += S h

    After Bar-Shalom, Li, Kirubarajan 2001, eq. 6.2.2-12.
    """
    for i in range(row, row + 3):
        add_driven_pair(Q, i, 3 + i, variance, h)


@jit
def carry(step: Array, F: Array, Q: Array) -> None:
    """Over a step, in place: ``F <- step F``, ``Q <- step Q step^T``.

    step, Q: (n, n); F: (n, m), the sensitivity so far. Units: those of the state.
    """
    dense.put_block(F, 0, 0, dense.matmul(step, F), 1.0)
    dense.put_block(Q, 0, 0, dense.propagate_covariance(step, Q), 1.0)


@jit
def add_step(step: Array, variance: float, h: float, F: Array, Q: Array) -> None:
    """:func:`carry` over a step of h seconds, and the noise of the step itself.

    step, F, Q: (n, n); variance, h: as of `add_integrated_white_noise`, which drives the first
    three values and their rates, the next three.
    """
    carry(step, F, Q)
    add_integrated_white_noise(Q, 0, variance, h)


@jit
def put_advanced(total: Array, noise: Array, F: Array, Q: Array) -> None:
    """Fill F (n, m) and Q (n, n) with the first rows of total and noise, (m, m).

    A block that is constant is only read: it stands last and has no rows. Further columns of F are
    left as they are. Units: those of the state.
    """
    for i in range(Q.shape[0]):
        for j in range(total.shape[1]):
            F[i, j] = total[i, j]
        for j in range(Q.shape[0]):
            Q[i, j] = noise[i, j]
