"""``relnav smooth``: offline post-pass smoothing of recorded data."""

from __future__ import annotations

from pathlib import Path

import click

from relnav_graph.cli.compare import compared
from relnav_graph.cli.shared import check_before_work, drawing_options, show_events
from relnav_graph.runs.passes import open_dataset


@click.command("smooth")
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option("-e", "--estimator", "kinds", multiple=True, help="Estimator; may be repeated.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), required=True, help="Folder for results."
)
@click.option("--trust", is_flag=True, help="Let the data set name modules to import.")
@drawing_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    dataset: Path,
    kinds: tuple[str, ...],
    assignments: tuple[str, ...],
    out: Path,
    trust: bool,
    draw: tuple[str, ...],
    formats: tuple[str, ...],
    as_json: bool,
) -> int:
    """Smooth the pass recorded in DATASET, by the scenario that lies in it."""
    check_before_work(kinds, out)
    show_events()
    opened = open_dataset(dataset, assignments, trust)
    return compared(opened, kinds or ("batch",), out, draw, formats, as_json)
