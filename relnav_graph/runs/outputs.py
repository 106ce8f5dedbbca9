"""What a comparison leaves in a folder: results, summary, manifest, maps, figures."""

from __future__ import annotations

import json
from pathlib import Path

from relnav_graph.core.numbered import times_seen
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.left_out import write_left_out
from relnav_graph.io.manifest import PassManifest
from relnav_graph.io.maps import write_map
from relnav_graph.io.results import cautions_out, write_results
from relnav_graph.runs.comparison import Comparison
from relnav_graph.runs.passes import Pass
from relnav_graph.scoring.metrics import with_smoothed

__all__ = ["sights", "write_outputs"]


def sights(found: Comparison) -> dict[str, int]:
    """How many observations there are of each point of a map, by the name of its block."""
    problem = found.problems[0]
    return times_seen(problem.sensors, (m for e in problem.epochs for m in e.measurements))


def write_outputs(out: Path, opened: Pass, found: Comparison, command: str = "") -> None:
    """Write results, summary, manifest, maps and figures into the folder `out`.

    command: the command line that made them, for the manifest. Raises InputError when the
    folder cannot be made or written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o {out}: {error.strerror}") from error
    attributes = {
        "scenario": opened.scenario.name,
        "title": opened.scenario.file.title,
        "time_origin": f"{opened.scenario.file.time.origin!r} s",
        "cautions": cautions_out(found.problems[0].cautions),
    }
    if opened.scenario.file.time.epoch is not None:
        attributes["time_epoch"] = opened.scenario.file.time.epoch
        attributes["o"] = "i" if opened.scenario.file.orbit is None else "RTN"
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
    # Only now: matplotlib takes half a second to import, and may be set up in a way that it
    # cannot be; what was estimated is then in the folder.
    from relnav_graph.figures import (
        error_figures,
        map_figure,
        save_figures,
        trajectory_figure,
    )

    derived = opened.scenario.derived
    figures = error_figures(found.tracks, opened.recording.truth, derived)
    path = trajectory_figure(found.tracks, opened.recording.truth, derived)
    if path is not None:
        figures["trajectory"] = path
    points = map_figure(found.tracks, opened.recording.truth, seen)
    if points is not None:
        figures["map"] = points
    save_figures(figures, out / "figures")
