"""``relnav smooth``: offline post-pass smoothing of recorded data."""

from __future__ import annotations

from pathlib import Path

import click

from relnav_graph.commands import check_before_work, estimate, open_dataset, report, write_outputs


@click.command("smooth")
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option("-e", "--estimator", "kinds", multiple=True, help="Estimator; may be repeated.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), required=True, help="Folder for results."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    dataset: Path,
    kinds: tuple[str, ...],
    assignments: tuple[str, ...],
    out: Path,
    as_json: bool,
) -> int:
    """Smooth the pass recorded in DATASET, by the scenario that lies in it."""
    check_before_work(kinds, out)
    run = open_dataset(dataset, assignments)
    tracks, found = estimate(run, kinds or ("batch",))
    write_outputs(out, run, tracks, found)
    return report(found, as_json)
