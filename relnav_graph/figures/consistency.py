"""Whether estimates know how good they are, over the pass: NEES, NIS and residuals in strips."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.contracts import Derived
from relnav_graph.core.scored import InAxes
from relnav_graph.core.track import Innovations, Track, Truth
from relnav_graph.figures.style import (
    PAGE,
    STYLE,
    Look,
    chosen_rows,
    finish,
    logarithmic,
    panels,
    row_styles,
)
from relnav_graph.scoring.deviations import chi2_band, errors, joint, nees

__all__ = ["consistency_figure", "residual_figure"]

#: Most points of a strip: means over so many intervals of time, wider than a line in print.
_STRIPS = 120
#: About how many residual rows of a sensor are dots; of more, some are, and all that are rare.
_DOTS = 1500
#: Sigmas that a normal residual row leaves in 5 % and in 0.3 % of the cases.
_INSIDE, _RARE = 1.96, 3.0


def _edges(count: int) -> Indices:
    """First of each interval of `count` epochs, and their number: (intervals + 1,)."""
    return np.unique(np.linspace(0, count, min(count, _STRIPS) + 1).round().astype(np.int64))


def _means(t: Array, total: Array, freedoms: Array) -> tuple[Array, Array, Array]:
    """Of each interval the mean time, the squares per freedom, and the freedoms."""
    begin = _edges(len(t))[:-1]
    sums = [np.add.reduceat(v, begin) for v in (t, total, freedoms, np.ones(len(t)))]
    return sums[0] / sums[3], sums[1] / np.maximum(sums[2], 1), sums[2]


def _band(ax: Axes, t: Array, freedoms: Array) -> None:
    """The 95 % band of squares per freedom, of so many freedoms at each time."""
    kinds = np.maximum(freedoms.round().astype(int), 1)
    of = {n: chi2_band(int(n)) for n in np.unique(kinds)}
    low, high = np.array([of[n] for n in kinds]).T
    ax.fill_between(t, low, high, color="0.5", alpha=0.22, linewidth=0, zorder=1)
    ax.axhline(1, color="0.4", linewidth=0.5, zorder=1.5)


def _limit_ratio(ax: Axes) -> None:
    """From 0, or on a logarithmic scale where a row leaves the band by far."""
    shown = [np.asarray(line.get_ydata(), float) for line in ax.lines]
    values = np.concatenate([*shown, np.ones(1)])
    values = values[np.isfinite(values) & (values > 0)]
    if values.max() > 8:
        logarithmic(ax)
        ax.set_ylim(max(0.7 * values.min(), 1e-2), 1.5 * values.max())
    else:
        ax.set_ylim(0, 1.1 * max(float(values.max()), 2.0))


def joint_nees(
    track: Track, truth: Truth | None, derived: Sequence[Derived]
) -> tuple[Array, Array, Array] | None:
    """Times, NEES and freedoms, (N,) each, of all blocks of a track jointly; None where truth does
    not know them at all of its epochs."""
    true = track.truth or truth
    if true is None:
        return None
    instead = [quantity for quantity in derived if isinstance(quantity, InAxes)]
    e, P = joint(errors(track, true, instead).values(), track, track.layout)
    if len(e) != len(track.t) or not len(e):
        return None
    value, rank = nees(e, P)
    return track.t, value, rank.astype(np.float64)


def sensors_of(rows: Mapping[str, Track]) -> list[str]:
    """Sensors of which a row has innovations or residuals."""
    return list(
        dict.fromkeys(s for t in rows.values() for s, i in t.innovations.items() if len(i.t))
    )


def _draw_nis(ax: Axes, rows: Mapping[str, Track], styles: Mapping[str, Any], sensor: str) -> None:
    widest: tuple[Array, Array] | None = None
    for name, track in rows.items():
        i = track.innovations.get(sensor)
        if i is None or not len(i.t):
            continue
        t, ratio, freedoms = _means(i.t, i.nis, i.rows.astype(np.float64))
        ax.plot(t, ratio, **styles[name])
        if widest is None or len(t) > len(widest[0]):
            widest = t, freedoms
    if widest is not None:
        _band(ax, *widest)
    ax.set_ylabel(f"NIS, {sensor}")


def _handles(rows: Mapping[str, Track], styles: Mapping[str, Any]) -> list[Any]:
    band = Patch(facecolor="0.5", alpha=0.22, linewidth=0, label="95 % band")
    return [*(Line2D([], [], **styles[name]) for name in rows), band]


def consistency_figure(
    tracks: Iterable[Track],
    truth: Truth | None,
    derived: Sequence[Derived],
    draw: Sequence[str] = (),
    look: Look = PAGE,
) -> Figure | None:
    """Strips over time: joint NEES per freedom where truth knows the state, and NIS per row of each
    sensor, of filters their innovations, of smoothers their standardised residuals.

    With 95 % bands. NEES is drawn for each epoch, NIS as means over up to `_STRIPS` intervals, in
    the band of as many independent rows. draw: rows, see `chosen_rows`. None where there is nothing
    of either.
    """
    rows = chosen_rows(tracks, draw)
    styles = row_styles({name: track.kind for name, track in rows.items()})
    found = {name: joint_nees(track, truth, derived) for name, track in rows.items()}
    errors_of = {name: one for name, one in found.items() if one is not None}
    sensors = sensors_of(rows)
    count = bool(errors_of) + len(sensors)
    if not count:
        return None
    with mpl.rc_context(STYLE):
        title = "Consistency: mean squares per freedom and per residual row"
        drawn = {n: t for n, t in rows.items() if n in errors_of or sensors_of({n: t})}
        figure, axes = panels(count, look, _handles(drawn, styles), title)
        if errors_of:
            for name, (t, value, freedoms) in errors_of.items():
                axes[0].plot(t, value / np.maximum(freedoms, 1), **styles[name])
            _band(axes[0], t, freedoms)
            axes[0].set_ylabel("NEES")
        for ax, sensor in zip(axes[bool(errors_of) :], sensors, strict=True):
            _draw_nis(ax, rows, styles, sensor)
        for ax in axes:
            _limit_ratio(ax)
        finish(axes, next(iter(rows.values())).t)
    return figure


def _some(i: Innovations) -> tuple[Array, Array]:
    """Residual rows and their times; of many, rows at even distances and all that are rare."""
    t, every = np.repeat(i.t, i.rows), -(-len(i.v) // _DOTS)
    shown = (np.arange(len(t)) % every == 0) | (np.abs(i.v) > _RARE)
    return t[shown], i.v[shown]


def residual_figure(
    tracks: Iterable[Track], draw: Sequence[str] = (), look: Look = PAGE
) -> Figure | None:
    """Residual rows of each sensor over time, in sigmas of what is expected of them: innovations of
    filters, standardised residuals of smoothers. None without any."""
    rows = chosen_rows(tracks, draw)
    rows = {name: track for name, track in rows.items() if sensors_of({name: track})}
    if not rows:
        return None
    sensors, styles = sensors_of(rows), row_styles({n: t.kind for n, t in rows.items()})
    dot = {"linestyle": "none", "marker": ".", "markersize": 2.2, "alpha": 0.7, "linewidth": 0}
    with mpl.rc_context(STYLE):
        handles = [Line2D([], [], **{**styles[n], **dot, "markersize": 5}) for n in rows]
        title = "Residuals in their own sigmas: of many a part, and all beyond 3"
        figure, axes = panels(len(sensors), look, handles, title)
        for ax, sensor in zip(axes, sensors, strict=True):
            most = _RARE
            for name, track in rows.items():
                i = track.innovations.get(sensor)
                if i is not None and len(i.t):
                    t, v = _some(i)
                    ax.plot(t, v, **{**styles[name], **dot}, rasterized=True)
                    size = np.abs(v[np.isfinite(v)])
                    most = max(most, float(size.max(initial=0.0)))
            for level in (-_RARE, -_INSIDE, _INSIDE, _RARE):
                dash = "solid" if abs(level) == _RARE else (0, (4, 2))
                ax.axhline(level, color="0.45", linewidth=0.5, linestyle=dash, zorder=1.5)
            ax.set_ylim(-1.08 * min(most, 12.0), 1.08 * min(most, 12.0))
            ax.set_ylabel(f"{sensor} [sigma]")
        finish(axes, next(iter(rows.values())).t)
    return figure
