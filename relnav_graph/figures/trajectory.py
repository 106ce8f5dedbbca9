"""The path of the chaser relative to the target, in three planes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.contracts import Derived
from relnav_graph.core.track import Track, Truth
from relnav_graph.figures.style import (
    PAGE,
    STYLE,
    Look,
    chosen_rows,
    component,
    row_styles,
    symbol,
)
from relnav_graph.scoring.deviations import estimates, finite

__all__ = ["trajectory_figure"]

#: Planes: which component lies along the horizontal axis, and which along the vertical one.
_PLANES = ((1, 0), (1, 2), (0, 2))


def trajectory_figure(
    tracks: Iterable[Track],
    truth: Truth | None,
    derived: Sequence[Derived] = (),
    draw: Sequence[str] = (),
    look: Look = PAGE,
) -> Figure | None:
    """The relative position in the three planes of its frame, with truth where known.

    Limits follow truth, or else the first track; draw: rows, see `chosen_rows`. None when no track
    has the position.
    """
    rows, paths, block = chosen_rows(tracks, draw), list[tuple[Array, Mapping[str, Any]]](), None
    derived = [quantity for quantity in derived if quantity.block.name == RELATIVE_POSITION.name]
    for name, style in row_styles({n: track.kind for n, track in rows.items()}).items():
        estimate = estimates(rows[name], derived).get(RELATIVE_POSITION.name)
        if estimate is not None and finite(estimate.value).any():
            block = estimate.block
            paths.append((estimate.value, style))
    if block is None:
        return None
    if truth is not None and RELATIVE_POSITION.name in truth.values:
        true = truth.values[RELATIVE_POSITION.name]
        paths.insert(0, (true, {"label": "truth", "color": "black", "linewidth": 1.8}))
    with mpl.rc_context(STYLE):
        figure, axes = _planes(look, len(paths))
        for ax, (h, v) in zip(axes, _PLANES, strict=True):
            _draw_plane(ax, paths, h, v)
            ax.set_xlabel(component(block, h), labelpad=1)
            ax.set_ylabel(component(block, v), labelpad=1)
        if look.titled:
            title = f"Relative position {symbol(block)} in frame {block.frame[-1:]}"
            axes[0].set_title(title, loc="left", pad=5)
        handles: list[Any] = [Line2D([], [], **style) for _, style in paths]
        marks, labels = axes[0].get_legend_handles_labels()
        own = dict(zip(labels, marks, strict=True))
        handles += [own[mark] for mark in ("start", "end", "target")]
        columns = look.legend_columns([str(h.get_label()) for h in handles])
        figure.legend(handles=handles, loc="upper center", ncols=columns, borderaxespad=0.3)
    return figure


def _planes(look: Look, paths: int) -> tuple[Figure, list[Axes]]:
    """Three square panels: side by side in a page, one below the other in a column."""
    beside = look.width > 5
    side, gap = (1.75, 0.55) if beside else (look.width - 0.95, 0.5)
    top = 0.2 + 0.165 * -(-(paths + 3) // (5 if beside else 2)) + (0.2 if look.titled else 0.05)
    high = top + (1 if beside else 3) * side + (0 if beside else 2) * gap + 0.45
    figure = Figure(figsize=(look.width, high))
    axes = []
    for k in range(3):
        left = 0.62 + (k * (side + gap) if beside else 0)
        bottom = high - top - side - (0 if beside else k * (side + gap))
        width = side / look.width
        ax = figure.add_axes((left / look.width, bottom / high, width, side / high))
        ax.xaxis.set_major_locator(MaxNLocator(4))
        ax.yaxis.set_major_locator(MaxNLocator(4))
        axes.append(ax)
    return figure, axes


def _draw_plane(ax: Axes, paths: Sequence[tuple[Array, Mapping[str, Any]]], h: int, v: int) -> None:
    for r, style in paths:
        ax.plot(r[:, h], r[:, v], **style)
    r = next(r for r, _ in paths if finite(r).any())
    r = r[finite(r)]
    middle, half = (r.max(axis=0) + r.min(axis=0)) / 2, 0.58 * np.ptp(r, axis=0).max() or 1.0
    ax.set(xlim=(middle[h] - half, middle[h] + half), ylim=(middle[v] - half, middle[v] + half))
    ax.set_aspect("equal")
    for point, marker, label in ((r[0], "o", "start"), (r[-1], "s", "end")):
        ax.plot(point[h], point[v], marker, color="black", markersize=4, zorder=6, label=label)
    ax.plot(0, 0, "+", color="black", markersize=8, zorder=6, label="target")
