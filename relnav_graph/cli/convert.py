"""``relnav convert``: between data folders, data sets and results."""

from __future__ import annotations

from pathlib import Path

import click

from relnav_graph.cli.shared import show_events, show_progress
from relnav_graph.errors import InputError
from relnav_graph.io.dataset import Format, write_dataset
from relnav_graph.io.results import read_results
from relnav_graph.io.track_tables import write_csv
from relnav_graph.runs.passes import is_dataset, open_dataset, open_pass


@click.command("convert")
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option("--scenario", type=click.Path(path_type=Path), help="For a raw folder: its scenario.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("--trust", is_flag=True, help="Let the data set name modules to import.")
@click.option("--parquet", is_flag=True, help="Parquet tables instead of CSV (extra: data).")
def command(
    source: Path,
    target: Path,
    scenario: Path | None,
    assignments: tuple[str, ...],
    trust: bool,
    parquet: bool,
) -> None:
    """Convert IN to OUT.

    \b
    results.nc        -> folder of CSV tables, one per estimator
    data set          -> data set (CSV or, with --parquet, Parquet tables)
    raw data folder   -> data set, by the reader that --scenario names
    """  # noqa: D301  click wants the character itself
    if source.is_file():
        tracks, _, _ = read_results(source)
        write_csv(target, tracks)
        show_progress(f"{target}: {len(tracks)} tracks")
        return
    show_events()
    if is_dataset(source):
        opened = open_dataset(source, assignments, trust)
    elif scenario is not None:
        opened = open_pass(scenario, None, source, assignments)
    elif source.is_dir():
        raise InputError(f"{source}: no scenario.toml in it; a raw folder needs --scenario")
    else:
        raise InputError(f"{source}: found nothing, expected a results file or a folder")
    blocks = {b.name: b for b in opened.scenario.layout}
    tables: Format = "parquet" if parquet else "csv"
    s = opened.scenario
    stamped = opened.recording.shifted(s.file.time.origin)
    write_dataset(
        target, s.raw, stamped, s.sensors, s.input_columns, blocks, tables, s.file.time.origin
    )
    show_progress(f"{target}: {len(opened.recording.times)} epochs")
