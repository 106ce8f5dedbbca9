"""What of the estimates moves with the slider of the scene: ellipsoids of the position, cones of
the attitude, and the mark in the strip of NEES below it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import TARGET_ATTITUDE
from relnav_graph.core.contracts import Derived
from relnav_graph.core.track import Track, Truth
from relnav_graph.figures.consistency import joint_nees
from relnav_graph.maths import so3
from relnav_graph.report.bodies import cones, ellipsoids, extent
from relnav_graph.scoring.deviations import chi2_band, finite

__all__ = [
    "Attitude",
    "Moving",
    "attitude_of",
    "cone",
    "ellipsoid",
    "mark",
    "strip",
    "translucent",
    "with_strip",
]

#: Parallels of an ellipsoid: it is in every frame.
_PARALLELS = 7
#: The widest cone, rad, to which a small angle is still an angle.
_WIDEST = 1.0
#: Points of a line of the strip, and the part of the figure's height that it takes.
_POINTS, _STRIP = 300, 0.13


@dataclass(frozen=True, eq=False)
class Moving:
    """A trace that changes with time: how it looks, and its coordinates at an epoch."""

    look: Mapping[str, Any]
    at: Callable[[int], dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Attitude:
    """R_ot of a row, estimated, (N, 3, 3), its error, truth less estimate, rad, (N, 3), 0 where it
    is not known, and the covariance (N, 3, 3)."""

    R: Array
    e: Array
    P: Array


def attitude_of(track: Track, true: Array | None) -> Attitude | None:
    """The attitude of the target that a row estimates; true: R_ot (N, 3, 3), or not known."""
    if TARGET_ATTITUDE not in track.layout.blocks:
        return None
    R, P = track.value(TARGET_ATTITUDE.name), track.covariance(TARGET_ATTITUDE.name)
    if not finite(R, P).all():
        return None
    e = np.zeros((len(R), 3))
    if true is not None:
        turns = np.ascontiguousarray(np.einsum("kji,kjl->kil", R, true))
        e = np.array([so3.log(turn) for turn in turns])
    return Attitude(R, e, P)


def translucent(name: str, style: Mapping[str, Any]) -> dict[str, Any]:
    """How bodies of a row look; a click on its entry in the legend hides them too."""
    quiet = {"hoverinfo": "skip", "showlegend": False}
    return {"color": style["color"], "opacity": 0.35, "legendgroup": name, **quiet}


def ellipsoid(
    drawn: Array, P: Array, scale: float, largest: float, look: Mapping[str, Any]
) -> Moving:
    """The 3-sigma of a position (N, 3) with P (N, 3, 3), `scale` times as large; a point where it
    would be larger than `largest`, m, and hide all."""
    sizes = scale * extent(P)

    def at(k: int) -> dict[str, Any]:
        size = scale if sizes[k] <= largest else 0.0
        return _places(ellipsoids(drawn[k : k + 1], P[k : k + 1], size, _PARALLELS))

    faces = _faces(ellipsoids(drawn[:1], P[:1], scale, _PARALLELS))
    return Moving({"type": "mesh3d", **faces, **look}, at)


def cone(row: Attitude, scale: float, reach: float, look: Mapping[str, Any]) -> Moving:
    """The cones of 3 sigma of the target's axes, of length `reach`, m, about where the row has
    them; errors and sigmas `scale` times as large. A line where one is too wide to be drawn."""
    widths = scale * extent(row.P)

    def at(k: int) -> dict[str, Any]:
        # The true attitude, and from it back by the enlarged error.
        R = row.R[k] @ so3.exp(row.e[k]) @ so3.exp(-scale * row.e[k])
        return _places(cones(R, row.P[k], scale if widths[k] <= _WIDEST else 0.0, reach))

    faces = _faces(cones(np.eye(3), np.eye(3), 0.0, 1.0))
    return Moving({"type": "mesh3d", **faces, **look}, at)


def _places(mesh: Mapping[str, Any]) -> dict[str, Any]:
    return {name: mesh[name] for name in "xyz"}


def _faces(mesh: Mapping[str, Any]) -> dict[str, Any]:
    return {name: mesh[name] for name in "ijk"}


def strip(
    tracks: Mapping[str, Track],
    truth: Truth | None,
    derived: Sequence[Derived],
    styles: Mapping[str, Mapping[str, Any]],
) -> tuple[list[dict[str, Any]], dict[str, Any]] | None:
    """Traces and layout of the joint NEES per freedom over time, with its 95 % band; None where no
    truth is known at all epochs."""
    found = {name: joint_nees(track, truth, derived) for name, track in tracks.items()}
    traces, shown = list[dict[str, Any]](), [np.ones(1)]
    band = (1.0, 1.0)
    for name, one in found.items():
        if one is None:
            continue
        t, value, freedoms = one
        step = -(-len(t) // _POINTS)
        ratio = (value / np.maximum(freedoms, 1))[::step]
        shown.append(ratio[np.isfinite(ratio) & (ratio > 0)])
        band = chi2_band(int(freedoms[-1]))
        line = {"color": styles[name]["color"], "width": 1.2}
        group = {"name": name, "legendgroup": name, "showlegend": False}
        places = {"x": t[::step], "y": ratio, "xaxis": "x", "yaxis": "y"}
        traces.append({"type": "scatter", "mode": "lines", **places, "line": line, **group})
    if not traces:
        return None
    values = np.concatenate([*shown, band])
    low, high = 0.8 * float(values.min()), 1.25 * float(values.max())
    t = next(iter(tracks.values())).t
    axis = {"showline": True, "linecolor": "#555", "gridcolor": "#e8e8e8", "zeroline": False,
            "ticks": "outside", "ticklen": 3, "fixedrange": True}  # fmt: skip
    ends = [float(np.log10(max(low, 1e-3))), float(np.log10(high))]
    layout = {
        "xaxis": {**axis, "domain": [0.1, 0.98], "range": [float(t[0]), float(t[-1])],
                  "anchor": "y"},
        "yaxis": {**axis, "domain": [0.0, _STRIP], "range": ends, "type": "log", "dtick": 1,
                  "anchor": "x", "title": {"text": "NEES", "standoff": 6}},
        "shapes": [{"type": "rect", "xref": "x domain", "yref": "y", "x0": 0, "x1": 1,
                    "y0": band[0], "y1": band[1], "layer": "below", "line": {"width": 0},
                    "fillcolor": "rgba(127,127,127,0.22)"}],
    }  # fmt: skip
    return traces, layout


def with_strip(layout: Mapping[str, Any], below: Mapping[str, Any]) -> dict[str, Any]:
    """The layout with a strip of NEES between the scene and the slider, which is as long."""
    scene = {**layout["scene"], "domain": {"x": [0, 1], "y": [_STRIP + 0.04, 1]}}
    begin, end = below["xaxis"]["domain"]
    under = {"y": 0, "yanchor": "top", "pad": {"t": 52}}
    return {
        **layout,
        **below,
        "scene": scene,
        "height": layout["height"] + 130,
        "plot_bgcolor": "rgba(0,0,0,0)",
        "sliders": [{**layout["sliders"][0], "x": begin, "len": end - begin, **under}],
        "updatemenus": [{**layout["updatemenus"][0], "pad": {"t": 22}}],
    }


def mark(t: Array, axis: Mapping[str, Any]) -> Moving:
    """A line across the strip, whose vertical axis is given, at an epoch of t (N,), s."""
    ends = [10.0**end for end in axis["range"]]
    look = {"mode": "lines", "line": {"color": "#222", "width": 1}, "hoverinfo": "skip"}
    on = {"type": "scatter", "xaxis": "x", "yaxis": "y", "showlegend": False}
    return Moving({**on, **look}, lambda k: {"x": [float(t[k])] * 2, "y": ends})
