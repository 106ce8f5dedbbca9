"""``relnav list``: what there is."""

from __future__ import annotations

import inspect
from pathlib import Path

import click

from relnav_graph import estimators
from relnav_graph.core import models
from relnav_graph.core.contracts import Derived, Dynamics, Sensor
from relnav_graph.errors import InputError
from relnav_graph.io.readers import readers
from relnav_graph.io.writers import writers
from relnav_graph.registry import classes, provides
from relnav_graph.scenario.shipped import shipped
from relnav_graph.scenario.toml import read_toml
from relnav_graph.sim.contracts import GROUP as TRUTHS


def _first_line(thing: object) -> str:
    return (inspect.getdoc(thing) or "").split("\n")[0]


def _section(title: str, rows: dict[str, str]) -> None:
    click.echo(title)
    width = max((len(name) for name in rows), default=0)
    for name, text in rows.items():
        click.echo(f"  {name:{width}}  {text}")
    click.echo()


@click.command("list")
@click.argument("folder", type=click.Path(path_type=Path), required=False)
def command(folder: Path | None) -> None:
    """List models, estimators, truths, readers, writers, and the scenarios in FOLDER.

    Without one, the scenarios that come with the package, which every command finds by name.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    found = classes(models.ENTRY_POINTS)
    for title, contract in (
        ("Sensors", Sensor),
        ("Dynamics", Dynamics),
        ("Derived quantities", Derived),
    ):
        _section(title, {k: _first_line(c) for k, c in found.items() if provides(c, contract)})
    for title, group in (("Estimators", estimators.GROUP), ("Truth and inputs", TRUTHS)):
        _section(title, {k: _first_line(c) for k, c in classes(group).items()})
    _section("Readers of recorded data", dict.fromkeys(readers(), ""))
    _section("Writers of tracks", dict.fromkeys(writers(), ""))
    files = shipped() if folder is None else {str(p): p for p in sorted(folder.glob("*.toml"))}
    scenarios = {}
    for name, path in files.items():
        try:
            scenarios[name] = str(read_toml(path).get("title", ""))
        except InputError as error:
            scenarios[name] = str(error).replace("\n", " ")
    _section("Scenarios, by name" if folder is None else f"Scenarios in {folder}", scenarios)
