"""Figures of matplotlib as figures of plotly, which can be zoomed.

So each figure is defined once. Only what this package draws is translated: lines, markers,
bands, notes and the legend, in linear and logarithmic panels.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FixedLocator
from numpy.typing import ArrayLike

from relnav_graph.arrays import Array

__all__ = ["zoomable"]

_PIXELS = 112  # of an inch: the width of the page's column
_SYMBOLS = {"D": "diamond", "s": "square", "+": "cross-thin-open"}
#: Height of the numbers below a panel that has another one below it, pixels.
_NUMBERS = 12
#: Height of the buttons that appear above a figure, pixels.
_BUTTONS = 24
#: Epochs of a track that are drawn, and up to which its bands are filled: a pass of a
#: hundred thousand epochs must not fill the file.
_POINTS, _FILLED = 1000, 300


def _rgba(colour: Any, alpha: float | None = None) -> str:
    r, g, b, a = to_rgba(colour, alpha)
    return f"rgba({255 * r:.0f},{255 * g:.0f},{255 * b:.0f},{a:.2f})"


def _html(text: str) -> str:
    """Labels with the little mathematics that they hold: $x_{t}$, $r_{tc}^{o}$."""

    def inner(match: re.Match[str]) -> str:
        one = re.sub(r"_\{(.*?)\}", r"<sub>\1</sub>", match[1])
        one = re.sub(r"\^\{(.*?)\}", r"<sup>\1</sup>", one)
        return f"<i>{one}</i>"

    return re.sub(r"\$(.*?)\$", inner, text)


def _dash(line: Line2D) -> str:
    return {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}.get(
        str(line.get_linestyle()), "dash"
    )


def _line_style(line: Line2D) -> dict[str, Any]:
    colour, marker = _rgba(line.get_color(), line.get_alpha()), line.get_marker()
    if line.get_linestyle() in ("None", ""):
        size = max(1.3 * line.get_markersize(), 4)
        symbol = _SYMBOLS.get(str(marker), "circle")
        return {"mode": "markers", "marker": {"color": colour, "size": size, "symbol": symbol}}
    width = 1.4 * line.get_linewidth()
    return {"mode": "lines", "line": {"color": colour, "width": width, "dash": _dash(line)}}


def _thinned(x: ArrayLike, y: ArrayLike) -> tuple[dict[str, Any], Array]:
    """Every k-th point, at most `_POINTS`: x, as start and step where evenly spaced, and y (n,)."""
    t, values = (np.asarray(v, dtype=np.float64) for v in (x, y))
    step = max(1, -(-len(t) // _POINTS))
    t, values = t[::step], values[::step]
    d = np.diff(t)
    if len(d) > 1 and d[0] > 0 and np.ptp(d) < 1e-6 * d[0]:
        return {"x0": float(t[0]), "dx": float(d[0])}, values
    return {"x": t}, values


def _lines(ax: Axes, on: dict[str, str]) -> list[dict[str, Any]]:
    out = []
    for line in ax.lines:
        x, y = line.get_data()
        if line.get_transform() != ax.transData:
            continue  # of the whole panel: a shape
        label = str(line.get_label())
        group = "" if label.startswith("_") else label
        xs, ys = _thinned(x, y)
        hover = {"hoverinfo": "x+y+name"} if group else {"hoverinfo": "skip"}
        style = {"name": group, "legendgroup": group, "showlegend": False, **hover}
        out.append({"type": "scatter", **xs, "y": ys, **_line_style(line), **style, **on})
    return out


def _fills(ax: Axes, on: dict[str, str]) -> list[dict[str, Any]]:
    out = []
    for area in ax.collections:
        for path in area.get_paths() if isinstance(area, PolyCollection) else ():
            vertices = np.asarray(path.vertices)
            if len(vertices) <= 2 * _FILLED:
                x, y = vertices.T
                colour = _rgba(np.asarray(area.get_facecolor())[0])
                look = {"mode": "none", "fill": "toself", "fillcolor": colour}
                quiet = {"hoverinfo": "skip", "showlegend": False}
                out.append({"type": "scatter", "x": x, "y": y, **look, **quiet, **on})
    return out


def _bars(ax: Axes, on: dict[str, str]) -> list[dict[str, Any]]:
    """Each set of bars as one outline, with gaps."""
    out = []
    for bars in ax.containers:
        if isinstance(bars, BarContainer) and len(bars):
            boxes = np.array([bar.get_bbox().get_points() for bar in bars])  # (k, corner, axis)
            corners = boxes[:, [0, 1, 1, 0, 0], 0], boxes[:, [0, 0, 1, 1, 0], 1]
            x, y = (np.pad(c, ((0, 0), (0, 1)), constant_values=np.nan).ravel() for c in corners)
            look = {"mode": "none", "fill": "toself", "fillcolor": _rgba(bars[0].get_facecolor())}
            quiet = {"hoverinfo": "skip", "showlegend": False}
            out.append({"type": "scatter", "x": x, "y": y, **look, **quiet, **on})
    return out


def _shapes(ax: Axes, x: str, y: str) -> list[dict[str, Any]]:
    """Lines and bands across the whole panel."""
    out: list[dict[str, Any]] = []
    for line in ax.lines:
        if line.get_transform() == ax.transData:
            continue
        if line.get_gid() == "grid":
            continue  # the browser draws its own
        (x0, x1), (y0, y1) = (np.asarray(v, dtype=float).tolist() for v in line.get_data())
        flat = y0 == y1
        look = {"color": _rgba(line.get_color()), "width": 1.4 * line.get_linewidth()}
        refs = (f"{x} domain", y) if flat else (x, f"{y} domain")
        ends = {"x0": x0, "x1": x1, "y0": y0, "y1": y1}
        out.append({"type": "line", **ends, "line": look, "xref": refs[0], "yref": refs[1]})
    bars = {id(bar) for own in ax.containers for bar in own}
    for patch in ax.patches:
        if isinstance(patch, Rectangle) and id(patch) not in bars:
            low, high = patch.get_y(), patch.get_y() + patch.get_height()
            look = {"fillcolor": _rgba(patch.get_facecolor()), "line": {"width": 0}}
            ends = {"x0": 0, "x1": 1, "y0": low, "y1": high}
            refs2 = {"xref": f"{x} domain", "yref": y, "layer": "below"}
            out.append({"type": "rect", **ends, **look, **refs2})
    return out


def _axis(ax: Axes, which: str, highest: float, room: float = 0.0) -> dict[str, Any]:
    """An axis; `highest` is the top of all panels, above which stands the legend; room: part of the
    height that is kept below a panel, for the numbers of its own time axis."""
    axis, box = getattr(ax, f"{which}axis"), ax.get_position()
    log = axis.get_scale() == "log"
    limits = ax.get_xlim() if which == "x" else ax.get_ylim()
    ends = [float(np.log10(v)) if log else float(v) for v in limits]
    domain = [box.x0, box.x1] if which == "x" else [box.y0 / highest + room, box.y1 / highest]
    out: dict[str, Any] = {
        "domain": [min(max(float(v), 0.0), 1.0) for v in domain],
        "range": ends,
        "type": "log" if log else "linear",
        "title": {"text": _html(axis.get_label_text()), "standoff": 6, "font": {"size": 11}},
        "gridcolor": "#e8e8e8",
        "linecolor": "#555",
        "showline": True,
        "zeroline": False,
        "ticks": "outside",
        "ticklen": 3,
        "exponentformat": "power",
        "showticklabels": True,  # of a panel that is zoomed they are its own
        "tickfont": {"size": 10},
    }
    if log:
        decades = abs(ends[1] - ends[0])
        out["dtick"] = "D1" if decades < 0.5 else "D2" if decades < 2 else 1
    if isinstance(axis.get_major_locator(), FixedLocator):
        texts = [t.get_text() for t in axis.get_ticklabels()]
        out |= {"tickvals": list(axis.get_ticklocs()), "ticktext": texts}
    return out


def _notes(ax: Axes, x: str, y: str) -> list[dict[str, Any]]:
    place = {"xref": f"{x} domain", "yref": f"{y} domain", "showarrow": False}
    out = []
    title = ax.get_title("left")
    if title:
        at = {"x": 0, "y": 1, "xanchor": "left", "yanchor": "bottom"}
        out.append({"text": _html(title), "font": {"size": 12}, **at, **place})
    for text in ax.texts:
        at = {"x": 1, "y": 1, "xanchor": "right", "yanchor": "top"}
        look = {"font": {"size": 9, "color": "#444"}, "bgcolor": "rgba(255,255,255,0.8)"}
        if text.get_horizontalalignment() == "left":
            (at["x"], at["y"]), at["xanchor"] = text.get_position(), "left"
            look = {**look, "font": {"size": 9, "color": str(to_hex(text.get_color()))}}
        out.append({"text": _html(text.get_text()), **look, **at, **place})
    return out


def _legend(figure: Figure) -> list[dict[str, Any]]:
    """The entries of the legend, as traces without points; a click shows or hides all
    that bears the entry's name."""
    out = []
    for box in figure.legends:
        for handle, text in zip(box.legend_handles, box.get_texts(), strict=True):
            look: dict[str, Any]
            if isinstance(handle, Line2D):
                look = _line_style(handle)
            elif isinstance(handle, Patch):
                marker = {"symbol": "square", "size": 12, "color": _rgba(handle.get_facecolor())}
                look = {"mode": "markers", "marker": marker}
            else:
                continue
            name = text.get_text()
            out.append({"type": "scatter", "x": [None], "y": [None], "name": name,
                        "legendgroup": name, "showlegend": True, **look})  # fmt: skip
    return out


