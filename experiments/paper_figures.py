"""The figures of the published systems, with the quantities and axes that their captions name, for
a reader who has the paper beside it.

Of each system: the published filter, and the estimator of this package that is its like, on one
pass of the scenario, or, in closed loops, each on the pass that it flies. Of zhang2015 the pages at
hand have no figures.

Run it: ``python experiments/paper_figures.py PAPER [OUT] [SETTING ...]``, PAPER one of xiong2013,
hu2019, thienel2006, yang2016; a SETTING is as of ``relnav compare --set``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from relnav_graph.arrays import Array
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.track import Truth
from relnav_graph.figures import STYLE, WIDTH
from relnav_graph.maths import so3
from relnav_graph.maths.frames import rtn_from_inertial
from relnav_graph.runs.comparison import Comparison, compare
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.deviations import errors
from relnav_graph.units import unit_scale

HERE = Path(__file__).parent
AXES = ("x", "y", "z")
#: Lines of one figure: label, times (N,), s, and values (N, panels).
Lines = list[tuple[str, Array, Array]]


@dataclass(frozen=True)
class Drawn:
    """One figure of a paper.

    number: in the paper; caption: what it says; panels: labels of the vertical axes; of: makes the
    lines of a comparison; scenario, settings: what is run; kinds: of estimators; cases: how many
    draws; windows: parts of the pass, s, each with a panel of its own, of the same values.
    """

    number: str
    caption: str
    panels: tuple[str, ...]
    of: Callable[[Comparison, Any], Lines]
    scenario: str
    kinds: tuple[str, ...]
    settings: tuple[str, ...] = ()
    cases: int = 1
    windows: tuple[tuple[float, float], ...] = ()


def error_of(
    state: str,
    unit: str,
    norm: bool = False,
    orbital: bool = False,
    axes: slice = slice(None),
) -> Callable[[Comparison, Any], Lines]:
    """Errors of a state per axis, some of them, or their norm, in a unit; orbital: in RTN axes of
    the target."""

    def lines(found: Comparison, scenario: Any) -> Lines:
        out: Lines = []
        derived = derived_quantities(scenario.layout)
        for track, truth in zip(found.tracks, found.truths, strict=True):
            assert truth is not None
            one = errors(track, truth, derived).get(state)
            if one is None:
                continue
            e = one.e / unit_scale(unit, one.block.unit)
            if orbital:
                e = np.einsum("nij,nj->ni", _axes(truth, one.t), e)
            shown = np.linalg.norm(e, axis=1)[:, None] if norm else e[:, axes]
            out.append((track.name, one.t, shown))
        return out

    return lines


def _target(truth: Truth, t: Array) -> tuple[Array, Array]:
    """Position and velocity of the target in i, (N, 3), m and m/s, where o is i."""
    rows, _ = truth.at(t)
    values = truth.values
    r = values["chaser_position"][rows] - values["relative_position"][rows]
    v = values["chaser_velocity"][rows] - values["relative_velocity"][rows]
    return r, v


def _axes(truth: Truth, t: Array) -> Array:
    """R_oi (N, 3, 3) of the target's orbit."""
    return np.array([rtn_from_inertial(r, v) for r, v in zip(*_target(truth, t), strict=True)])


def true_path(norm: bool) -> Callable[[Comparison, Any], Lines]:
    """True relative position in the target's RTN axes, or its length, km."""

    def lines(found: Comparison, scenario: Any) -> Lines:
        out: Lines = []
        for track, truth in zip(found.tracks, found.truths, strict=True):
            assert truth is not None
            r = np.einsum(
                "nij,nj->ni", _axes(truth, truth.t), truth.values["relative_position"] / 1e3
            )
            value = np.linalg.norm(r, axis=1)[:, None] if norm else r
            out.append((f"flown by {track.name}", truth.t, value))
        return out

    return lines


def visible(found: Comparison, scenario: Any) -> Lines:
    """How many satellites the receiver measures at each epoch."""
    epochs = found.problems[0].epochs
    counts = [sum(len(m.ids) for m in e.measurements if m.sensor == "gps") for e in epochs]
    return [("satellites", np.array([e.t for e in epochs]), np.array(counts, float)[:, None])]


