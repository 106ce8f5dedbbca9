"""How figures look: colours, sizes, panels at fixed places, and which tracks are drawn.

Panels are placed in inches, and not by a layout engine, which draws a figure twice to find out how
wide its texts are: so figures of one kind have their panels at the same place, one below the other
in a page.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, ScalarFormatter

from relnav_graph.arrays import Array
from relnav_graph.core.state import Block
from relnav_graph.core.track import Kind, Track
from relnav_graph.errors import InputError
from relnav_graph.scoring.agreement import REFERENCES
from relnav_graph.scoring.metrics import with_smoothed

__all__ = [
    "COLUMN",
    "PAGE",
    "STYLE",
    "WIDTH",
    "Look",
    "chosen_rows",
    "component",
    "curve",
    "finish",
    "finite_peak",
    "logarithmic",
    "note_beyond",
    "panels",
    "row_styles",
    "shade",
    "symbol",
    "three_sigma",
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
    "axes.titley": 1.0,  # where it is, and not where nothing stands
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.xmargin": 0,
    "axes.formatter.limits": (-3, 5),
    "grid.color": "0.92",
    "grid.linewidth": 0.5,
    "xtick.major.size": 2.5,
    "xtick.labelsize": 7,  # here, and not by `tick_params`, which makes every tick anew
    "ytick.labelsize": 7,
    "ytick.left": False,  # the grid tells where it is
    "pdf.fonttype": 42,  # texts that journals accept, and that can be searched
    "svg.hashsalt": "relnav-graph",  # the same figure gives the same file
}
#: Inches: two columns of a journal page, and one, of 85 mm.
WIDTH, _ONE_COLUMN = 7.0, 85 / 25.4
#: Rows that are drawn where nobody says which: more, one over the other, cannot be read.
MOST = 3
#: Filters, the first of which that is there is drawn; else the first filtered row.
_FILTERS = ("iekf", "ekf")
#: Inches: left and right of panels, below them, between them, a line of the legend, a title.
_LEFT, _RIGHT, _BELOW, _BETWEEN, _LINE, _TITLE = 0.76, 0.16, 0.4, 0.13, 0.165, 0.22


@dataclass(frozen=True)
class Look:
    """width: of a figure, inches; panel: height of a panel of several; titled: whether it says
    what it shows; in a column of a paper, its caption does."""

    width: float = WIDTH
    panel: float = 1.25
    titled: bool = True

    def legend_columns(self, labels: Sequence[str]) -> int:
        """How many entries of a legend stand in a line."""
        widest = max((len(label) for label in labels), default=1)
        return max(1, min(len(labels), int(self.width / (0.055 * widest + 0.45))))


PAGE, COLUMN = Look(), Look(_ONE_COLUMN, 0.95, False)


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


def chosen_rows(tracks: Iterable[Track], draw: Sequence[str] = ()) -> dict[str, Track]:
    """The rows to draw, by name: those of `draw`, or all where there are up to three, else the
    filter, the first online estimator that smooths too, and the smoother that tells most.

    Raises InputError where a name of `draw` is no row's.
    """
    rows = with_smoothed(tracks)
    missing = [name for name in draw if name not in rows]
    if missing:
        raise InputError(f"draw: found {missing[0]!r}, expected of: {', '.join(rows)}")
    if draw or len(rows) <= MOST:
        return {name: rows[name] for name in draw or rows}
    good = {n: t for n, t in rows.items() if t.status != "diverged"} or rows
    filtered = [n for n, t in good.items() if t.kind == "filtered"]
    plain = [n for n in filtered if f"{n}_smoothed" not in rows]
    smoothed = [n for n, t in good.items() if t.kind == "smoothed"]
    wanted = [
        *[n for n in (*_FILTERS, *plain) if n in good][:1],
        *[n for n in filtered if n not in plain][:1],
        *[n for n in (*REFERENCES, *smoothed) if n in good][:1],
    ]
    chosen = list(dict.fromkeys([*wanted, *good]))[:MOST]
    return {name: rows[name] for name in rows if name in chosen}


def symbol(block: Block) -> str:
    """The symbol of a block as mathematics."""
    head, *letters = block.symbol.split("_")
    return f"${head}" + "".join(f"{a}{{{b}}}" for a, b in zip("_^", letters, strict=False)) + "$"


def _ticks(ax: Axes, look: Look) -> None:
    """Few ticks, which lie inside: each costs a millisecond, and tells less than the one before."""
    ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    ax.xaxis.set_major_locator(MaxNLocator(7 if look.width > 5 else 4, steps=[1, 2, 2.5, 5, 10]))
    formatter = ScalarFormatter(useMathText=False)  # which would be parsed for each number
    formatter.set_powerlimits((-3, 5))
    ax.yaxis.set_major_formatter(formatter)
    offset = ax.yaxis.get_offset_text()  # a power of ten: clear of numbers and the title
    offset.set(fontsize=6, ha="right", x=-0.28 / (look.width - _LEFT - _RIGHT))


def logarithmic(ax: Axes) -> None:
    """A logarithmic vertical axis with few ticks."""
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(numticks=5))
    ax.yaxis.set_minor_locator(LogLocator(numticks=5, subs=()))


def panels(
    count: int, look: Look, handles: Sequence[Any] = (), title: str = "", height: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels, one below the other, of one time axis, with its legend and title.

    handles: of the legend; height: of a panel, inches, of the look where it is 0. Call it within
    ``mpl.rc_context(STYLE)``.
    """
    labels = [str(handle.get_label()) for handle in handles]
    columns = look.legend_columns(labels)
    legend = _LINE * -(-len(labels) // columns) + 0.04 if labels else 0.06
    top = legend + (_TITLE if look.titled else 0.1)
    tall = height or look.panel
    high = top + count * tall + (count - 1) * _BETWEEN + _BELOW
    figure = Figure(figsize=(look.width, high))
    span = look.width - _LEFT - _RIGHT
    axes: list[Axes] = []
    for k in range(count):
        bottom = high - top - (k + 1) * tall - k * _BETWEEN
        place = (_LEFT / look.width, bottom / high, span / look.width, tall / high)
        ax = figure.add_axes(place, sharex=axes[0] if axes else None)
        _ticks(ax, look)
        ax.xaxis.set_visible(k == count - 1)  # of the others `finish` draws the grid
        ax.yaxis.set_label_coords(-0.6 / span, 0.5)
        axes.append(ax)
    axes[-1].xaxis.set_label_coords(0.5, -0.27 / tall)
    if look.titled and title:
        axes[0].set_title(title, loc="left", pad=5)
    if labels:
        at: dict[str, Any] = {
            "loc": "upper left",
            "bbox_to_anchor": (_LEFT / look.width, 1 - 0.02 / high),
        }
        box: dict[str, Any] = {
            "borderaxespad": 0,
            "borderpad": 0,
            "handlelength": 1.8,
            "columnspacing": 1.4,
        }
        figure.legend(handles=handles, ncols=columns, **at, **box)
    return figure, axes


def curve(ax: Axes, x: Array, y: Array, **style: Any) -> Line2D:
    """A line in a panel whose limits are set: `Axes.plot` looks for them, for each line."""
    line = Line2D(x, y, **style)
    ax.add_artist(line)
    return line


def shade(ax: Axes, t: Array, low: Array, high: Array, **look: Any) -> PolyCollection:
    """The area between two lines, (N,) each, where both are finite; of a panel as in `curve`."""
    known = np.isfinite(low) & np.isfinite(high)
    ends = np.flatnonzero(np.diff(known, prepend=False, append=False))
    pieces = [slice(a, b) for a, b in zip(ends[::2], ends[1::2], strict=True)]
    outlines = [
        np.column_stack([np.r_[t[p], t[p][::-1]], np.r_[low[p], high[p][::-1]]]) for p in pieces
    ]
    area = PolyCollection(outlines, **look)
    ax.add_artist(area)
    return area


def finish(axes: Sequence[Axes], t: Array) -> None:
    """The time axis of panels, of times t (N,), s: its limits and name, and its grid in those
    panels that have no ticks of their own."""
    axes[-1].set_xlabel("time [s]")
    begin, end = float(t[0]), float(t[-1])
    axes[0].set_xlim(begin, end if end > begin else begin + 1.0)
    ticks = [x for x in axes[-1].get_xticks() if begin <= x <= end]
    for ax in axes[:-1]:
        x = np.repeat(ticks, 3)
        y = np.tile([0.0, 1.0, np.nan], len(ticks))
        look: dict[str, Any] = {"color": "0.92", "linewidth": 0.5, "zorder": 0.5, "gid": "grid"}
        curve(ax, x, y, transform=ax.get_xaxis_transform(), **look)


def three_sigma() -> Patch:
    """The band of three sigmas, for a legend."""
    return Patch(facecolor="0.85", edgecolor="0.5", linewidth=0.5, label="±3 sigma")


def note_beyond(ax: Axes, beyond: Mapping[str, float]) -> None:
    """Say in a panel what is off its scale, and how far it goes."""
    if not beyond:
        return
    said = ", ".join(f"{name} to {float(f'{peak:.2g}'):g}" for name, peak in beyond.items())
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1}
    note = ax.text(0.995, 0.97, f"off scale: {said}", transform=ax.transAxes)
    note.set(fontsize=6, color="0.25", ha="right", va="top", zorder=6, bbox=box)


def unit_of(block: Block) -> str:
    """The unit of a block in tables, in brackets; nothing where it has none."""
    return "" if block.table_unit == "1" else f" [{block.table_unit}]"


def component(block: Block, axis: int) -> str:
    """Component of a vector, or axis of an attitude error, with its frame and unit; of what has no
    axes, such as ratios of an inertia, its symbol with the number of the component."""
    if block.unit == "1" or block.frame == "-":
        head = block.symbol.partition("_")[0]
        number = f"_{{{axis + 1}}}" if block.dim > 1 else ""
        return f"${head}{number}${unit_of(block)}"
    letter = "xyz"[axis] if block.dim <= 3 else str(axis + 1)
    return f"${letter}_{{{block.frame[-1:]}}}${unit_of(block)}"


def finite_peak(values: Any) -> float:
    """The largest finite absolute value, 0 without any."""
    size = np.abs(np.asarray(values, dtype=float))
    size = size[np.isfinite(size)]
    return float(size.max()) if size.size else 0.0
