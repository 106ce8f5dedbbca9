"""Figures of what the runs of a study show together, in the style of `relnav_graph.figures`.

Filtered, fixed-lag and smoothed rows never share a panel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogFormatterSciNotation

from relnav_graph.arrays import Array
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.state import Block
from relnav_graph.core.track import Kind
from relnav_graph.figures import STYLE, WIDTH, row_styles, symbol
from relnav_graph.report.contents import StudyContents
from relnav_graph.scoring.deviations import chi2_band
from relnav_graph.study.collect import Collected, RowRuns
from relnav_graph.study.record import bin_edges

__all__ = ["RunFigures", "plain"]

KINDS: tuple[Kind, ...] = ("filtered", "fixed-lag", "smoothed")
#: Runs whose numbers are joined by a line from row to row: more would be mud.
_JOINED = 100
#: Ending of the name of a row that is the smoothed end of an online estimator.
_ENDS = "_smoothed"
#: Width of the lines of predicted sigmas, beside errors of 1.4.
_THIN = 0.6
#: Part of the components of a normal error within 1, 2 and 3 sigma.
_NORMAL = (0.6827, 0.9545, 0.9973)


def plain(name: str) -> str:
    """A name of the code as words."""
    return name.replace("_", " ")


@dataclass(frozen=True, eq=False)
class RunFigures:
    """The figures of a study, each made when asked for."""

    study: StudyContents
    styles: Mapping[str, dict[str, Any]] = field(init=False)

    def __post_init__(self) -> None:
        kinds = {name: row.kind for name, row in self._found.rows.items()}
        object.__setattr__(self, "styles", row_styles(kinds))

    @property
    def _found(self) -> Collected:
        return self.study.found

    @cached_property
    def blocks(self) -> dict[str, Block]:
        """States, derived ones included, by name."""
        layout = self.study.scenario.layout
        derived = {d.block.name: d.block for d in derived_quantities(layout)}
        return {b.name: b for b in layout} | derived

    @cached_property
    def t(self) -> Array:
        """Mean time of each bin of the series, (bins,), s."""
        if (data := self.study.spec.data) is not None:
            return np.array(data.centres)
        times = self.study.scenario.times
        edges = bin_edges(len(times))
        return np.array([0.5 * (times[a] + times[b - 1]) for a, b in pairwise(edges)])

    def _by_kind(self, names: Sequence[str]) -> list[tuple[Kind, list[str]]]:
        rows = self._found.rows
        groups = [(kind, [n for n in names if rows[n].kind == kind]) for kind in KINDS]
        return [(kind, group) for kind, group in groups if group]

    def _style(self, name: str) -> dict[str, Any]:
        """Style of a row, labelled by its name alone, since its panel tells the kind."""
        return {**self.styles[name], "label": name}

    def drawn(self) -> list[str]:
        """Rows that have numbers over the pass."""
        return [n for n, row in self._found.rows.items() if row.series.total is not None]

    def _legend(self, figure: Figure, names: Sequence[str], *more: Any) -> None:
        handles: list[Any] = [Line2D([], [], **self._style(n)) for n in names]
        figure.legend(handles=[*handles, *more], loc="outside upper center", ncols=4)

    def _bound(self, kind: Kind, state: str, index: int) -> Array | None:
        series = self._found.bound_series.get(kind)
        if series is None or (kind, state) not in self._found.bound:
            return None
        return np.asarray(np.sqrt(series.mean[index, 2]))

    def rms(self, state: str) -> Figure:
        """RMS error over the pass, predicted sigma and bound, a panel per kind."""
        block = self.blocks[state]
        with mpl.rc_context(STYLE):
            groups = self._by_kind([n for n in self.drawn() if state in self._found.rows[n].units])
            figure = Figure(figsize=(WIDTH, 2.9), layout="constrained")
            panels = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
            for ax, (kind, names) in zip(panels, groups, strict=True):
                self._draw_rms(ax, state, kind, names)
            unit = "" if block.table_unit == "1" else f" [{block.table_unit}]"
            panels[0].set_ylabel(f"{plain(state)} {symbol(block)}{unit}")
            self._legend(
                figure,
                [n for _, names in groups for n in names],
                Line2D([], [], color="0.3", label="predicted 1-sigma", linewidth=_THIN),
                Line2D([], [], color="black", label="bound", linewidth=1.4, linestyle=":"),
            )
        return figure

    def _draw_rms(self, ax: Axes, state: str, kind: Kind, names: Sequence[str]) -> None:
        scale = self.blocks[state].table_scale
        for name in names:
            row = self._found.rows[name]
            index = list(row.units).index(state)
            error, _, trace = row.series.mean[index]
            style = self._style(name) | {"linewidth": 1.4}
            thin = {"color": style["color"], "linewidth": _THIN}
            ax.semilogy(self.t, scale * np.sqrt(trace), label="predicted 1-sigma", **thin)
            ax.semilogy(self.t, scale * np.sqrt(error), **style)
        bound = self._bound(kind, state, index)
        if bound is not None:
            line = {"color": "black", "linewidth": 1.4, "linestyle": ":", "zorder": 5}
            ax.semilogy(self.t, scale * bound, label="bound", **line)
        ax.set_title(kind, loc="left")
        ax.set_xlabel("time [s]")
        ax.margins(x=0)

    def anees(self) -> Figure | None:
        """Joint ANEES over the pass with its band over runs, a panel per kind."""
        names = [n for n in self.drawn() if np.isfinite(self._joint(n)).any()]
        groups = self._by_kind(names)
        if not groups:
            return None
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(WIDTH, 2.7), layout="constrained")
            panels = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
            for ax, (kind, group) in zip(panels, groups, strict=True):
                for name in group:
                    ax.plot(self.t, self._joint(name), **self._style(name))
                row = self._found.rows[group[0]]
                counted = int(np.isfinite(row.own["anees"]).sum())
                _draw_band(ax, chi2_band(row.freedoms["joint"], max(counted, 1)))
                _limit_ratio(ax)
                ax.set_title(kind, loc="left")
                ax.set_xlabel("time [s]")
            panels[0].set_ylabel("NEES per freedom, mean over runs")
            self._legend(figure, names, _band_handle())
        return figure

    def _joint(self, name: str) -> Array:
        return np.asarray(self._found.rows[name].series.mean[-1, 1])

    def nis(self) -> Figure | None:
        """NIS per row of each sensor over the pass, with its band over runs."""
        rows = {n: self._found.rows[n] for n in self.drawn() if self._found.rows[n].sensor}
        sensors = list(dict.fromkeys(s for row in rows.values() for s, _ in row.sensor))
        if not sensors:
            return None
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(WIDTH, 0.7 + 2.0 * len(sensors)), layout="constrained")
            panels = figure.subplots(len(sensors), 1, sharex=True, squeeze=False)[:, 0]
            for ax, sensor in zip(panels, sensors, strict=True):
                self._draw_nis(ax, sensor, rows)
            panels[-1].set_xlabel("time [s]")
            figure.supylabel("NIS per residual row, mean over runs", fontsize=8)
            self._legend(figure, list(rows), _band_handle())
        return figure

    def _draw_nis(self, ax: Axes, sensor: str, rows: Mapping[str, RowRuns]) -> None:
        counted = np.zeros(len(self.t))
        for name, row in rows.items():
            order = list(dict.fromkeys(s for s, _ in row.sensor))
            if sensor in order:
                index = order.index(sensor)
                values = row.nis.mean[index]
                ax.plot(self.t, values, **self._style(name))
                # Residual rows in a bin, if all were spread evenly over the bins that have any.
                seen = np.isfinite(values)
                total = float(np.nansum(row.of_sensor(sensor, "rows")))
                counted = np.maximum(counted, np.where(seen, total / max(seen.sum(), 1), 0))
        _draw_band(ax, chi2_band(max(int(counted.max()), 1)))
        _limit_ratio(ax)
        ax.set_title(f"sensor {sensor}", loc="left")

    def spread(self) -> Figure | None:
        """RMSE of each run in each row, a panel per state; a run is joined by a line."""
        states = [s for s in self.blocks if self._rmse(s)]
        if not states:
            return None
        columns = 3
        lines = -(-len(states) // columns)
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(WIDTH, 0.4 + 1.75 * lines), layout="constrained")
            panels = figure.subplots(lines, columns, squeeze=False).ravel()
            for ax, state in zip(panels, states, strict=False):
                self._draw_spread(ax, state, self._rmse(state))
            for ax in panels[len(states) :]:
                ax.remove()
        return figure

    def _rmse(self, state: str) -> dict[str, Array]:
        """RMSE per run of each row in table units, filtered rows first."""
        groups = self._by_kind(self.drawn())
        found = {n: self._found.rows[n].of(state, "rmse") for _, names in groups for n in names}
        return {n: v for n, v in found.items() if np.isfinite(v).any()}

    def _draw_spread(self, ax: Axes, state: str, rmse: Mapping[str, Array]) -> None:
        block, rows = self.blocks[state], self._found.rows
        for _, group in self._by_kind(list(rmse)):
            at = [list(rmse).index(n) for n in group]
            table = np.column_stack([rmse[n][:_JOINED] for n in group])
            gaps = np.full((len(table), 1), np.nan)
            x = np.tile([*at, np.nan], len(table))
            y = np.hstack([table, gaps]).ravel()
            ax.semilogy(x, y, color="0.75", linewidth=0.4, zorder=1.5, label="one run")
        for k, (name, values) in enumerate(rmse.items()):
            dot = {"color": self.styles[name]["color"], "linestyle": "none", "label": name}
            ax.semilogy(np.full(len(values), k), values, marker=".", markersize=3.5, **dot)
        # The axis may begin with any power, but never without a labelled tick.
        ax.yaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(1.5, 0.6)))
        ax.tick_params(axis="y", which="both", labelsize=6)
        short = [f"{n[: -len(_ENDS)]}*" if n.endswith(_ENDS) else n for n in rmse]
        ax.set_xticks(range(len(rmse)), short, rotation=30, fontsize=6)
        ax.set_xlim(-0.5, len(rmse) - 0.5)
        edge = sum(rows[n].kind != "smoothed" for n in rmse) - 0.5
        if 0 < edge < len(rmse) - 1:
            ax.axvline(edge, color="0.4", linewidth=0.5)
        unit = "" if block.table_unit == "1" else f" [{block.table_unit}]"
        ax.set_title(f"{plain(state)}{unit}", loc="left", fontsize=7)

    def coverage(self) -> Figure | None:
        """Part of the components within 1, 2 and 3 sigma, by state and row."""
        names = [n for _, group in self._by_kind(self.drawn()) for n in group]
        states = [s for s in self.blocks if any((s, "inside_1sigma") in self._found.rows[n].state
                                                for n in names)]  # fmt: skip
        if not states:
            return None
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(WIDTH, 0.9 + 0.28 * len(states)), layout="constrained")
            panels = figure.subplots(1, 3, sharey=True)
            for ax, m, expected in zip(panels, (1, 2, 3), _NORMAL, strict=True):
                ax.axvline(100 * expected, color="black", linewidth=1.0, label="normal")
                for k, name in enumerate(names):
                    values = [self._inside(name, s, m) for s in states]
                    y = np.arange(len(states)) + 0.5 * ((k + 0.5) / len(names) - 0.5)
                    marker = "o" if self._found.rows[name].kind == "smoothed" else "D"
                    dot = {"color": self.styles[name]["color"], "label": self.styles[name]["label"]}
                    ax.plot(values, y, marker, markersize=3.2, **dot)
                ax.set_title(f"within {m} sigma: {100 * expected:.1f} %", loc="left")
                ax.set_xlabel("components [%]")
            panels[0].set_yticks(range(len(states)), [plain(s) for s in states], fontsize=7)
            panels[0].set_ylim(len(states) - 0.5, -0.5)
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(handles[1:], labels[1:], loc="outside upper center", ncols=4)
        return figure

    def _inside(self, name: str, state: str, m: int) -> float:
        values = self._found.rows[name].of(state, f"inside_{m}sigma")
        known = values[np.isfinite(values)]
        return 100 * float(known.mean()) if len(known) else np.nan


def _draw_band(ax: Axes, band: tuple[float, float]) -> None:
    low, high = band
    ax.axhspan(low, high, color="0.5", alpha=0.22, linewidth=0, zorder=1)
    ax.axhline(1, color="0.4", linewidth=0.5, zorder=1.5)
    ax.margins(x=0)


def _band_handle() -> Patch:
    return Patch(facecolor="0.5", alpha=0.22, linewidth=0, label="95 % band")


def _limit_ratio(ax: Axes) -> None:
    """Limits of an axis of ratios; logarithmic above 5, so that rows near 1 stay readable."""
    low, high = ax.dataLim.intervaly
    if high > 5 or ax.get_yscale() == "log":  # of the panel beside, which shares the axis
        ax.set_yscale("log")
        ax.set_ylim(max(0.8 * min(low, 0.5), 1e-3), 1.3 * high)
    else:
        ax.set_ylim(0, 1.15 * max(high, 1.3))
