"""``relnav compare``: several estimators on the same pass."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from relnav_graph.cli.shared import (
    check_before_work,
    command_line,
    drawing,
    drawing_options,
    report,
    show_events,
    show_progress,
)
from relnav_graph.runs.comparison import compare_pass
from relnav_graph.runs.outputs import write_outputs
from relnav_graph.runs.passes import Pass, open_pass


@click.command("compare")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("-e", "--estimator", "kinds", multiple=True, help="Estimator; may be repeated.")
@click.option("--seed", type=click.IntRange(0), help="Root of the random numbers.")
@click.option("--run", "number", type=click.IntRange(0), default=0, help="Run of a study.")
@click.option("--data", type=click.Path(path_type=Path), help="RecordedSource data to use.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder for results.")
@drawing_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    scenario: Path,
    kinds: tuple[str, ...],
    seed: int | None,
    number: int,
    data: Path | None,
    assignments: tuple[str, ...],
    out: Path | None,
    draw: tuple[str, ...],
    formats: tuple[str, ...],
    as_json: bool,
) -> int:
    """Run estimators on SCENARIO and score them against the truth.

    The pass is simulated, or recorded (--data: a data set, or a folder for the reader
    that the scenario names). All estimators get the same measurements, models and prior. Of a
    scenario with a controller, each estimator flies a pass of its own, with the same noises.
    """
    check_before_work(kinds, out)
    show_events()
    opened = open_pass(scenario, seed, data, assignments, number, loops=True)
    return compared(opened, kinds or opened.scenario.file.estimators, out, draw, formats, as_json)


def compared(
    opened: Pass,
    kinds: Sequence[str],
    out: Path | None,
    draw: Sequence[str],
    formats: Sequence[str],
    as_json: bool,
) -> int:
    """Run estimators on a pass that is open, print their scores and write all into a folder, if one
    is named; the exit code."""
    drawn = drawing(draw, formats, kinds, ("svg", "png"))
    found = compare_pass(opened, kinds, show_progress)
    try:
        if out is not None:
            show_progress(f"writing {out} ...")
            write_outputs(out, opened, found, command_line(), drawn)
    finally:  # what was estimated is told even where it could not be written
        code = report(found.summary, as_json)
    return code
