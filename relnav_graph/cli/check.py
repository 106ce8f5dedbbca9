"""``relnav check``: whether a model keeps its contract."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import click

from relnav_graph.core import models
from relnav_graph.core.conformance.checks import Checked, check_example
from relnav_graph.core.conformance.examples import Example, example_of
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.registry import find_class, look_beside
from relnav_graph.scenario.schema import Problems, ScenarioError, make_kind
from relnav_graph.scenario.toml import override, read_toml


def _examples(kind: str, table: dict[str, Any]) -> Iterator[Example]:
    """Of what a model is checked: an instance made of settings, or its own examples."""
    cls = find_class(models.ENTRY_POINTS, kind)
    if not table and hasattr(cls, "example"):
        own = cls.example()
        for one in own if isinstance(own, Iterable) else [own]:
            yield example_of(one)
        return
    problems: Problems = []
    made = make_kind(models.ENTRY_POINTS, "model", {"kind": kind, **table}, problems)
    if problems:
        problems.append(
            ("", "--set KEY=VALUE or --file gives values, or a classmethod `example()`")
        )
        raise ScenarioError(kind, problems)
    yield example_of(made)


def _checked(example: Example, count: int, seed: int) -> Iterator[Checked]:
    """The checks, ended by what the model raises."""
    try:
        yield from check_example(example, count, seed)
    except Exception as error:  # of a stranger's code
        what = str(error) if isinstance(error, RelnavError) else f"{type(error).__name__}: {error}"
        raise InputError(f"{type(example.model).__name__}: raised {what}") from error


def _tell(found: Checked) -> None:
    click.echo(f"{'FAIL' if found.faults else 'ok':4}  {found.name}: {found.looked}")
    for fault in found.faults:
        click.echo(f"      {fault.regime}: {fault.where}: {fault.text}")


@click.command("check")
@click.argument("model")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="A parameter.")
@click.option("--file", type=click.Path(path_type=Path), help="Parameters, as a TOML file.")
@click.option("--states", type=click.IntRange(1), default=34, help="States in each regime.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Root of the random states.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    model: str,
    assignments: tuple[str, ...],
    file: Path | None,
    states: int,
    seed: int,
    as_json: bool,
) -> int:
    """Check MODEL, a kind or module:Class (here, or importable): outputs filled, Jacobians, noise.

    Near the identity, moderately, and at large rotations and residuals. Looks at what the model's
    classmethod `example()` gives, or at one of the parameters given. Exit code 3: it fails.
    """
    look_beside(Path(), [model])
    table = override({} if file is None else read_toml(file), assignments)
    everything = []
    for example in _examples(model, table):
        for found in _checked(example, states, seed):
            everything.append(found)
            if not as_json:
                _tell(found)
    failed = [fault for found in everything for fault in found.faults]
    if as_json:
        checks = [{"name": c.name, "faults": [vars(f) for f in c.faults]} for c in everything]
        click.echo(json.dumps({"schema": 1, "model": model, "checks": checks}))
    return 3 if failed else 0
