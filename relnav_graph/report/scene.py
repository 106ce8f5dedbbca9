"""The pass in space, as a figure of plotly: the tumbling target, the chaser's path about
it, and where the estimates say it is."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.catalogue import (
    POINT,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    TARGET_ATTITUDE,
)
from relnav_graph.core.models import derived_quantities
from relnav_graph.figures import row_styles
from relnav_graph.report.bodies import ellipsoids, extent, xyz
from relnav_graph.report.contents import PassContents
from relnav_graph.report.moments import (
    Attitude,
    Moving,
    attitude_of,
    cone,
    ellipsoid,
    mark,
    strip,
    translucent,
    with_strip,
)
from relnav_graph.scoring.deviations import StateEstimates, estimates, finite
from relnav_graph.scoring.maps import family_scores, known_points
from relnav_graph.scoring.metrics import with_smoothed

__all__ = ["Scene", "make_scene"]

#: Most points of a path, and moments that the slider steps through.
_POINTS, _FRAMES = 600, 60
#: Part of the pass that does not set the size of ellipsoids and cones: filters still converge.
_TRANSIENT = 0.1
#: Sizes of target and usual ellipsoid as fractions of the view, half the angle of the usual cone,
#: rad: they are enlarged up to them. Lengths of axes and cones as fractions of the target.
_TARGET_PART, _ELLIPSOID_PART, _CONE, _AXIS, _BEYOND = 0.12, 0.07, 0.2, 0.8, 1.3
#: Size of the middle one of the ellipsoids of a map, as a fraction of the target, and the most
#: vertices of all of them: they are in every frame.
_POINT_PART, _VERTICES = 0.08, 1600
#: Half the edge of the box drawn for a target of which no point is known, m.
_HALF_EDGE = 0.5
_AXES = ("#D55E00", "#009E73", "#0072B2")


@dataclass(frozen=True, eq=False)
class Scene:
    """The figure, and what its caption says.

    frame: letter of the frame; turning: whether the target turns in it; true: whether the path
    and attitude are the truth; target_scale, error_scale: factors by which target and errors
    are enlarged; rows: the tracks shown; map_scale: factor by which errors of the target's points
    are, where they are estimated; angle_scale: factor by which errors of the attitude are, where
    it is estimated; strip: whether there is one of NEES.
    """

    figure: Mapping[str, Any]
    frame: str
    turning: bool
    true: bool
    target_scale: float
    error_scale: float
    rows: Sequence[str]
    map_scale: float | None = None
    angle_scale: float | None = None
    strip: bool = False


def _nice(scale: float) -> float:
    """1, 2 or 5 times a power of ten, at most `scale`; at least 1."""
    if not math.isfinite(scale) or scale < 2:
        return 1.0
    power = 10.0 ** math.floor(math.log10(scale))
    return power * max(m for m in (1, 2, 5) if m * power <= scale)


def _rows(content: PassContents) -> dict[str, StateEstimates]:
    """The relative position as estimated by one online and one smoothed row: the first of each
    that is finite, or batch."""
    chosen: dict[str, tuple[str, StateEstimates]] = {}
    derived = derived_quantities(content.scenario.layout)
    for name, track in with_smoothed(content.tracks).items():
        state = estimates(track, derived).get("relative_position")
        if state is None or not finite(state.value, state.P).all():
            continue
        kind = "smoothed" if track.kind == "smoothed" else "online"
        if kind not in chosen or name == "batch":
            chosen[kind] = (name, state)
    return dict(chosen.values())


def _points(content: PassContents, row: str) -> Array | None:
    """Points of the target (n, 3), m, in t: that a sensor knows, or truth, or a row estimates."""
    own = family_scores(with_smoothed(content.tracks)[row].at(slice(-1, None)), None)[0]
    if POINT.name in own:
        true = known_points(content.truth)
        X: Array = own[POINT.name].value.reshape(-1, 3)
        return np.array(list(true.values())) if true else X if finite(X).all() else None
    for sensor in content.scenario.sensors.values():
        points = getattr(sensor, "points", None)
        if isinstance(points, np.ndarray) and points.ndim == 2 and points.shape[1] == 3:
            return points
    return None


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Ellipsoids of an estimated map in t: vertices (m, 3), m, faces (n, 3), and their colour."""

    vertices: Array
    faces: Indices
    colour: str
    scale: float


