"""``relnav simulate``: a scenario into a data set, or into the lines of a stream."""

from __future__ import annotations

from pathlib import Path

import click

from relnav_graph.cli.shared import show_events, show_progress
from relnav_graph.io.dataset import Format, write_dataset
from relnav_graph.scenario.build import load_scenario
from relnav_graph.streaming.writing import recording_lines


@click.command("simulate")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--seed", type=click.IntRange(0), help="Root of the random numbers.")
@click.option("--run", "number", type=click.IntRange(0), default=0, help="Run of a study.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option(
    *("-o", "--out"),
    type=click.Path(path_type=Path, allow_dash=True),
    required=True,
    help="Data set; - for the lines that `relnav stream` reads.",
)
@click.option("--parquet", is_flag=True, help="Parquet tables instead of CSV (extra: data).")
def command(
    scenario: Path,
    seed: int | None,
    number: int,
    assignments: tuple[str, ...],
    out: Path,
    parquet: bool,
) -> None:
    """Simulate SCENARIO and write measurements, inputs and truth as a data set.

    With -o -, measurements and inputs go to standard output as JSON lines, in order of
    arrival, for `relnav stream`; their first line gives the prior that `relnav compare` draws.
    """
    show_events()
    loaded = load_scenario(scenario, assignments)
    seed = loaded.file.seed if seed is None else seed
    recording = loaded.simulate(seed, number)
    if str(out) == "-":
        prior = loaded.problem(recording, seed, number).prior
        stamped = recording.shifted(loaded.file.time.origin)
        for line in recording_lines(stamped, loaded.name, seed, loaded.layout, prior):
            click.echo(line)
        return
    blocks = {b.name: b for b in loaded.layout}
    raw = {**loaded.raw, "seed": seed}
    tables: Format = "parquet" if parquet else "csv"
    write_dataset(
        out,
        raw,
        recording,
        loaded.sensors,
        loaded.input_columns,
        blocks,
        tables,
        loaded.file.time.origin,
    )
    show_progress(f"{out}: {len(recording.times)} epochs, seed {seed}")
