"""The gallery: one page for each group of scenarios, with figures and what is to be learnt.

``python docs/make_gallery.py [GROUP ...]`` runs a pass of each group, at a reduced length where
the whole takes minutes, and writes docs/gallery/GROUP.md, its figures, and the index. Groups on
recorded data need RELNAV_DATA, and are left as they are without. What was found in many runs
stands in experiments/README.md, and is taken from there.
"""

from __future__ import annotations

import os
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("agg")

from relnav_graph.figures.save import pass_figures, png
from relnav_graph.runs.comparison import Comparison, compare
from relnav_graph.scenario.build import load_scenario

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "gallery"
EXPERIMENTS = ROOT / "experiments"
#: Of the figures: legible at the width of the page, and small.
DPI = 90


@dataclass(frozen=True)
class Group:
    """Scenarios that belong together, the pass that is drawn, and what to look at."""

    title: str
    scenarios: tuple[str, ...]
    estimators: tuple[str, ...]
    figures: tuple[str, ...]
    learn: str
    settings: tuple[str, ...] = ()
    sections: tuple[str, ...] = ()
    data: str = ""

    @property
    def command(self) -> str:
        """What draws the figures."""
        parts = ["relnav compare", self.scenarios[0], *(["--data DIR"] if self.data else [])]
        quoted = (f"'{s}'" if '"' in s or "[" in s else s for s in self.settings)
        parts += [f"--set {s}" for s in quoted]
        return " ".join([*parts, *(f"-e {kind}" for kind in self.estimators), "-o out"])


GROUPS = {
    "zhang2015": Group(
        "Beacons beside a tumbling target",
        (
            "zhang2015",
            "zhang2015_close",
            "zhang2015_stress",
            "zhang2015_static",
            "zhang2015_known_inertia",
            "zhang2015_orbit",
        ),
        ("iekf", "batch"),
        ("relative_attitude", "consistency"),
        "Six beacons, an eccentric orbit, nothing known of rate and inertia. Inside the pass the"
        " smoother is several times better; what a filter lacks is a beginning, and where the"
        " chaser's own attitude is open, going back over the whole pass.",
        sections=(
            "zhang2015_stress: where a good beginning is not enough",
            "zhang2015_close with 30 % outliers",
            "zhang2015_close without the assumption, and with it",
            "Noises found in a pass's own residuals",
        ),
    ),
    "rendezvous": Group(
        "Burns that are known, and burns that are not",
        ("rendezvous",),
        ("iekf", "batch"),
        ("relative_velocity",),
        "A burn is an input with a covariance of its own: known but for what it misses.",
        sections=("rendezvous: burns that are known, and burns that are not",),
    ),
    "xiong2013": Group(
        "Orbit and attitude of both craft jointly",
        ("xiong2013", "xiong2013_0p1m"),
        ("ekf", "batch"),
        ("relative_position",),
        "A bound before any estimator: the printed noises cannot give the printed accuracy.",
        sections=("xiong2013: the printed noises do not give the printed accuracy",),
    ),
    "hu2019": Group(
        "Inertia from attitudes alone",
        ("hu2019", "hu2019_points"),
        ("hu2019_five_steps", "ekf", "batch"),
        ("target_attitude",),
        "An error of integration is no noise: a filter that counts it as one is sure and wrong.",
        sections=("hu2019: five Euler steps beat one, and an integrator beats both",),
    ),
    "thienel2006": Group(
        "Estimators that fly what they estimate",
        ("thienel2006", "thienel2006_freespace"),
        ("momentum_observer", "ekf"),
        ("control_attitude",),
        "In the loop the errors of an estimate move the craft. The problem is nearly linear, so a"
        " filter is as good as a graph; both are better than an observer with fixed gains.",
        ('time.step="5 s"', "time.epochs=2401"),
        ("thienel2006: estimators that fly what they estimate",),
    ),
    "yang2016": Group(
        "From 50 km to 2 km by laser and strapdown",
        ("yang2016",),
        ("ekf",),
        ("relative_position",),
        "One run is one draw: printed centimetres, where the bound is most of a metre.",
        ("time.epochs=601",),
        ("yang2016: the printed centimetres are one draw",),
    ),
    "mounting": Group(
        "A camera that is not where the drawing says",
        ("mounting", "mounting_map"),
        ("iekf", "batch"),
        ("target_attitude",),
        "A wrong constant that is taken for known spoils everything, and no residual says so."
        " Estimated, it must be gone back over: a filter takes early linearisations for knowledge.",
        sections=("mounting: a camera that is not quite where the drawing says",),
    ),
    "closures": Group(
        "Places that are seen again",
        ("closures",),
        ("ekf", "batch"),
        ("relative_position", "trajectory"),
        "A loop closure holds the end for every estimator, and for a smoother the way there, too.",
        sections=("closures: places that are seen again",),
    ),
    "inspection": Group(
        "A target without a model",
        ("inspection", "inspection_mono", "principal_spin"),
        ("incremental",),
        ("map", "relative_position"),
        "Points, rate, inertia and centre of mass are all unknown, and all found; no filter does so"
        " consistently. What a spin about a principal axis hides, `relnav explain` names before.",
        ("time.epochs=241", "truth.map.count=30"),
    ),
    "starry_night": Group(
        "A real stereo camera among known points",
        ("starry_night", "starry_night_nominal", "starry_night_map"),
        ("ekf", "batch"),
        ("relative_position",),
        "What a calibration is worth: 15 mm, and a gyro that is 0.1 s late.",
        sections=("starry_night: what a calibration is worth",),
        data="starry_night",
    ),
    "starloc": Group(
        "A real stereo camera among AprilTags",
        ("starloc", "starloc_as_filed", "starloc_map"),
        ("ekf", "batch"),
        ("relative_position",),
        "A mounting that is ten degrees off, and a filter that rejects what would bring it back.",
        sections=("starloc: a mounting that is ten degrees off",),
        data="starloc",
    ),
    "grace": Group(
        "Two real spacecraft, 205 km apart",
        ("grace_fo", "grace_kbr", "grace_kbr_fixes"),
        ("ekf", "rts"),
        ("relative_position",),
        "Gravity to degree 20 and the absolute time; what a range alone tells, and what not.",
        sections=(
            "grace_fo: a simulated laser between real orbits",
            "grace_kbr: what a real range tells",
        ),
        data="grace_fo",
    ),
    "astrobee": Group(
        "A third party's odometry beside a tumbling target",
        ("astrobee_tumble",),
        ("incremental", "batch"),
        ("relative_attitude",),
        "A front end that knows no points; a joint ANEES of 226 that is right where axes are bent.",
        sections=("astrobee_tumble: a front end that knows no points",),
        data="astrobee_tumble",
    ),
}