def _cloud(content: PassContents, row: str, target_scale: float, reach: float) -> _Cloud | None:
    """The points that a row estimates with their 3-sigma, errors enlarged beyond the target so far
    that the middle one of the ellipsoids is a part of `reach`, m; None without any."""
    rows = with_smoothed(content.tracks)
    states, errors = family_scores(rows[row].at(slice(-1, None)), content.truth)
    state = states.get(POINT.name)
    if state is None or not finite(state.value, state.P).all():
        return None
    e, P = np.zeros(state.value.size), state.P[0]
    if POINT.name in errors:
        known = [b.name for b in errors[POINT.name].members]
        at = [b.name in known for b in state.members]
        e[np.repeat(at, 3)] = errors[POINT.name].e[0]
    X, off = state.value[0].reshape(-1, 3), e.reshape(-1, 3)
    each = np.array([P[k : k + 3, k : k + 3] for k in range(0, len(P), 3)])
    usual = 3 * float(np.median(np.sqrt(np.linalg.eigvalsh(each)[:, -1])))
    scale = _nice(_POINT_PART * reach / usual) if usual > 0 else 1.0
    scale = max(scale, target_scale)
    centres = target_scale * (X + off) - scale * off
    n = next((n for n in (8, 6, 5, 4) if 2 * n * n * len(X) <= _VERTICES), 3)
    mesh = ellipsoids(centres, each, scale, n)
    vertices, faces = (np.column_stack([mesh[c] for c in names]) for names in ("xyz", "ijk"))
    kinds = {name: track.kind for name, track in rows.items()}
    return _Cloud(vertices, faces, row_styles(kinds)[row]["color"], scale)


def _known(content: PassContents, name: str) -> Array | None:
    if content.truth is None or name not in content.truth.values:
        return None
    values = content.truth.values[name]
    same = len(content.truth.t) == len(content.tracks[0].t)
    return values if same and finite(values).all() else None


def _attitude(content: PassContents, row: str) -> Array | None:
    """R_ot (N, 3, 3), true where known, else as estimated by a row."""
    true = _known(content, TARGET_ATTITUDE.name)
    track = with_smoothed(content.tracks)[row]
    if true is None and TARGET_ATTITUDE in track.layout.blocks:
        return track.value(TARGET_ATTITUDE.name)
    return true


def _box(points: Array | None) -> Array:
    """Corners (8, 3) of a box about the points; a plane of them gets some thickness."""
    low, high = np.full(3, -_HALF_EDGE), np.full(3, _HALF_EDGE)
    if points is not None:
        low, high = points.min(axis=0), points.max(axis=0)
        thin = np.maximum(0.1 * np.ptp(points, axis=0).max() - (high - low), 0) / 2
        low, high = low - thin, high + thin
    return np.array(list(product(*zip(low, high, strict=True))))


