"""Figures of the states of a pass: errors with three-sigma bands where truth is known, else the
estimates, and how far they are from each other."""

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
from relnav_graph.core.contracts import Derived
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track, Truth
from relnav_graph.figures.style import (
    PAGE,
    STYLE,
    Look,
    chosen_rows,
    component,
    curve,
    finish,
    finite_peak,
    note_beyond,
    panels,
    row_styles,
    shade,
    symbol,
    three_sigma,
)
from relnav_graph.maths import so3
from relnav_graph.scoring.agreement import REFERENCES
from relnav_graph.scoring.deviations import StateEstimates, errors, estimates

__all__ = ["MANY", "error_figures", "sigmas_of"]

#: Part of the pass in which a filter may still converge, and how far limits then follow
#: excursions, in usual sizes (medians).
_TRANSIENT, _EXCURSION = 0.1, 6.0
#: Epochs above which a band is an image in an SVG: as a path it takes megabytes.
MANY = 5000
#: Colours of w, x, y and z of a quaternion.
_QUATERNION = ("0.25", "#D55E00", "#009E73", "#0072B2")


@dataclass(frozen=True, eq=False)
class _Line:
    """One state of one track in table units: t (N,) s, sigma (N, dim), e where known; constant:
    whether it is one of the pass; estimate: the state itself."""

    name: str
    track: Track
    block: Block
    style: Mapping[str, Any]
    t: Array
    sigma: Array
    e: Array | None
    constant: bool
    estimate: StateEstimates

    def reach(self, axis: int) -> Array:
        """How far the error or its 3-sigma band reaches, (N,); 0 where not finite."""
        error = np.zeros_like(self.sigma) if self.e is None else np.abs(self.e)
        return np.nan_to_num(np.fmax(3 * self.sigma, error)[:, axis], posinf=0.0)

    def peak(self, axis: int) -> float:
        """How far the error goes; the band, where no error is known."""
        return finite_peak(3 * self.sigma[:, axis] if self.e is None else self.e[:, axis])


def sigmas_of(block: Block, P: Array) -> Array:
    """Sigmas (N, dim) in table units; NaN where P is no covariance."""
    variance = np.diagonal(P, axis1=1, axis2=2)
    return np.asarray(block.table_scale * np.sqrt(np.where(variance >= 0, variance, np.nan)))


def _lines(
    rows: Mapping[str, Track], truth: Truth | None, derived: Sequence[Derived]
) -> dict[str, list[_Line]]:
    lines = dict[str, list[_Line]]()
    styles = row_styles({name: track.kind for name, track in rows.items()})
    for name, track in rows.items():
        true = track.truth or truth
        known = {} if true is None else errors(track, true, derived)
        for state, x in estimates(track, derived).items():
            t, P, e, scale = track.t, x.P, None, x.block.table_scale
            if state in known and len(known[state].t):
                t, P, e = known[state].t, known[state].P, scale * known[state].e
            sigma = sigmas_of(x.block, P)
            line = _Line(name, track, x.block, styles[name], t, sigma, e, x.constant, x)
            lines.setdefault(state, []).append(line)
    return lines


def _limit(lines: Sequence[_Line], axis: int) -> float:
    """Half the height of a panel: what errors and bands need once filters converged.

    A diverged track, or a short excursion, must not crush the others.
    """
    needs = []
    for line in [x for x in lines if x.track.status != "diverged"] or lines:
        reach = line.reach(axis)[line.t >= line.t[0] + _TRANSIENT * np.ptp(line.t)]
        needs.append(min(reach.max(), _EXCURSION * float(np.median(reach))))
    return 1.3 * max(needs) or 1.0  # room for the note of what is off scale


def _draw_band(ax: Axes, line: _Line, axis: int, about: Array | float, among: int) -> None:
    """Three sigmas on both sides of `about`, shaded and bounded."""
    band = 3 * line.sigma[:, axis]
    faint = 0.26 / max(2, among)  # many bands must not add up to mud
    colour, low, high = line.style["color"], about - band, about + band
    many = {"rasterized": True} if len(line.t) > MANY else {}
    shade(ax, line.t, low, high, facecolor=colour, alpha=faint, linewidth=0, **many)
    edges = np.r_[low, np.nan, high]
    curve(ax, np.r_[line.t, np.nan, line.t], edges, **{**line.style, "linewidth": 0.5, "zorder": 2})


