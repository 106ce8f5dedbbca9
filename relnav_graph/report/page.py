"""The page: chapters of tables and figures, in one template."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from matplotlib.figure import Figure

from relnav_graph.constants import VERSION
from relnav_graph.errors import InputError
from relnav_graph.figures import (
    consistency_figure,
    error_figures,
    map_figure,
    residual_figure,
    trajectory_figure,
)
from relnav_graph.io.atomic import atomic
from relnav_graph.report import cells, setting
from relnav_graph.report.contents import PassContents, StudyContents
from relnav_graph.report.embed import encode, image
from relnav_graph.report.figures import RunFigures, plain
from relnav_graph.report.scene import Scene, make_scene
from relnav_graph.report.zoom import zoomable
from relnav_graph.scoring.text import consistency_lines

__all__ = ["MAX_BYTES", "Gallery", "render", "write_report"]

#: No report is larger: it must travel by mail.
MAX_BYTES = 10_000_000
#: Bytes of it that are left to tables and text.
_RESERVE = 500_000


@dataclass(frozen=True)
class Shown:
    """A figure of the page: how it is called, how to read it, its image (empty for one
    that lives in the browser only), and the key of its zoomable form."""

    title: str
    caption: str
    image: str
    key: str


@dataclass(eq=False)
class Gallery:
    """The figures of the page: an image of each, and zoomable copies as far as there is room.

    waiting: figures by key, to be made zoomable at the end; taken: bytes of the images.
    """

    waiting: dict[str, Figure | Scene] = field(default_factory=dict)
    taken: int = 0

    def add(self, title: str, caption: str, figure: Figure) -> Shown:
        """A figure that is shown as an image where it cannot be zoomed."""
        return self._add(title, caption, image(figure), figure)

    def add_scene(self, scene: Scene) -> Shown:
        """A figure that is shown only where plotly is."""
        return self._add("The pass in space", _scene_caption(scene), "", scene)

    def _add(self, title: str, caption: str, picture: str, figure: Figure | Scene) -> Shown:
        self.taken += len(picture)
        shown = Shown(title, caption, picture, f"figure-{len(self.waiting) + 1}")
        self.waiting[shown.key] = figure
        return shown

    def zoomed(self, room: int) -> dict[str, str]:
        """Zoomable figures as JSON, by key, scenes first, as many as fit: with all images they
        take at most `room` bytes."""
        found = {}
        room -= self.taken
        for key, figure in sorted(self.waiting.items(), key=lambda f: isinstance(f[1], Figure)):
            tree = zoomable(figure) if isinstance(figure, Figure) else figure.figure
            text = encode(tree)
            if len(text) <= room:
                found[key] = text
                room -= len(text)
        return found


def _plotly() -> str:
    """The source of plotly.js, empty where the extra is not installed."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        return ""
    return str(get_plotlyjs())


def _over_runs(study: StudyContents, gallery: Gallery) -> dict[str, list[Shown]]:
    """Figures of what runs show together, by chapter."""
    figures = RunFigures(study)
    runs = study.summary["runs"]
    rms = [
        gallery.add(
            f"RMS error: {plain(state)}",
            f"Heavy: root mean square over {runs} runs. Thin, in the same colour: the 1-sigma that"
            " the estimator predicts; where both agree, it knows how good it is. Dotted: the bound,"
            " from"
            " the information of all measurements at the true states; no unbiased estimator does"
            " better.",
            figures.rms(state),
        )
        for state in figures.blocks
        if any(state in study.found.rows[n].units for n in figures.drawn())
    ]
    consistency = [
        (
            "ANEES over the pass",
            f"Normalised error squared per freedom, all states jointly, mean over {runs} runs; 1"
            " is right. Above the band the estimator is optimistic, below it pessimistic. The"
            " band holds 95 % of what single epochs of a consistent estimator give; points are"
            " means over bins, whose epochs are correlated, so that they rather stay inside.",
            figures.anees(),
        ),
        (
            "NIS over the pass",
            "Normalised innovation squared per residual row of each sensor: what filters did not"
            " foresee, in units of what they expected. 1 is right; the 95 % band is that of"
            " independent rows in each bin. Only filters have innovations.",
            figures.nis(),
        ),
        (
            "Coverage",
            "Part of the error components that lie within 1, 2 and 3 of the estimated sigmas."
            " Upright line: a normal error. To the left of it the estimate is optimistic.",
            figures.coverage(),
        ),
    ]
    spread = figures.spread()
    more = (
        "RMSE of each run, a dot for each row; a grey line joins the rows of one run (the first"
        " 100 runs), since all rows saw the same measurements. Left of the bar filtered and"
        " fixed-lag rows, right of it smoothed ones; * marks what a filter's run ends with,"
        " smoothed."
    )
    return {
        "rms": rms,
        "consistency": [gallery.add(t, c, f) for t, c, f in consistency if f is not None],
        "spread": [gallery.add("RMSE of single runs", more, spread)] if spread else [],
    }