_FACES = np.array([(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
                   (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)])  # fmt: skip


def _target(
    R: Array, box: Array, points: Array | None, cloud: _Cloud | None, reach: float
) -> list[dict[str, Array]]:
    """Coordinates, m, of the parts that turn with R = R_ot (3, 3): box (8, 3) and points (n, 3)
    in t, the axes of t, of length `reach`, and the ellipsoids of points."""
    shown = points if points is not None else np.zeros((0, 3))
    axes = [np.vstack([np.zeros(3), reach * e]) for e in np.eye(3)]
    ellipsoids = [] if cloud is None else [cloud.vertices]
    return [xyz(part @ R.T) for part in (box, shown, *axes, *ellipsoids)]


def _view(path: Array, target: Array) -> tuple[Array, float]:
    """Centre and half edge of the cube that holds the path and points of the target."""
    held = np.vstack([path, target])
    low, high = held.min(axis=0), held.max(axis=0)
    return (low + high) / 2, 0.58 * float((high - low).max())


def _eye(path: Array) -> Array:
    """Where the camera stands (3,), in plotly's units: oblique to the plane that fits the path
    (N, 3) best, on its side towards +z."""
    along, _, normal = np.linalg.svd(path - path.mean(axis=0), full_matrices=False)[2]
    normal = normal if normal[2] >= 0 else -normal
    eye = normal + 0.6 * (along if along[2] >= 0 else -along)
    return np.asarray(1.75 * eye / np.linalg.norm(eye))


def make_scene(content: PassContents) -> Scene | None:
    """The scene of a pass; None where no row gives the relative position."""
    rows = _rows(content)
    if not rows:
        return None
    last = list(rows)[-1]
    block = rows[last].block
    true = _known(content, block.name)
    path = rows[last].value if true is None else true
    R = _attitude(content, last) if block == RELATIVE_POSITION else None
    points = _points(content, last)
    box = _box(points)
    if block == RELATIVE_POSITION_T or R is None:
        R = np.broadcast_to(np.eye(3), (len(path), 3, 3))
    turning = bool(np.ptp(R, axis=0).max() > 0)
    corners = np.einsum("kij,mj->kmi", R, box).reshape(-1, 3)
    half = _view(path, np.zeros((1, 3)))[1]
    target_scale = _nice(_TARGET_PART * half / (np.ptp(box, axis=0).max() / 2))
    centre, half = _view(path, target_scale * corners)
    late = slice(int(_TRANSIENT * (len(path) - 1)), None)
    usual = max(float(np.median(extent(s.P[late]))) for s in rows.values())
    error_scale = _nice(_ELLIPSOID_PART * 2 * half / usual) if usual > 0 else 1.0
    reach = target_scale * float(np.ptp(box, axis=0).max())
    cloud = _cloud(content, last, target_scale, reach)
    t = content.tracks[0].t
    drawn = {
        name: path + error_scale * (state.value - path) if true is not None else state.value
        for name, state in rows.items()
    }
    turned = _attitudes(content, rows) if block == RELATIVE_POSITION else {}
    usual = max((float(np.median(extent(a.P[late]))) for a in turned.values()), default=0.0)
    angle_scale = _nice(_CONE / usual) if usual > 0 else 1.0
    styles = row_styles({n: track.kind for n, track in with_smoothed(content.tracks).items()})
    moving = list[Moving]()
    for name, state in rows.items():
        look = translucent(name, styles[name])
        moving.append(ellipsoid(drawn[name], state.P, error_scale, half, look))
        if name in turned:
            moving.append(cone(turned[name], angle_scale, _BEYOND * reach, look))
    tracks = {name: with_smoothed(content.tracks)[name] for name in rows}
    below = strip(tracks, content.truth, content.scenario.derived, styles)
    if below is not None:
        moving.append(mark(t, below[1]["yaxis"]))
    big = None if points is None else target_scale * points
    data, frames = _moving(t, path, R, target_scale * box, big, cloud, moving)
    data += _paths(rows, path, true is not None, drawn, styles)
    layout = _layout(t, block.frame[-1], centre, half, _eye(path), frames)
    if below is not None:
        data += below[0]
        layout = with_strip(layout, below[1])
    return Scene(
        {"data": data, "layout": layout, "frames": frames},
        block.frame[-1],
        turning,
        true is not None,
        target_scale,
        error_scale,
        list(rows),
        None if cloud is None else cloud.scale,
        angle_scale if turned else None,
        below is not None,
    )


def _attitudes(content: PassContents, rows: Iterable[str]) -> dict[str, Attitude]:
    """The attitude of the target as those rows have it that estimate it."""
    true = _known(content, TARGET_ATTITUDE.name)
    found = {n: attitude_of(with_smoothed(content.tracks)[n], true) for n in rows}
    return {name: one for name, one in found.items() if one is not None}


def _moving(
    t: Array,
    path: Array,
    R: Array,
    box: Array,
    points: Array | None,
    cloud: _Cloud | None,
    more: Sequence[Moving],
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Traces of what moves, at the first epoch, and their coordinates over time."""
    reach = _AXIS * float(np.ptp(box, axis=0).max())
    ijk = dict(zip("ijk", np.ascontiguousarray(_FACES.T), strict=True))
    quiet: dict[str, Any] = {"hoverinfo": "skip", "showlegend": False}
    grey: dict[str, Any] = {"color": "#8a8f98", "opacity": 0.55, "flatshading": True}
    dots: dict[str, Any] = {"mode": "markers", "marker": {"size": 2.5, "color": "#222"}}
    line: dict[str, Any] = {"type": "scatter3d", "mode": "lines", **quiet}
    looks: list[dict[str, Any]] = [
        {"type": "mesh3d", **ijk, **grey, **quiet},
        {"type": "scatter3d", **dots, **quiet},
        *({**line, "line": {"color": c, "width": 5}} for c in _AXES),
        *([] if cloud is None else [_look(cloud) | quiet]),
        *(dict(one.look) for one in more),
        {"type": "scatter3d", "mode": "markers", "name": "chaser", "hoverinfo": "name",
         "marker": {"size": 3, "color": "black", "symbol": "square"}},
    ]  # fmt: skip
    moments = np.unique(np.linspace(0, len(path) - 1, _FRAMES).round().astype(int))
    kinds, frames = [look["type"] for look in looks], list[dict[str, Any]]()
    for m in moments.tolist():
        parts = _target(R[m], box, points, cloud, reach)
        parts += [*(one.at(m) for one in more), xyz(path[m : m + 1])]
        data = [{"type": kind, **part} for kind, part in zip(kinds, parts, strict=True)]
        name = f"{t[m]:.6g}"
        frames.append({"name": name, "data": data, "traces": list(range(len(data)))})
    first = frames[_begin(frames)]["data"]
    return [look | part for look, part in zip(looks, first, strict=True)], frames


def _begin(frames: Sequence[Any]) -> int:
    """The moment that is shown first: halfway, when filters have converged."""
    return len(frames) // 2


def _look(cloud: _Cloud) -> dict[str, Any]:
    ijk = dict(zip("ijk", np.ascontiguousarray(cloud.faces.T), strict=True))
    return {"type": "mesh3d", **ijk, "color": cloud.colour, "opacity": 0.6}


def _paths(
    rows: Iterable[str],
    path: Array,
    true: bool,
    drawn: Mapping[str, Array],
    styles: Mapping[str, Mapping[str, Any]],
) -> list[dict[str, Any]]:
    """The true path, and those of the estimates as they are drawn."""
    step, out = -(-len(path) // _POINTS), list[dict[str, Any]]()
    if true:
        black: dict[str, Any] = {"line": {"color": "black", "width": 4}, "name": "true path"}
        out.append({"type": "scatter3d", "mode": "lines", **xyz(path[::step]), **black})
    for name in rows:
        group: dict[str, Any] = {"name": styles[name]["label"], "legendgroup": name}
        thin = {"line": {"color": styles[name]["color"], "width": 3}, "mode": "lines"}
        out.append({"type": "scatter3d", **xyz(drawn[name][::step]), **thin, **group})
    return out


def _layout(
    t: Array,
    frame: str,
    centre: Array,
    half: float,
    eye: Array,
    frames: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    axes = {
        f"{a}axis": {
            "title": {"text": f"{a}<sub>{frame}</sub> [m]"},
            "range": [float(centre[k] - half), float(centre[k] + half)],
            "gridcolor": "#ddd",
            "showbackground": False,
            "zeroline": False,
        }
        for k, a in enumerate("xyz")
    }
    at_once = {"mode": "immediate", "transition": {"duration": 0}}
    steps = [
        {"label": f["name"], "method": "animate",
         "args": [[f["name"]], {**at_once, "frame": {"duration": 0, "redraw": True}}]}
        for f in frames
    ]  # fmt: skip
    play = {**at_once, "frame": {"duration": 90, "redraw": True}, "fromcurrent": True}
    stop = {**at_once, "frame": {"duration": 0, "redraw": False}}
    buttons = [
        {"label": "play", "method": "animate", "args": [None, play]},
        {"label": "stop", "method": "animate", "args": [[None], stop]},
    ]
    bottom = {"y": 0, "yanchor": "top", "pad": {"t": 24}}
    menu = {"type": "buttons", "direction": "left", "x": 0, "xanchor": "left", "buttons": buttons}
    now = {"prefix": "t = ", "suffix": " s", "font": {"size": 12, "color": "#222"}}
    slider = {"x": 0.18, "len": 0.8, "active": _begin(frames), "steps": steps,
              "currentvalue": now, "ticklen": 0, "minorticklen": 0,
              "font": {"size": 1, "color": "rgba(0,0,0,0)"}}  # fmt: skip
    return {
        "height": 640,
        "margin": {"l": 0, "r": 0, "t": 48, "b": 8},
        "scene": {
            **axes,
            "aspectmode": "cube",
            "dragmode": "orbit",
            "camera": {"eye": dict(zip("xyz", eye.tolist(), strict=True))},
        },
        "legend": {"orientation": "h", "x": 0, "y": 1.01, "yanchor": "bottom"},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#9a9a9a", "activecolor": "#444"},
        "font": {"size": 11, "family": "system-ui, sans-serif", "color": "#222"},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "updatemenus": [{**menu, **bottom, "showactive": False}],
        "sliders": [{**slider, **bottom}],
    }
