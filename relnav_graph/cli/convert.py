"""``relnav convert``: between data folders, data sets, results and files of others."""

from __future__ import annotations

from pathlib import Path

import click

from relnav_graph.cli.shared import show_events, show_progress
from relnav_graph.errors import InputError
from relnav_graph.io.dataset import Format
from relnav_graph.io.readers import by_suffix
from relnav_graph.runs.conversions import convert_orbits, convert_results, write_pass
from relnav_graph.runs.passes import is_dataset, open_dataset, open_pass
from relnav_graph.scenario.toml import override


@click.command("convert")
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option("--to", metavar="FORMAT", default="", help="Of OUT, else by its suffix: a writer.")
@click.option("--track", default="", help="Of results with several, also NAME_smoothed.")
@click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Of the writer.")
@click.option("--target", "orbit", type=click.Path(path_type=Path), help="The target's orbit.")
@click.option("--scenario", type=click.Path(path_type=Path), help="For raw data: their scenario.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("--trust", is_flag=True, help="Let the data set name modules to import.")
@click.option("--parquet", is_flag=True, help="Parquet tables instead of CSV (extra: data).")
def command(
    source: Path,
    target: Path,
    to: str,
    track: str,
    options: tuple[str, ...],
    orbit: Path | None,
    scenario: Path | None,
    assignments: tuple[str, ...],
    trust: bool,
    parquet: bool,
) -> None:
    """Convert IN to OUT.

    \b
    results.nc        -> folder of CSV tables, one per estimator; so of a folder that has one
    results.nc        -> NAME.csv, of one --track
    results.nc        -> file of another format, by a writer (see relnav list): OEM, AEM, ...
    data set          -> data set (CSV or, with --parquet, Parquet tables)
    raw data folder   -> data set, by the reader that --scenario names
    chaser.oem        -> folder of true orbits, with --target target.oem of relative ones;
                         with --scenario a data set
    """  # noqa: D301  click wants the character itself
    tables: Format = "parquet" if parquet else "csv"
    stored = source / "results.nc"
    if scenario is None and stored.is_file() and not is_dataset(source):
        source = stored
    if source.is_file() and by_suffix(source) is not None:
        show_events()
        show_progress(convert_orbits(source, target, orbit, scenario, tables))
        return
    if source.is_file():
        if parquet and not to:
            to = "parquet"
        show_progress(convert_results(source, target, to, track, override({}, options)))
        return
    if to:
        raise InputError(f"--to {to}: found {source}, expected a file of results")
    show_events()
    if is_dataset(source):
        opened = open_dataset(source, assignments, trust)
    elif scenario is not None:
        opened = open_pass(scenario, None, source, assignments)
    elif source.is_dir():
        raise InputError(f"{source}: no scenario.toml in it; a raw folder needs --scenario")
    else:
        raise InputError(f"{source}: found nothing, expected a results file or a folder")
    show_progress(f"{target}: {write_pass(opened, target, tables)} epochs")
