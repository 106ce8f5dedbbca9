"""``relnav explain``: what the sensors of a scenario can tell, before any data."""

from __future__ import annotations

import json
from pathlib import Path

import click

from relnav_graph.arrays import Array
from relnav_graph.cli.shared import show_events, show_progress
from relnav_graph.core.models import derived_quantities
from relnav_graph.errors import InputError
from relnav_graph.estimators import try_estimator
from relnav_graph.runs.passes import Pass, open_pass
from relnav_graph.scoring.bounds import true_trajectory


def _nominal(opened: Pass) -> Array:
    """The truth; of recorded data without one, the batch estimate."""
    try:
        return true_trajectory(opened.problem, opened.recording.truth)
    except InputError as error:
        show_progress(f"{error}: linearised at the batch estimate instead")
    track = try_estimator("batch", opened.problem)
    if track.status == "diverged":
        raise InputError(f"{opened.scenario.name}: no trajectory to linearise at: {track.message}")
    return track.states


@click.command("explain")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--seed", type=click.IntRange(0), help="Root of the random numbers.")
@click.option("--data", type=click.Path(path_type=Path), help="RecordedSource data to use.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    scenario: Path,
    seed: int | None,
    data: Path | None,
    assignments: tuple[str, ...],
    as_json: bool,
) -> None:
    """Say what each sensor and process of SCENARIO means, and what to expect of them.

    Noises are shown after discretisation. The 1-sigma of filter and smoother, and the
    directions that are weak or not observable, follow from the information along the
    true trajectory of a simulated pass (or along an estimate, where --data has no truth).
    """
    from relnav_graph.scoring.observability import explain
    from relnav_graph.scoring.text import explain_table

    show_events()
    opened = open_pass(scenario, seed, data, assignments)
    found = explain(
        opened.scenario.name,
        opened.problem,
        _nominal(opened),
        derived_quantities(opened.scenario.layout),
        opened.scenario.window(opened.problem.times),
    )
    click.echo(json.dumps(found, allow_nan=False) if as_json else explain_table(found))