def _draw_errors(ax: Axes, lines: Sequence[_Line], axis: int) -> None:
    for line in lines:
        _draw_band(ax, line, axis, 0.0, len(lines))
        if line.e is not None:
            curve(ax, line.t, line.e[:, axis], **line.style)
    limit = _limit(lines, axis)
    ax.set_ylim(-limit, limit)
    ax.axhline(0, color="0.4", linewidth=0.5, zorder=1.5)
    peaks = {line.name: line.peak(axis) for line in lines}
    note_beyond(ax, {name: p for name, p in peaks.items() if p > limit})


def _title(state: str, lines: Sequence[_Line], what: str) -> str:
    block = lines[0].block
    where = "about the axes of" if block.manifold == "SO3" else "in"
    frame = "" if block.frame == "-" else f", {where} frame {block.frame[-1:]}"
    constant = ", a constant" if lines[0].constant else ""
    head = state.replace("_", " ")
    return f"{head[:1].upper()}{head[1:]} {symbol(block)}{constant}: {what}{frame}"


def _error_figure(state: str, lines: Sequence[_Line], look: Look) -> Figure:
    block = lines[0].block
    aimed = block in lines[0].track.controlled
    what = "error (truth − aim)" if aimed else "error (truth − estimate)"
    handles: list[Any] = [Line2D([], [], **line.style) for line in lines]
    if not aimed:  # a control error has no sigma
        handles.append(three_sigma())
    figure, axes = panels(block.dim, look, handles, _title(state, lines, what))
    for axis, ax in enumerate(axes):
        ax.set_ylabel(component(block, axis))
        _draw_errors(ax, lines, axis)
    finish(axes, lines[0].track.t)
    return figure


def _reference(lines: Sequence[_Line]) -> _Line:
    """The line that the others are compared with: of the smoother that tells most."""
    by_name = {line.name: line for line in lines if line.track.status != "diverged"}
    smoothed = [n for n, line in by_name.items() if line.track.kind == "smoothed"]
    named = [n for n in (*REFERENCES, *smoothed, *by_name) if n in by_name]
    return by_name[named[0]] if named else lines[0]


def quaternions(R: Array) -> Array:
    """Rotations (N, 3, 3) as quaternions (N, 4), w first, of signs that do not jump."""
    known = np.isfinite(R).all(axis=(1, 2))
    q = np.full((len(R), 4), np.nan)
    found = [so3.quaternion(np.ascontiguousarray(matrix)) for matrix in R[known]]
    if found:
        one = np.array(found)
        flips = np.where(np.einsum("ki,ki->k", one[1:], one[:-1]) < 0, -1.0, 1.0)
        one[1:] *= np.cumprod(flips)[:, None]
        q[known] = one
    return q


def _draw_quaternion(ax: Axes, lines: Sequence[_Line]) -> None:
    for line in lines:
        q = quaternions(line.estimate.value)
        for k, colour in enumerate(_QUATERNION):
            curve(ax, line.t, q[:, k], **{**line.style, "color": colour})
    ax.set_ylim(-1.05, 1.05)
    ax.set_ylabel("quaternion")
    for k, (name, colour) in enumerate(zip("wxyz", _QUATERNION, strict=True)):
        at: dict[str, Any] = {
            "transform": ax.transAxes,
            "ha": "left",
            "va": "bottom",
            "fontsize": 7,
        }
        ax.text(1.005, 0.72 - 0.22 * k, name, color=colour, **at)


def _draw_estimates(ax: Axes, lines: Sequence[_Line], axis: int) -> None:
    for line in lines:
        value = line.block.table_scale * line.estimate.value[:, axis]
        _draw_band(ax, line, axis, value, len(lines))
        curve(ax, line.t, value, **line.style)
    _limit_estimates(ax, [x for x in lines if x.track.status != "diverged"] or lines, axis)


