"""Figures of a comparison: errors with three-sigma bands, the trajectory, and the map.

Figures are built as objects, without pyplot, so that no global state is touched.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import POINT
from relnav_graph.core.contracts import Derived
from relnav_graph.core.numbered import number_in
from relnav_graph.core.state import Block
from relnav_graph.core.track import Kind, Track, Truth
from relnav_graph.scoring.deviations import errors, estimates, finite
from relnav_graph.scoring.maps import family_scores
from relnav_graph.scoring.metrics import with_smoothed

__all__ = [
    "STYLE",
    "WIDTH",
    "error_figures",
    "map_figure",
    "row_styles",
    "save_figures",
    "symbol",
    "trajectory_figure",
]


#: Distinct to colour-blind readers (Okabe and Ito 2008, last two added); black is truth.
_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#882255")
#: Of the tracks of one kind: equal ones stay visible below each other.
_DASHES = ("solid", (0, (5, 2)), (0, (2, 1.5)), (0, (1, 1)))
STYLE: dict[Any, Any] = {
    "font.size": 8,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "axes.titlesize": 9,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.92",
    "grid.linewidth": 0.5,
    "svg.hashsalt": "relnav-graph",  # the same figure gives the same file
}
#: Inches: two columns of a journal page.
WIDTH = 7.0
#: Part of the pass in which a filter may still converge, and how far limits then follow
#: excursions, in usual sizes (medians).
_TRANSIENT, _EXCURSION = 0.1, 6.0
#: Epochs above which a band is an image in an SVG: as a path it takes megabytes.
MANY = 5000


def row_styles(rows: Mapping[str, Kind]) -> dict[str, dict[str, Any]]:
    """How to draw each row, of its kind; smoothed estimates are heavier and on top."""
    styles: dict[str, dict[str, Any]] = {}
    kinds = list(rows.values())
    for k, (name, kind) in enumerate(rows.items()):
        styles[name] = {
            "label": f"{name} ({kind})",
            "color": _COLOURS[k % len(_COLOURS)],
            "linestyle": _DASHES[kinds[:k].count(kind) % len(_DASHES)],
            "linewidth": 0.8 if kind == "filtered" else 1.2,
            "zorder": 3 if kind == "filtered" else 4,
        }
    return styles


@dataclass(frozen=True, eq=False)
class _Line:
    """One state of one track in table units: t (N,) s, sigma (N, dim), e where known; constant:
    whether it is one of the pass."""

    name: str
    track: Track
    block: Block
    style: Mapping[str, Any]
    t: Array
    sigma: Array
    e: Array | None
    constant: bool

    def reach(self, axis: int) -> Array:
        """How far the error or its 3-sigma band reaches, (N,); 0 where not finite."""
        error = np.zeros_like(self.sigma) if self.e is None else np.abs(self.e)
        return np.nan_to_num(np.fmax(3 * self.sigma, error)[:, axis], posinf=0.0)


def _lines(
    tracks: Iterable[Track], truth: Truth | None, derived: Sequence[Derived]
) -> dict[str, list[_Line]]:
    rows, lines = with_smoothed(tracks), dict[str, list[_Line]]()
    styles = row_styles({name: track.kind for name, track in rows.items()})
    for name, track in rows.items():
        true = track.truth or truth
        known = {} if true is None else errors(track, true, derived)
        for state, x in estimates(track, derived).items():
            t, P, e, scale = track.t, x.P, None, x.block.table_scale
            if state in known and len(known[state].t):
                t, P, e = known[state].t, known[state].P, scale * known[state].e
            variance = np.diagonal(P, axis1=1, axis2=2)
            sigma = scale * np.sqrt(np.where(variance >= 0, variance, np.nan))
            line = _Line(name, track, x.block, styles[name], t, sigma, e, x.constant)
            lines.setdefault(state, []).append(line)
    return lines


def symbol(block: Block) -> str:
    """The symbol of a block as mathematics."""
    head, *letters = block.symbol.split("_")
    return f"${head}" + "".join(f"{a}{{{b}}}" for a, b in zip("_^", letters, strict=False)) + "$"


def _label(block: Block, axis: int) -> str:
    """Component of a vector, or axis of an attitude error, with its frame and unit."""
    letter = "xyz"[axis] if block.dim <= 3 else str(axis + 1)
    unit = "" if block.table_unit == "1" else f" [{block.table_unit}]"
    return f"${letter}_{{{block.frame[-1:]}}}${unit}"


def _limit(lines: Sequence[_Line], axis: int) -> float:
    """Half the height of a panel: what errors and bands need once filters converged.

    A diverged track, or a short excursion, must not crush the others.
    """
    needs = []
    for line in [x for x in lines if x.track.status != "diverged"] or lines:
        reach = line.reach(axis)[line.t >= line.t[0] + _TRANSIENT * np.ptp(line.t)]
        needs.append(min(reach.max(), _EXCURSION * float(np.median(reach))))
    return 1.3 * max(needs) or 1.0  # room for the note of what is off scale


def _draw_errors(ax: Axes, lines: Sequence[_Line], axis: int) -> None:
    for line in lines:
        band, thin = 3 * line.sigma[:, axis], {**line.style, "linewidth": 0.5, "zorder": 2}
        shade = 0.26 / max(2, len(lines))  # many bands must not add up to mud
        filled = ax.fill_between(line.t, -band, band, color=thin["color"], alpha=shade, linewidth=0)
        filled.set_rasterized(len(line.t) > MANY)
        ax.plot(line.t, np.column_stack([-band, band]), **thin)
        if line.e is not None:
            ax.plot(line.t, line.e[:, axis], **line.style)
    limit = _limit(lines, axis)
    ax.set_ylim(-limit, limit)
    ax.axhline(0, color="0.4", linewidth=0.5, zorder=1.5)
    peaks = {line.name: float(line.reach(axis).max()) for line in lines}
    beyond = [f"{name} to {float(f'{p:.2g}'):g}" for name, p in peaks.items() if p > limit]
    if beyond:
        _note(ax, beyond)


def _note(ax: Axes, beyond: Sequence[str]) -> None:
    """Say in a panel what is off its scale."""
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1}
    note = ax.text(0.995, 0.97, "off scale: " + ", ".join(beyond), transform=ax.transAxes)
    note.set(fontsize=6, color="0.25", ha="right", va="top", zorder=6, bbox=box)


def _state_figure(state: str, lines: Sequence[_Line]) -> Figure:
    block, known = lines[0].block, lines[0].e is not None
    figure = Figure(figsize=(WIDTH, 1.0 + 1.35 * block.dim), layout="constrained")
    panels = figure.subplots(block.dim, 1, sharex=True, squeeze=False)[:, 0]
    for axis, ax in enumerate(panels):
        ax.set_ylabel(_label(block, axis))
        ax.margins(x=0)
        if known:
            _draw_errors(ax, lines, axis)
            continue
        for line in lines:
            ax.semilogy(line.t, line.sigma[:, axis], **line.style)
    aimed = block in lines[0].track.controlled
    known_as = "error (truth − aim)" if aimed else "error (truth − estimate)"
    what = known_as if known else "1-sigma uncertainty"
    where = "about the axes of" if block.manifold == "SO3" else "in"
    constant = ", a constant" if lines[0].constant else ""
    title = f"{state.replace('_', ' ').capitalize()} {symbol(block)}{constant}: {what}"
    panels[0].set_title(f"{title}, {where} frame {block.frame[-1:]}", loc="left")
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    handles: list[Any] = [Line2D([], [], **line.style) for line in lines]
    if known and not aimed:  # a control error has no sigma
        handles.append(_three_sigma())
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


def _three_sigma() -> Patch:
    return Patch(facecolor="0.85", edgecolor="0.5", linewidth=0.5, label="±3 sigma")


def error_figures(
    tracks: Iterable[Track], truth: Truth | None, derived: Sequence[Derived]
) -> dict[str, Figure]:
    """A figure per state, in table units: a panel per axis, with error and 3-sigma band.

    Where truth does not know the state: 1-sigma alone, on a logarithmic scale. Limits
    leave out transients and diverged tracks; a note in the panel says so. Raises
    InputError as :func:`relnav_graph.scoring.metrics.errors` does.
    """
    with mpl.rc_context(STYLE):
        lines = _lines(tracks, truth, derived)
        return {state: _state_figure(state, found) for state, found in lines.items()}


def trajectory_figure(
    tracks: Iterable[Track], truth: Truth | None, derived: Sequence[Derived] = ()
) -> Figure | None:
    """The relative position in the three planes of its frame, with truth where known.

    Limits follow truth, or else the first track. None when no track has the position.
    """
    rows, paths, block = with_smoothed(tracks), list[tuple[Array, Mapping[str, Any]]](), None
    for name, style in row_styles({n: track.kind for n, track in rows.items()}).items():
        estimate = estimates(rows[name], derived).get("relative_position")
        if estimate is not None and finite(estimate.value).any():
            block = estimate.block
            paths.append((estimate.value, style))
    if block is None:
        return None
    if truth is not None and "relative_position" in truth.values:
        true = truth.values["relative_position"]
        paths.insert(0, (true, {"label": "truth", "color": "black", "linewidth": 1.8}))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        for ax, (h, v) in zip(figure.subplots(1, 3), ((1, 0), (1, 2), (0, 2)), strict=True):
            _draw_plane(ax, paths, h, v)
            ax.set(xlabel=_label(block, h), ylabel=_label(block, v))
        figure.suptitle(f"Relative position {symbol(block)} in frame {block.frame[-1:]}")
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


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


@dataclass(frozen=True, eq=False)
class _MapRow:
    """The map of one track at its last epoch, mm or so: errors (k, 3), NaN where truth knows none,
    and sigma (k, 3), of the points `names`."""

    names: Sequence[str]
    e: Array
    sigma: Array
    style: Mapping[str, Any]


def _map_rows(tracks: Iterable[Track], truth: Truth | None) -> dict[str, _MapRow]:
    rows, found = with_smoothed(tracks), dict[str, _MapRow]()
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
    tracks: Iterable[Track], truth: Truth | None, seen: Mapping[str, int] | None = None
) -> Figure | None:
    """Errors of the points of a map with 3-sigma, by point, as at the last epoch of each track.

    Points stand in order of how often they were seen; seen: that number, by name of the block.
    Where truth does not know a point: 1-sigma alone. None when no track has a finite map.
    """
    rows = _map_rows(tracks, truth)
    if not rows:
        return None
    counts = seen or {}
    names = list(dict.fromkeys(n for row in rows.values() for n in row.names))
    names.sort(key=lambda n: -counts.get(n, 0))
    known = any(np.isfinite(row.e).any() for row in rows.values())
    panels_of = [*range(POINT.dim), *(["times seen"] if counts else [])]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 1.2 + 1.3 * len(panels_of)), layout="constrained")
        panels = figure.subplots(len(panels_of), 1, sharex=True, squeeze=False)[:, 0]
        for axis in range(POINT.dim):
            _draw_map(panels[axis], rows, names, axis, known)
            panels[axis].set_ylabel(_label(POINT, axis))
        if counts:
            panels[-1].bar(
                range(len(names)), [counts.get(n, 0) for n in names], color="0.6", zorder=2
            )
            panels[-1].set_ylabel("times seen")
        ids = [str(number_in(n)[1]) for n in names]
        size = 6 if len(ids) <= _LABELLED else 3.5
        panels[-1].set_xticks(range(len(ids)), ids, fontsize=size, rotation=90)
        panels[-1].set_xlim(-0.7, len(ids) - 0.3)
        panels[-1].set_xlabel("id of the point" + (", by how often it was seen" if counts else ""))
        what = "error (truth − estimate)" if known else "1-sigma uncertainty"
        panels[0].set_title(f"Map {symbol(POINT)}: {what}, in frame {POINT.frame}", loc="left")
        handles: list[Any] = [_dot(row.style) for row in rows.values()]
        if known:
            handles.append(
                Patch(facecolor="0.85", edgecolor="0.5", linewidth=0.5, label="±3 sigma")
            )
        figure.align_ylabels()
        figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


#: Points up to which their ids are legible below a panel; how many times larger than the smallest
#: errors others may be, so that a panel still holds them.
_LABELLED, _FAR_OFF = 80, 5.0


def _dot(style: Mapping[str, Any]) -> Line2D:
    marker = {"linestyle": "none", "marker": "o", "markersize": 3}
    return Line2D([], [], **{**style, **marker})


def _draw_map(
    ax: Axes, rows: Mapping[str, _MapRow], names: Sequence[str], axis: int, known: bool
) -> None:
    width, beyond = 0.8 / len(rows), []
    if not known:
        ax.set_yscale("log")
    else:
        needs = [np.fmax(3 * r.sigma, np.abs(r.e))[:, axis] for r in rows.values()]
        sizes = [float(np.median(n)) for n in needs]
        # What lies far beyond the best, such as a filter that broke, must not crush it.
        near = [(n, m) for n, m in zip(needs, sizes, strict=True) if m <= _FAR_OFF * min(sizes)]
        limit = 1.15 * max(min(n.max(), _EXCURSION * m) for n, m in near) or 1.0
        ax.set_ylim(-limit, limit)
        beyond = [
            f"{name} to {float(f'{n.max():.2g}'):g}"
            for name, n in zip(rows, needs, strict=True)
            if n.max() > limit
        ]
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
    if beyond:
        _note(ax, beyond)


def save_figures(figures: Mapping[str, Figure], folder: Path | str) -> list[Path]:
    """Write NAME.svg and NAME.png of each figure; gives the paths.

    The files hold no date and no random identifiers: the same figure gives the same file.
    """
    paths = []
    Path(folder).mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        for name, figure in figures.items():
            layout = figure.get_layout_engine()
            for suffix, metadata in (("svg", {"Date": None}), ("png", None)):
                paths.append(Path(folder) / f"{name}.{suffix}")
                figure.savefig(paths[-1], dpi=200, metadata=metadata)
                figure.set_layout_engine("none")  # laying it out takes long enough once
            figure.set_layout_engine(layout)
    return paths
