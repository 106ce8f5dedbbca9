"""A track as a figure: what is estimated over time, with its bands; errors where truth is known."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from relnav_graph.arrays import Array
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track, Truth
from relnav_graph.errors import InputError
from relnav_graph.figures import STYLE, WIDTH, png
from relnav_graph.figures.states import sigmas_of
from relnav_graph.io.exports import states_of
from relnav_graph.maths import dense, so3
from relnav_graph.scoring.deviations import StateEstimates, errors

__all__ = ["plot_track"]

#: States that fit on one page.
MOST = 6


class _Drawing(Figure):
    """A figure that a notebook shows, with pyplot or without."""

    def _repr_png_(self) -> bytes:
        return png(self, dpi=80)


def _angles(R: Array) -> Array:
    """Rotation vectors (N, 3), rad, of attitudes (N, 3, 3), without jumps of a whole turn."""
    vectors = dense.stacked((so3.log(m) for m in np.ascontiguousarray(R)), 3)
    for k in range(1, len(vectors)):
        angle = float(np.linalg.norm(vectors[k]))
        if angle > 0:  # the same attitude, whole turns about its axis away: the nearest
            along = vectors[k] / angle
            turns = np.rint((vectors[k - 1] @ along - angle) / (2 * np.pi))
            vectors[k] += 2 * np.pi * turns * along
    return vectors


def _of_estimate(state: StateEstimates) -> tuple[Array, Array]:
    """What is drawn of a state, and its sigma, (N, dim), in table units."""
    block, scale = state.block, state.block.table_scale
    value = _angles(state.value) if block.manifold == "SO3" else state.value
    return scale * value, sigmas_of(block, state.P)


def _chosen(track: Track, names: Sequence[str] | None) -> dict[str, StateEstimates]:
    states, names = states_of(track), [names] if isinstance(names, str) else names
    unknown = [name for name in names or () if name not in states]
    if unknown:
        raise InputError(f"plot: found {unknown[0]!r}, expected some of: {', '.join(states)}")
    return {name: states[name] for name in names or list(states)[:MOST]}


def _title(name: str, block: Block, what: str) -> str:
    unit = "" if block.table_unit == "1" else f", {block.table_unit}"
    form = ", rotation vector" if block.manifold == "SO3" and not what else ""
    return f"{name.replace('_', ' ')} {block.symbol}{form}{what}{unit}"


def plot_track(
    track: Track, names: Sequence[str] | None = None, truth: Truth | None = None
) -> Figure:
    """A matplotlib Figure with a panel for each state, in the units of tables, over time, s.

    names: of states, derived ones too (`Track.to_xarray` has them all), by default the first six.
    Each component has a band of 3 sigma. truth: draw errors, truth minus estimate, where it knows
    the state. The figure shows itself in a notebook; `savefig` writes it. Raises InputError on an
    unknown name.
    """
    states = _chosen(track, names)
    known = {} if truth is None else errors(track, truth, ())
    with mpl.rc_context(STYLE):
        size = (WIDTH, 0.6 + 1.5 * len(states))
        figure = _Drawing(figsize=size, layout="constrained")
        panels = figure.subplots(len(states), 1, sharex=True, squeeze=False)[:, 0]
        for ax, (name, state) in zip(panels, states.items(), strict=True):
            t, (value, sigma), what = track.t, _of_estimate(state), ""
            if name in known and len(known[name].t):
                own, what = known[name], ": error"
                t, value = own.t, state.block.table_scale * own.e
                sigma = sigma[np.isin(track.t, own.t)]
            for axis in range(state.block.dim):
                letter = "xyz"[axis] if state.block.dim <= 3 else str(axis + 1)
                (line,) = ax.plot(t, value[:, axis], linewidth=1.0, label=letter)
                low, high = value[:, axis] - 3 * sigma[:, axis], value[:, axis] + 3 * sigma[:, axis]
                ax.fill_between(t, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
            ax.set_title(_title(name, state.block, what), loc="left")
            ax.margins(x=0)
            ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), ncols=1)
        panels[-1].set_xlabel(f"time, s ({track.name}, {track.kind}; bands: 3 sigma)")
    return figure
