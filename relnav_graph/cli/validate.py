"""``relnav validate``: every error of a scenario or data set, with its path."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from relnav_graph.cli.shared import show_events
from relnav_graph.core.cautions import Caution
from relnav_graph.io.parts import data_problems
from relnav_graph.runs.passes import known_of, open_dataset
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.json_schema import json_schema
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.schema import ScenarioError
from relnav_graph.scenario.toml import override, read_toml


@click.command("validate")
@click.argument("file", type=click.Path(path_type=Path), required=False)
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("--trust", is_flag=True, help="Let the data set name modules to import.")
@click.option("--schema", is_flag=True, help="Print the JSON Schema of scenarios and exit.")
def command(file: Path | None, assignments: tuple[str, ...], trust: bool, schema: bool) -> None:
    """Check FILE, a scenario or a data-set folder, and say what is in it."""
    if schema:
        click.echo(json.dumps(json_schema(), indent=2))
        return
    if file is None:
        raise click.UsageError("Missing argument 'FILE'.")
    if file.is_dir():
        show_events()
        opened = open_dataset(file, assignments, trust)
        _ = opened.problem  # it raises what is wrong with the recording
        counted: dict[str, int] = {}
        for m in opened.recording.measurements:
            counted[m.sensor] = counted.get(m.sensor, 0) + len(m.z)
        for name, count in counted.items():
            click.echo(f"{name}: {count} observations")
        click.echo(f"epochs: {len(opened.recording.times)}")
        _describe(file, opened.scenario, opened.problem.cautions)
    else:
        scenario = _scenario(file, assignments)
        scenario.check_truth()
        _describe(file, scenario, scenario.cautions)


def _scenario(file: Path, assignments: Sequence[str]) -> Scenario:
    """The scenario, with its readers checked, too. Raises ScenarioError with all that is wrong."""
    data = override(read_toml(file), assignments).get("data")
    problems = data_problems(data)
    try:
        scenario = load_scenario(file, assignments)
    except ScenarioError as error:
        raise ScenarioError(file.stem, [*error.problems, *problems]) from error
    problems = problems or data_problems(data, known_of(scenario))
    if problems:
        raise ScenarioError(file.stem, problems)
    return scenario


def _describe(file: Path, scenario: Scenario, cautions: Iterable[Caution]) -> None:
    blocks = ", ".join(f"{b.name} [{b.symbol}]" for b in scenario.layout)
    click.echo(f"state: {blocks} ({scenario.layout.dim} error states)")
    for caution in cautions:
        click.echo(f"caution: {caution}")
    click.echo(f"{file}: valid")
