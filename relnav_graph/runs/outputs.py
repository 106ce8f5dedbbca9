"""What a comparison leaves in a folder: results, summary, manifest, maps, figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from relnav_graph.core.cautions import Caution
from relnav_graph.core.numbered import times_seen
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.left_out import write_left_out
from relnav_graph.io.manifest import PassManifest
from relnav_graph.io.maps import write_map
from relnav_graph.io.results import cautions_out, write_results
from relnav_graph.memory import uncollected
from relnav_graph.runs.comparison import Comparison
from relnav_graph.runs.passes import Pass
from relnav_graph.scoring.metrics import with_smoothed

__all__ = ["Drawing", "sights", "write_outputs"]


def sights(found: Comparison) -> dict[str, int]:
    """How many observations there are of each point of a map, by the name of its block."""
    problem = found.problems[0]
    return times_seen(problem.sensors, (m for e in problem.epochs for m in e.measurements))


@dataclass(frozen=True)
class Drawing:
    """Which rows are drawn, of those of the tracks, by default at most three that tell most, and in
    which formats, of png, svg and pdf; none: no figures."""

    rows: tuple[str, ...] = ()
    formats: tuple[str, ...] = ("svg", "png")


@uncollected()
def write_outputs(
    out: Path, opened: Pass, found: Comparison, command: str = "", drawing: Drawing = Drawing()
) -> None:
    """Write results, summary, manifest, maps and figures into the folder `out`.

    command: the command line that made them, for the manifest; drawing: see `Drawing`. Raises
    InputError when the folder cannot be made or written, or a row to draw is none.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o {out}: {error.strerror}") from error
    attributes = {
        "scenario": opened.scenario.name,
        "title": opened.scenario.file.title,
        "time_origin": f"{opened.scenario.file.time.origin!r} s",
        "cautions": cautions_out(
            Caution(c["name"], c["text"])
            for c in found.summary["cautions"]
            if c["estimator"] is None
        ),
    }
    if opened.scenario.file.time.epoch is not None:
        attributes["time_epoch"] = opened.scenario.file.time.epoch
        # Stamps tell when t = 0 is, not that axes are inertial: who writes [time] epoch says so.
        if opened.scenario.file.orbit is not None or opened.recording.epoch is None:
            attributes["o"] = "i" if opened.scenario.file.orbit is None else "RTN"
    if "noise" in found.summary:
        attributes["noise"] = json.dumps(found.summary["noise"])
    seen = sights(found)
    if seen:
        attributes["times_seen"] = json.dumps(seen)
    write_results(out / "results.nc", found.tracks, opened.recording.truth, attributes)
    with atomic(out / "summary.json") as staged:
        staged.write_text(json.dumps(found.summary, indent=2, allow_nan=False) + "\n", "utf-8")
    every = with_smoothed(found.tracks)
    write_map(out, every)
    write_left_out(out, every)
    PassManifest(
        opened.scenario.name,
        opened.scenario.raw,
        opened.seed,
        opened.run,
        opened.simulated,
        found.summary["versions"],
        command,
    ).write(out)
    if not drawing.formats:
        return
    # Only now: matplotlib takes half a second to import, and may be set up in a way that it
    # cannot be; what was estimated is then in the folder.
    from relnav_graph.figures import save_pass

    truth, derived = opened.recording.truth, opened.scenario.derived
    save_pass(found.tracks, truth, derived, out / "figures", seen, drawing.rows, drawing.formats)