def _of_pass(content: PassContents, gallery: Gallery, draw: Sequence[str] = ()) -> dict[str, Any]:
    """The scene of a pass, and its figures; draw: rows, see `chosen_rows`."""
    derived = content.scenario.derived
    shown: dict[str, Any] = {"scene": None, "path": None, "map": None, "errors": []}
    scene = make_scene(content)
    if scene is not None:
        shown["scene"] = gallery.add_scene(scene)
    path = trajectory_figure(content.tracks, content.truth, derived, draw)
    if path is not None:
        caption = "The path of the chaser relative to the target, in the three planes of the frame."
        shown["path"] = gallery.add("Relative position", caption, path)
    points = map_figure(content.tracks, content.truth, content.seen, draw)
    if points is not None:
        caption = (
            "The points of the target that nobody knew before, as at the last epoch of each row,"
            " in its own frame: a point for each, in a bar of ±3 sigma about zero where the truth"
            " is known. Common errors of all points are the centre of mass, or the frame."
        )
        shown["map"] = gallery.add("Map", caption, points)
    what = "Errors (truth minus estimate) with ±3 sigma about zero; a consistent estimator leaves"
    caption = f"{what} its band in 0.3 % of the epochs."
    blind = content.truth is None and not any(track.truth for track in content.tracks)
    if blind:
        caption = (
            "Estimates with ±3 sigma, of an attitude the quaternion; below, how far each is from"
            " the smoother that tells most, with its own ±3 sigma. No truth is known."
        )
    for state, figure in error_figures(content.tracks, content.truth, derived, draw).items():
        title = f"{'Estimates' if blind else 'Errors'}: {plain(state)}"
        shown["errors"].append(gallery.add(title, caption, figure))
    strips = consistency_figure(content.tracks, content.truth, derived, draw)
    if strips is not None:
        caption = (
            "NEES: normalised error squared per freedom, of all states jointly, where truth is"
            " known. NIS: that of residual rows of each sensor, of filters their innovations, of"
            " smoothers their residuals in units of what is left to them, as means over intervals."
            " Both are 1 in the mean; 95 % of what a consistent filter gives lies in the band."
        )
        shown["errors"].append(gallery.add("Consistency over the pass", caption, strips))
    residuals = residual_figure(content.tracks, draw) if blind else None
    if residuals is not None:
        caption = "Residual rows in their own sigmas; lines at 1.96 and 3 sigma."
        shown["errors"].append(gallery.add("Residuals over the pass", caption, residuals))
    return shown


def _scene_caption(scene: Scene) -> str:
    def times(scale: float) -> str:
        return "to scale" if scale == 1 else f"drawn {scale:g} times as large"

    turns = "which turns as it truly does" if scene.true else "which turns as estimated"
    target = f"The target ({turns if scene.turning else 'fixed in this frame'})"
    errors = (
        f"Estimates of {' and '.join(scene.rows)} are shown as the true path plus their errors,"
        f" {times(scene.error_scale)}, with the 3-sigma ellipsoid at the slider's time likewise:"
        " where the square lies in it, the error is within 3 sigma."
        if scene.true
        else f"The 3-sigma ellipsoids of {' and '.join(scene.rows)} are {times(scene.error_scale)}."
    )
    if scene.angle_scale is not None:
        about = "where they lie in them, the error of the attitude is" if scene.true else "that is"
        errors += (
            " The cones about the target's axes are where estimates have them, angles"
            f" {times(scene.angle_scale)}: {about} within 3 sigma."
        )
    if scene.strip:
        errors += " Below: NEES per freedom with its 95 % band, and a mark at the slider's time."
    points = ""
    if scene.map_scale is not None:
        row = scene.rows[-1]
        points = (
            f" The coloured bodies on the target are its points as {row} finds them at the end,"
            f" with errors and 3-sigma ellipsoids {times(scene.map_scale)}; dots are the true"
            " points, where they are known."
        )
    return (
        f"Frame {scene.frame}. {target} is {times(scene.target_scale)};"
        " red, green and blue are its axes x, y, z, from the origin. The square is the chaser."
        f" {errors}{points} What is too large to be drawn, at first, is left out. Drag to turn,"
        " scroll to zoom; the slider moves time."
    )


