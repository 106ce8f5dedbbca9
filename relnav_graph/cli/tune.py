"""``relnav tune``: noise parameters from the residuals of a pass."""

from __future__ import annotations

import json
from pathlib import Path

import click

from relnav_graph.cli.shared import check_fragment, command_line, show_events, show_progress
from relnav_graph.io.atomic import atomic
from relnav_graph.runs.passes import open_pass
from relnav_graph.runs.warm_up import warm_up
from relnav_graph.scoring.noise_text import tune_table
from relnav_graph.study.tune import MARK, fragment, tune


@click.command("tune")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--seed", type=click.IntRange(0), help="Root of the random numbers.")
@click.option("--run", "number", type=click.IntRange(0), default=0, help="Run of a study.")
@click.option("--data", type=click.Path(path_type=Path), help="Recorded data to use.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="TOML file for the noises that were told."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    scenario: Path,
    seed: int | None,
    number: int,
    data: Path | None,
    assignments: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> int:
    """Find the noise parameters of SCENARIO from the residuals of a pass.

    The truth is not used. What is found goes, with -o, into a file that a scenario takes by
    `base`; noises that the pass cannot tell stay as they are declared.
    """
    check_fragment(out, MARK)
    show_events()
    opened = open_pass(scenario, seed, data, assignments, number)
    warm_up(opened, ("batch",))
    found = tune(opened, show_progress)
    if out is not None:
        with atomic(out) as staged:
            staged.write_text(fragment(found, command_line()), "utf-8")
    click.echo(json.dumps(found, allow_nan=False) if as_json else tune_table(found), nl=as_json)
    return 0
