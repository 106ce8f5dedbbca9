"""What a comparison leaves in a folder: results, summary, manifest, figures."""

from __future__ import annotations

import json
from pathlib import Path

from relnav_graph.core.models import derived_quantities
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.manifest import PassManifest
from relnav_graph.io.results import cautions_out, write_results
from relnav_graph.runs.comparison import Comparison
from relnav_graph.runs.passes import Pass

__all__ = ["write_outputs"]


def write_outputs(out: Path, opened: Pass, found: Comparison, command: str = "") -> None:
    """Write results, summary, manifest and figures into the folder `out`.

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
    write_results(out / "results.nc", found.tracks, opened.recording.truth, attributes)
    with atomic(out / "summary.json") as staged:
        staged.write_text(json.dumps(found.summary, indent=2, allow_nan=False) + "\n", "utf-8")
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
    from relnav_graph.figures import error_figures, save_figures, trajectory_figure

    derived = derived_quantities(opened.scenario.layout)
    figures = error_figures(found.tracks, opened.recording.truth, derived)
    path = trajectory_figure(found.tracks, opened.recording.truth, derived)
    if path is not None:
        figures["trajectory"] = path
    save_figures(figures, out / "figures")