def _study_context(study: StudyContents, gallery: Gallery) -> dict[str, Any]:
    summary = study.summary
    context: dict[str, Any] = {
        "judgements": cells.judgements(summary),
        "sensors": cells.sensor_judgements(summary),
        "noises": cells.noises(summary),
        "paired": cells.paired(summary),
        "mcreynolds": cells.mcreynolds(summary),
        "failed": cells.bad_runs(summary["failed"]) if summary["failed"] else None,
        "degraded": cells.bad_runs(summary["degraded"]) if summary["degraded"] else None,
        "judged": study.judged,
        "worst": cells.worst_runs(study.worst),
        "worst_run": study.worst[0].run if study.worst else None,
        "remade": None,
        "numbers": _ranges(study.found.runs),
    }
    figures = _over_runs(study, gallery)
    again = study.remake(study.worst[0].run) if study.worst else None
    if again is not None:
        own = cells.constants(again.summary)
        context["remade"] = cells.results(again.summary) | ({"constants": own} if own else {})
        figures["pass"] = _of_pass(again, gallery)  # type: ignore[assignment]
    return {**context, "figures": figures}


def _ranges(runs: list[int]) -> str:
    """Numbers of runs in words: 0 to 9, 12."""

    def parts() -> Iterator[str]:
        start = 0
        for k in range(1, len(runs) + 1):
            if k == len(runs) or runs[k] != runs[k - 1] + 1:
                first, last = runs[start], runs[k - 1]
                yield f"{first}" if first == last else f"{first} to {last}"
                start = k

    return ", ".join(parts())


def render(
    content: StudyContents | PassContents, plotly: str | None = None, draw: Sequence[str] = ()
) -> str:
    """The page as text. plotly: source of plotly.js, by default of the one installed; an
    empty one leaves images only; draw: rows of one pass to draw, by default at most three.

    Raises InputError when it would be larger than `MAX_BYTES`.
    """
    plotly = _plotly() if plotly is None else plotly
    gallery = Gallery()
    summary, scenario = content.summary, content.scenario
    study = isinstance(content, StudyContents)
    context: dict[str, Any] = {
        "study": study,
        "summary": summary,
        "scenario": scenario,
        "time": scenario.file.time,
        "orbit": setting.orbit(scenario),
        "models": setting.models(scenario),
        "simulated": setting.simulated(scenario) if content.simulated else None,
        "prior": setting.prior(scenario),
        "toml": setting.toml(scenario),
        "overview": cells.overview(summary),
        "cautions": cells.cautions(summary),
        "results": cells.results(summary),
        "consistency": consistency_lines(summary),
        "estimated": cells.estimated(summary),
        "residuals": cells.residuals(summary),
        "declared": None if study else cells.declared(summary),
        "constants": cells.constants(summary),
        "aligned": cells.aligned(summary),
        "command": content.command,
        "versions": content.versions,
        "version": VERSION,
    }
    if isinstance(content, StudyContents):
        context |= _study_context(content, gallery)
    else:
        context["figures"] = {"pass": _of_pass(content, gallery, draw)}
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    source = (resources.files(__package__) / "page.html.j2").read_text("utf-8")
    room = MAX_BYTES - _RESERVE - len(plotly.encode())
    zoomed = gallery.zoomed(room) if plotly else {}
    context |= {"plotly": plotly if zoomed else "", "zoomed": zoomed}
    text = environment.from_string(source).render(has_plotly=bool(plotly), **context)
    size = len(text.encode())
    if size > MAX_BYTES:
        raise InputError(
            f"the report on {scenario.name} comes to {size / 1e6:.1f} MB, expected at most"
            f" {MAX_BYTES / 1e6:g} MB: ask for fewer estimators"
        )
    return text


def write_report(
    content: StudyContents | PassContents, folder: Path, draw: Sequence[str] = ()
) -> Path:
    """Write ``report.html`` into a folder, whole or not at all; draw: see `render`. Raises
    InputError."""
    path = folder / "report.html"
    text = render(content, draw=draw)
    with atomic(path) as staged:
        staged.write_text(text, "utf-8")
    return path
