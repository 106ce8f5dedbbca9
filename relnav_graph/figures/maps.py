"""The map of a target's unknown points, with errors and three sigmas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import POINT
from relnav_graph.core.numbered import number_in
from relnav_graph.core.track import Track, Truth
from relnav_graph.figures.style import (
    PAGE,
    STYLE,
    Look,
    chosen_rows,
    component,
    finite_peak,
    logarithmic,
    note_beyond,
    panels,
    row_styles,
    symbol,
    three_sigma,
)
from relnav_graph.scoring.deviations import finite
from relnav_graph.scoring.maps import family_scores

__all__ = ["map_figure"]

#: How far limits follow errors that stand out, in usual sizes (medians).
_EXCURSION = 6.0


@dataclass(frozen=True, eq=False)
class _MapRow:
    """The map of one track at its last epoch, mm or so: errors (k, 3), NaN where truth knows none,
    and sigma (k, 3), of the points `names`."""

    names: Sequence[str]
    e: Array
    sigma: Array
    style: Mapping[str, Any]


def _map_rows(rows: Mapping[str, Track], truth: Truth | None) -> dict[str, _MapRow]:
    found = dict[str, _MapRow]()
    styles = row_styles({name: track.kind for name, track in rows.items()})
    for name, track in rows.items():
        end = track.at(slice(-1, None))
        states, errors_of = family_scores(end, track.truth or truth)
        state = states.get(POINT.name)
        if state is None or not finite(state.value, state.P).all():
            continue
        names = [b.name for b in state.members]
        e = np.full((len(names), POINT.dim), np.nan)
        if POINT.name in errors_of:
            known = errors_of[POINT.name]
            at = [names.index(b.name) for b in known.members]
            e[at] = POINT.table_scale * known.e[0].reshape(-1, POINT.dim)
        variance = np.diagonal(state.P[0]).reshape(-1, POINT.dim)
        sigma = POINT.table_scale * np.sqrt(np.maximum(variance, 0))
        found[name] = _MapRow(names, e, sigma, styles[name])
    return found


def map_figure(
    tracks: Iterable[Track],
    truth: Truth | None,
    seen: Mapping[str, int] | None = None,
    draw: Sequence[str] = (),
    look: Look = PAGE,
) -> Figure | None:
    """Errors of the points of a map with 3-sigma, by point, as at the last epoch of each track.

    Points stand in order of how often they were seen; seen: that number, by name of the block;
    draw: rows, see `chosen_rows`. Where truth does not know a point: 1-sigma alone. None when no
    track has a finite map.
    """
    rows = _map_rows(chosen_rows(tracks, draw), truth)
    if not rows:
        return None
    counts = seen or {}
    names = list(dict.fromkeys(n for row in rows.values() for n in row.names))
    names.sort(key=lambda n: -counts.get(n, 0))
    known = any(np.isfinite(row.e).any() for row in rows.values())
    what = "error (truth − estimate)" if known else "1-sigma uncertainty"
    handles: list[Any] = [_dot(row.style) for row in rows.values()]
    with mpl.rc_context(STYLE):
        figure, axes = panels(
            POINT.dim + (1 if counts else 0),
            look,
            [*handles, *([three_sigma()] if known else [])],
            f"Map {symbol(POINT)}: {what}, in frame {POINT.frame}",
        )
        for axis in range(POINT.dim):
            _draw_map(axes[axis], rows, names, axis, known)
            axes[axis].set_ylabel(component(POINT, axis))
        if counts:
            times = [counts.get(n, 0) for n in names]
            axes[-1].bar(range(len(names)), times, color="0.6", zorder=2)
            axes[-1].set_ylabel("times seen")
        _name_points(axes[-1], names, bool(counts))
    return figure


def _name_points(ax: Axes, names: Sequence[str], counted: bool) -> None:
    ids = [str(number_in(n)[1]) for n in names]
    size = 6 if len(ids) <= _LABELLED else 3.5
    ax.set_xticks(range(len(ids)), ids, fontsize=size, rotation=90)
    ax.set_xlim(-0.7, len(ids) - 0.3)
    ax.set_xlabel("id of the point" + (", by how often it was seen" if counted else ""))


#: Points up to which their ids are legible below a panel; how many times larger than the smallest
#: errors others may be, so that a panel still holds them.
_LABELLED, _FAR_OFF = 80, 5.0


def _dot(style: Mapping[str, Any]) -> Line2D:
    marker = {"linestyle": "none", "marker": "o", "markersize": 3}
    return Line2D([], [], **{**style, **marker})


def _draw_map(
    ax: Axes, rows: Mapping[str, _MapRow], names: Sequence[str], axis: int, known: bool
) -> None:
    width, beyond = 0.8 / len(rows), dict[str, float]()
    if not known:
        logarithmic(ax)
    else:
        needs = [np.fmax(3 * r.sigma, np.abs(r.e))[:, axis] for r in rows.values()]
        sizes = [float(np.median(n)) for n in needs]
        # What lies far beyond the best, such as a filter that broke, must not crush it.
        near = [(n, m) for n, m in zip(needs, sizes, strict=True) if m <= _FAR_OFF * min(sizes)]
        limit = 1.15 * max(min(n.max(), _EXCURSION * m) for n, m in near) or 1.0
        ax.set_ylim(-limit, limit)
        peaks = {name: finite_peak(row.e[:, axis]) for name, row in rows.items()}
        beyond = {name: peak for name, peak in peaks.items() if peak > limit}
    for k, row in enumerate(rows.values()):
        x = np.array([names.index(n) for n in row.names]) + width * (k + 0.5) - 0.4
        dots: dict[str, Any] = {"color": row.style["color"], "linestyle": "none", "marker": "o"}
        if known:
            band = 3 * row.sigma[:, axis]
            light = {"color": row.style["color"], "alpha": 0.28, "linewidth": 0}
            ax.bar(x, 2 * band, width, -band, zorder=2, **light)
            ax.plot(x, row.e[:, axis], markersize=2.4, zorder=4, **dots)
        else:
            ax.plot(x, row.sigma[:, axis], markersize=2.4, zorder=4, **dots)
    if known:
        ax.axhline(0, color="0.4", linewidth=0.5, zorder=1.5)
    ax.grid(axis="x", visible=False)
    note_beyond(ax, beyond)