def prediction_errors(found: Comparison, scenario: Any) -> Lines:
    """Of predicting a second from the truth by one and by five Euler steps: rate, deg/s, and
    attitude, deg, norms over the axes; hu2019's figure 4."""
    truth, out = found.truths[0], list[tuple[str, Array, Array]]()
    assert truth is not None
    for name, longest in (("one step", "1 s"), ("five steps", "0.2 s")):
        settings = ('processes.target.integrator="euler"', f'processes.target.max_step="{longest}"')
        model = load_scenario(HERE / "hu2019.toml", settings).processes["target"]
        blocks = [b.name for b in (*model.advances, *model.reads)]
        missed = []
        for k, t in enumerate(truth.t[:-1]):
            u = np.array([[truth.t[k + 1] - t]])
            ahead = model.propagate(float(t), u, *(truth.values[b][k] for b in blocks))
            end = dict(zip(blocks, ahead, strict=False))
            turn = so3.log(end["target_attitude"].T @ truth.values["target_attitude"][k + 1])
            rate = end["target_rate"] - truth.values["target_rate"][k + 1]
            missed.append(np.degrees([np.linalg.norm(turn), np.linalg.norm(rate)]))
        out.append((name, truth.t[1:], np.array(missed)))
    return out


def _per_axis(unit: str) -> tuple[str, ...]:
    return tuple(f"{axis}, {unit}" for axis in AXES)


RATIOS = tuple(f"J_{name} / J_xx" for name in ("yy", "zz", "xy", "xz", "yz"))
XIONG: dict[str, Any] = {"scenario": "xiong2013", "kinds": ("xiong2013_filter", "ekf")}
HU: dict[str, Any] = {
    "scenario": "hu2019",
    "kinds": ("hu2019_one_step", "hu2019_five_steps", "ekf"),
}
#: The paper draws 100 cases.
CASES: dict[str, Any] = {"scenario": "thienel2006", "kinds": ("momentum_observer",), "cases": 5}
TWO: dict[str, Any] = {"windows": ((5e3, 12e3), (12e3, 5e4)), **CASES}
FREE: dict[str, Any] = {"scenario": "thienel2006_freespace", "kinds": ("momentum_observer", "iekf")}
SILENT = ('sensors.far.sigma="1e-6 deg"', 'sensors.near.sigma="1e-6 deg"')
QUIET: dict[str, Any] = {"settings": SILENT, **FREE}
YANG: dict[str, Any] = {"scenario": "yang2016", "kinds": ("ekf_without_drift", "ekf")}
LATE: dict[str, Any] = {"windows": ((15e3, 6e4),)}


def _thienel() -> Iterator[Drawn]:
    transient = ("transient", "steady state")
    attitude = error_of("control_attitude", "deg", norm=True)
    labels = tuple(f"{part}, deg" for part in transient)
    yield Drawn("1", "True attitude control errors", labels, attitude, **TWO)
    for k, axis in enumerate(AXES):
        caption = f"True {axis.upper()} axis angular velocity control errors"
        rate = error_of("control_rate", "deg/s", axes=slice(k, k + 1))
        yield Drawn(str(2 + k), caption, tuple(f"{p}, deg/s" for p in transient), rate, **TWO)
    for number, noise, own in ((5, "no", QUIET), (7, "10 deg", FREE)):
        caption = f"True attitude control errors from Freespace, {noise} measurement error"
        yield Drawn(str(number), caption, ("error, deg",), attitude, **LATE, **own)
        caption = f"True rate control errors from Freespace, {noise} measurement error"
        rate = error_of("control_rate", "deg/s")
        yield Drawn(str(number + 1), caption, _per_axis("deg/s"), rate, **own)


