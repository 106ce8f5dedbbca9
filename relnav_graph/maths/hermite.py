"""Orbits between their states: Hermite interpolation through positions and velocities."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array

__all__ = ["between_states"]

#: States used for one: half before, half after; a polynomial of degree 7 goes through them.
_NODES = 4
#: How far an orbit may turn from state to state, rad: at 0.2 the polynomial is off by 1e-4 m in a
#: low orbit (its remainder is 8e-6 of the angle to the eighth power, times the radius).
_TURN = 0.2


def between_states(t: Array, state: Array, times: Array) -> Array:
    """States (M, 6), m and m/s, at times (M,), s, of an orbit's states (N, 6) at t (N,), s, in axes
    at rest: those of a time within half a nanosecond, else of the polynomial through the four
    nearest (as many as there are), positions and velocities alike, and its slope.

    NaN before the first, after the last, and where the orbit turns by more than 0.2 rad from state
    to state.
    """
    n, out = len(t), np.full((len(times), 6), np.nan)
    if not n:
        return out
    near = np.clip(np.searchsorted(t, times - 5e-10), 0, n - 1)
    same = np.abs(t[near] - times) < 5e-10
    out[same] = state[near[same]]
    k = np.searchsorted(t, times, side="right") - 1
    todo = np.flatnonzero(~same & (k >= 0) & (k < n - 1))
    k = k[todo]
    speed, radius = (np.linalg.norm(part, axis=1) for part in (state[k, 3:], state[k, :3]))
    todo = todo[(t[k + 1] - t[k]) * speed < _TURN * radius]
    if not len(todo):
        return out
    k, nodes = np.searchsorted(t, times[todo], side="right") - 1, min(_NODES, n)
    rows = np.clip(k - nodes // 2 + 1, 0, n - nodes)[:, None] + np.arange(nodes)
    rows = np.repeat(rows, 2, axis=1)  # each node twice: its value, and its slope
    z, origin = t[rows] - times[todo, None], state[rows[:, 0], :3]
    table = state[rows, :3] - origin[:, None]  # so that no digit is lost in large numbers
    slopes = state[rows, 3:]
    newton = [table[:, 0]]
    for order in range(1, 2 * nodes):
        gap = z[:, order:] - z[:, :-order]
        once = np.where(gap == 0.0, 1.0, gap)[..., None]
        table = np.diff(table, axis=1) / once
        if order == 1:
            table[:, ::2] = slopes[:, ::2][:, : table[:, ::2].shape[1]]
        newton.append(table[:, 0])
    value, slope = newton[-1], np.zeros_like(newton[-1])
    for order in range(2 * nodes - 2, -1, -1):  # at 0, where the times count from
        slope = value - z[:, order, None] * slope
        value = newton[order] - z[:, order, None] * value
    out[todo] = np.hstack([origin + value, slope])
    return out