def zoomable(figure: Figure) -> dict[str, Any]:
    """The figure as data and layout of plotly, arrays left as they are."""
    if figure.get_layout_engine() is not None:
        figure.draw_without_rendering()  # places the panels
    data, annotations, shapes = _legend(figure), list[Any](), list[Any]()
    layout: dict[str, Any] = {}
    seen: list[Axes] = []
    highest = max(ax.get_position().y1 for ax in figure.axes)
    for k, ax in enumerate(figure.axes):
        number = "" if k == 0 else str(k + 1)
        x, y = f"x{number}", f"y{number}"
        on = {"xaxis": x, "yaxis": y}
        data += _fills(ax, on) + _bars(ax, on) + _lines(ax, on)
        shapes += _shapes(ax, x, y)
        annotations += _notes(ax, x, y)
        axes = {"x": _axis(ax, "x", highest) | {"anchor": y}}
        room = _NUMBERS / (_PIXELS * figure.get_figheight() * highest)
        axes["y"] = _axis(ax, "y", highest, room if _has_below(ax, figure) else 0.0) | {"anchor": x}
        for which, shared in (("x", ax.get_shared_x_axes()), ("y", ax.get_shared_y_axes())):
            first = next((m for m, other in enumerate(seen) if shared.joined(ax, other)), None)
            if first is not None:
                axes[which]["matches"] = which + ("" if first == 0 else str(first + 1))
        if ax.get_aspect() != "auto":
            axes["y"] |= {"scaleanchor": x, "scaleratio": 1}
        layout |= {f"xaxis{number}": axes["x"], f"yaxis{number}": axes["y"]}
        seen.append(ax)
    common = {"xref": "paper", "yref": "paper", "showarrow": False}
    if figure.get_suptitle():
        at = {"x": 0.5, "y": 1, "xanchor": "center", "yanchor": "bottom"}
        annotations.append({"text": _html(figure.get_suptitle()), **at, **common})
    if figure.get_supylabel():
        at = {"x": 0, "y": 0.5, "textangle": -90, "xanchor": "left", "yanchor": "middle"}
        annotations.append({"text": _html(figure.get_supylabel()), **at, **common})
    top = _BUTTONS + 20 * _legend_lines(figure) + (22 if annotations else 4)
    height = round(_PIXELS * figure.get_figheight() * highest) + top
    layout |= {
        "height": height,
        "margin": {"l": 0, "r": 8, "t": top, "b": 4},
        "annotations": annotations,
        "shapes": shapes,
        "legend": {
            "orientation": "h",
            "x": 0,
            "font": {"size": 11},
            "yref": "container",
            "y": 1 - _BUTTONS / height,
            "yanchor": "top",
        },
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#9a9a9a", "activecolor": "#444"},
        "showlegend": bool(figure.legends),
        "font": {"size": 11, "family": "system-ui, sans-serif", "color": "#222"},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hovermode": "closest",
    }
    return {"data": data, "layout": layout}


def _has_below(ax: Axes, figure: Figure) -> bool:
    """Whether another panel stands below one."""
    own = ax.get_position()
    return any(
        other.get_position().y1 <= own.y0 and abs(other.get_position().x0 - own.x0) < 1e-6
        for other in figure.axes
    )


def _legend_lines(figure: Figure) -> int:
    """In how many lines the legend stands above panels as wide as the page's column."""
    texts = [text.get_text() for box in figure.legends for text in box.get_texts()]
    width = sum(50 + 6.5 * len(text) for text in texts)
    return -(-int(width) // 850)
