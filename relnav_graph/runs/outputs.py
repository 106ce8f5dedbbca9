"""What a comparison leaves in a folder: results, summary, manifest, figures."""

from __future__ import annotations

import json
from pathlib import Path

from relnav_graph.core.models import derived_quantities
from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.io.manifest import PassManifest
from relnav_graph.io.results import write_results
from relnav_graph.runs.comparison import Comparison
from relnav_graph.runs.passes import Pass

__all__ = ["write_outputs"]


def write_outputs(out: Path, run: Pass, found: Comparison, command: str = "") -> None:
    """Write results, summary, manifest and figures into the folder `out`.

    command: what made them, for the manifest. Raises InputError on a folder that cannot be.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o {out}: {error.strerror}") from error
    attributes = {"scenario": run.scenario.name, "title": run.scenario.file.title}
    write_results(out / "results.nc", found.tracks, run.recording.truth, attributes)
    with atomic(out / "summary.json") as staged:
        staged.write_text(json.dumps(found.summary, indent=2, allow_nan=False) + "\n", "utf-8")
    PassManifest(
        run.scenario.name,
        run.scenario.raw,
        run.seed,
        run.run,
        run.simulated,
        found.summary["versions"],
        command,
    ).write(out)
    # Only now: matplotlib takes half a second to import, and may be set up in a way that it
    # cannot be; what was estimated is then in the folder.
    from relnav_graph.figures import error_figures, save_figures, trajectory_figure

    derived = derived_quantities(run.scenario.layout)
    figures = error_figures(found.tracks, run.recording.truth, derived)
    path = trajectory_figure(found.tracks, run.recording.truth, derived)
    if path is not None:
        figures["trajectory"] = path
    save_figures(figures, out / "figures")