PAPERS: Mapping[str, tuple[Drawn, ...]] = {
    "xiong2013": tuple(
        Drawn(number, caption, _per_axis(unit), error_of(state, unit), **XIONG)
        for number, caption, state, unit in (
            ("3", "Relative position error", "relative_position", "m"),
            ("4", "Position error of the chaser", "chaser_position", "m"),
            ("5", "Relative attitude error", "relative_attitude", "deg"),
            ("6", "Attitude error of the chaser", "chaser_attitude", "deg"),
            ("7", "Angular rate error of the failed satellite", "target_rate", "deg/s"),
        )
    ),
    "hu2019": (
        Drawn(
            "4",
            "Effect of the number of prediction steps: a second predicted from the truth",
            ("attitude, deg", "rate, deg/s"),
            prediction_errors,
            scenario="hu2019",
            kinds=("ekf",),
        ),
        *(
            Drawn(number, caption, panels, error_of(state, unit), **HU)
            for number, caption, panels, state, unit in (
                ("5", "Relative attitude error", _per_axis("deg"), "target_attitude", "deg"),
                ("6", "Angular rate error", _per_axis("rad/s"), "target_rate", "rad/s"),
                ("7", "Error of the moment of inertia ratios", RATIOS, "inertia_ratios", "1"),
            )
        ),
    ),
    "thienel2006": tuple(_thienel()),
    "yang2016": tuple(
        Drawn(number, caption, panels, of, **YANG)
        for number, caption, panels, of in (
            (
                "2",
                "Relative position in target orbit coordinate",
                _per_axis("km"),
                true_path(False),
            ),
            ("3", "Relative distance", ("distance, km",), true_path(True)),
            ("4", "Visible GPS satellites", ("number",), visible),
            (
                "5",
                "Relative position error in target orbit coordinate",
                _per_axis("m"),
                error_of("relative_position", "m", orbital=True),
            ),
            (
                "6",
                "Relative velocity error in target orbit coordinate",
                _per_axis("m/s"),
                error_of("relative_velocity", "m/s", orbital=True),
            ),
            (
                "7",
                "Estimate error of the accelerometer's constant bias, relative navigation",
                _per_axis("m/s^2"),
                error_of("accelerometer_bias", "m/s^2"),
            ),
            (
                "8",
                "Estimate error of the accelerometer's constant bias, absolute navigation",
                _per_axis("m/s^2"),
                error_of("absolute_accelerometer_bias", "m/s^2"),
            ),
        )
    ),
}


def draw(one: Drawn, lines: Lines) -> Figure:
    """The figure: a panel for each label, times below."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.7 + 1.3 * len(one.panels)), layout="constrained")
        axes = figure.subplots(len(one.panels), 1, squeeze=False)[:, 0]
        seen: dict[str, dict[str, Any]] = {}
        for k, (ax, label) in enumerate(zip(axes, one.panels, strict=True)):
            for name, t, values in lines:
                # Wide below narrow: equal lines stay visible.
                place = len(seen)
                style = {"color": f"C{place}", "linewidth": max(1.8 - 0.6 * place, 0.6)}
                style = seen.setdefault(name, style)
                inside = np.ones(len(t), bool)
                if one.windows:
                    begin, end = one.windows[min(k, len(one.windows) - 1)]
                    inside = (t >= begin) & (t <= end)
                column = min(k, values.shape[1] - 1)
                ax.plot(t[inside], values[inside, column], label=name, **style)
            ax.set_ylabel(label)
        axes[-1].set_xlabel("time, s")
        handles, labels = axes[0].get_legend_handles_labels()
        own = dict(zip(labels, handles, strict=True))
        figure.legend(own.values(), own.keys(), loc="outside lower center", ncols=4)
        figure.suptitle(f"Fig. {one.number}. {one.caption}")
    return figure


def main(paper: str, out: Path = Path("paper_figures"), *settings: str) -> list[Path]:
    """Draw all figures of a paper, as PNG and PDF; gives the files."""
    out.mkdir(parents=True, exist_ok=True)
    made: dict[Any, tuple[Any, list[Comparison]]] = {}
    files = []
    for one in PAPERS[paper]:
        run = one.scenario, one.kinds, one.settings, one.cases
        if run not in made:
            scenario = load_scenario(HERE / f"{one.scenario}.toml", (*one.settings, *settings))
            cases = [compare(scenario, one.kinds, run=case) for case in range(one.cases)]
            made[run] = scenario, cases
        scenario, cases = made[run]
        figure = draw(one, [line for found in cases for line in one.of(found, scenario)])
        for suffix in ("png", "pdf"):
            files.append(out / f"{paper}_fig{one.number}.{suffix}")
            figure.savefig(files[-1], dpi=200)
        print(f"{files[-2]}: {one.caption}")
    return files


if __name__ == "__main__":
    name, *rest = sys.argv[1:] or [""]
    if name not in PAPERS:
        sys.exit(f"found {name!r}, expected one of {', '.join(PAPERS)}")
    main(name, Path(rest[0] if rest else "paper_figures"), *rest[1:])