def _limit_estimates(ax: Axes, lines: Sequence[_Line], axis: int) -> None:
    """Limits that hold smoothed estimates, those of filters once they converged, and the narrowest
    band."""
    begun = [0.0 if line.track.kind == "smoothed" else _TRANSIENT for line in lines]
    late = [x.t >= x.t[0] + part * np.ptp(x.t) for x, part in zip(lines, begun, strict=True)]
    scale = lines[0].block.table_scale
    values = [scale * x.estimate.value[rows, axis] for x, rows in zip(lines, late, strict=True)]
    shown = np.concatenate(values)
    shown = shown[np.isfinite(shown)]
    sigmas = np.concatenate([x.sigma[rows, axis] for x, rows in zip(lines, late, strict=True)])
    sigmas = sigmas[np.isfinite(sigmas)]
    if shown.size:
        low, high = float(shown.min()), float(shown.max())
        room = max(0.08 * (high - low), 4 * float(sigmas.min(initial=np.inf)))
        most = max(abs(low), abs(high))
        if not 1e-12 * most < room < np.inf:  # a constant without a sigma
            room = 0.1 * most or 1.0
        if most + room < 1e150:
            ax.set_ylim(low - room, high + room)


def _draw_differences(ax: Axes, lines: Sequence[_Line], axis: int, reference: _Line) -> None:
    """Each less the reference, about zero, with its own band."""
    scale, needs = reference.block.table_scale, list[float]()
    beyond: dict[str, float] = {}
    away: dict[str, Array] = {}
    for line in lines:
        away[line.name] = scale * reference.estimate.to(line.estimate.value)[:, axis]
        _draw_band(ax, line, axis, away[line.name], len(lines))
        curve(ax, line.t, away[line.name], **line.style)
        late = line.t >= line.t[0] + _TRANSIENT * np.ptp(line.t)
        reach = np.abs(away[line.name]) + 3 * line.sigma[:, axis]
        reach = np.nan_to_num(reach[late], posinf=0.0)
        if line.track.status != "diverged" and reach.size:
            needs.append(min(float(reach.max()), _EXCURSION * float(np.median(reach))))
    limit = 1.3 * max(needs, default=0.0) or 1.0
    ax.set_ylim(-limit, limit)
    ax.axhline(0, color="0.4", linewidth=0.5, zorder=1.5)
    beyond = {n: finite_peak(d) for n, d in away.items() if finite_peak(d) > limit}
    note_beyond(ax, beyond)


@np.errstate(over="ignore", invalid="ignore")  # of diverged tracks
def _estimate_figure(state: str, lines: Sequence[_Line], look: Look) -> Figure:
    """The estimates, in a panel per component, and below what a reader cannot see in them: how
    far each is from the reference, with three sigmas."""
    block, reference = lines[0].block, _reference(lines)
    handles: list[Any] = [Line2D([], [], **line.style) for line in lines]
    turned = block.manifold == "SO3"
    first = 1 if turned else block.dim
    title = _title(state, lines, "estimate")
    small = Look(look.width, 0.8 * look.panel, look.titled)
    figure, axes = panels(first + block.dim, small, [*handles, three_sigma()], title)
    same = [line for line in lines if len(line.t) == len(reference.t) and line.block == block]
    if turned:
        _draw_quaternion(axes[0], lines)
    for axis in range(block.dim):
        label = component(block, axis)
        if not turned:
            axes[axis].set_ylabel(label)
            _draw_estimates(axes[axis], lines, axis)
        _draw_differences(axes[first + axis], same, axis, reference)
        axes[first + axis].set_ylabel("Δ" + label)
    if look.titled:
        what = f"less {reference.name}" if len(lines) > 1 else "±3 sigma about the estimate"
        below = axes[first].text(0.005, 0.97, what, transform=axes[first].transAxes)
        below.set(fontsize=7, color="0.25", ha="left", va="top", zorder=6)
        below.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1})
    finish(axes, lines[0].track.t)
    return figure


def error_figures(
    tracks: Iterable[Track],
    truth: Truth | None,
    derived: Sequence[Derived],
    draw: Sequence[str] = (),
    look: Look = PAGE,
) -> dict[str, Figure]:
    """A figure per state, in table units: a panel per axis, with error and 3-sigma band.

    Where truth does not know the state: the estimates with their bands (of an attitude the
    quaternion), and below how far they are from those of the smoother that tells most. Limits
    leave out transients and diverged tracks; a note in the panel says so. draw: rows, see
    `chosen_rows`. Raises InputError as :func:`relnav_graph.scoring.metrics.errors` does.
    """
    with mpl.rc_context(STYLE):
        lines = _lines(chosen_rows(tracks, draw), truth, derived)
        return {
            state: (_error_figure if found[0].e is not None else _estimate_figure)(
                state, found, look
            )
            for state, found in lines.items()
        }