def _tables(name: str) -> dict[str, Any]:
    return tomllib.loads((EXPERIMENTS / f"{name}.toml").read_text("utf-8"))


def described(name: str) -> str:
    """Title and description of a scenario, as its file has them."""
    tables = _tables(name)
    title = tables["title"].partition(": ")[2]
    about = " ".join(tables.get("description", "").split())
    return f"`{name}`\n: **{title[:1].upper()}{title[1:]}.** {about}\n"


def scores(found: Comparison) -> str:
    """The scores of the pass, state by state, in the units of the command's table."""
    rows = [["", "kind", "ANEES", "status"]]
    for name, one in found.summary["estimators"].items():
        anees = one.get("anees")
        shown = "-" if anees is None else f"{anees:.2f}"
        rows.append([f"`{name}`", str(one.get("kind", "")), shown, str(one.get("status", ""))])
    lines = [rows[0], ["---"] * 4, *rows[1:]]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def draw(key: str, group: Group) -> tuple[list[str], str] | None:
    """Names of the figures that were written, and the scores; None where there are no data."""
    data: Path | None = None
    if group.data:
        root = os.environ.get("RELNAV_DATA")
        if not root:
            return None
        data = Path(root) / group.data
    scenario = load_scenario(EXPERIMENTS / f"{group.scenarios[0]}.toml", list(group.settings))
    found = compare(scenario, list(group.estimators), data=data)
    figures = pass_figures(found.tracks, found.truths[0], scenario.derived)
    names = [name for name in group.figures if name in figures]
    if len(names) < len(group.figures):
        raise SystemExit(f"{key}: found figures {sorted(figures)}, expected {group.figures}")
    for name in names:
        (OUT / f"{key}_{name}.png").write_bytes(png(figures[name], dpi=DPI))
    return names, scores(found)


def page(key: str, group: Group, names: Sequence[str], table: str) -> str:
    """The page of a group, in MyST Markdown."""
    out = [f"# {group.title}", "", group.learn, ""]
    for name in names:
        said = name.replace("_", " ")
        out += [f"![{group.title}: {said}]({key}_{name}.png)", ""]
    out += ["Drawn from one pass:", "", *([f"<!-- data: {group.data} -->"] if group.data else [])]
    out += ["```console", group.command, "```", "", table, "", "## Scenarios", ""]
    out += [described(name) for name in group.scenarios]
    for section in group.sections:
        title = section.partition(": ")[2] or section
        out += [
            f"## {title[:1].upper()}{title[1:]}",
            "",
            "```{include} ../../experiments/README.md",
        ]
        rest = (EXPERIMENTS / "README.md").read_text("utf-8").partition(f"## {section}\n")[2]
        end = [':end-before: "\\n## "'] if "\n## " in rest else []
        out += [f':start-after: "## {section}"', ":relative-images:", *end, "```", ""]
    return "\n".join(out).rstrip() + "\n"


def index() -> str:
    """The page that leads to all others, with every scenario."""
    out = [
        "# Gallery",
        "",
        "One page for each group of scenarios: what it is, what comes out, what to",
    ]
    out += ["learn from it. Made by `python docs/make_gallery.py`.", "", "::::{grid} 1 2 2 3"]
    out += [":gutter: 2", ""]
    for key, group in GROUPS.items():
        out += [f":::{{grid-item-card}} {group.title}", f":link: {key}", ":link-type: doc", ""]
        out += [", ".join(f"`{name}`" for name in group.scenarios), ":::", ""]
    out += ["::::", "", "```{toctree}", ":hidden:", "", *GROUPS, "```"]
    return "\n".join(out) + "\n"


def main(keys: Sequence[str] = ()) -> None:
    """Write the pages of some groups, or of all, and the index."""
    OUT.mkdir(exist_ok=True)
    for key in keys or GROUPS:
        drawn = draw(key, GROUPS[key])
        if drawn is None:
            print(f"{key}: RELNAV_DATA does not name the recorded data; left as it is")
            continue
        (OUT / f"{key}.md").write_text(page(key, GROUPS[key], *drawn), "utf-8")
        print(f"{key}: {', '.join(drawn[0])}", flush=True)
    (OUT / "index.md").write_text(index(), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
