"""``relnav list``: what there is."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import textwrap
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import get_args, get_type_hints

import click
import numpy as np

from relnav_graph import estimators
from relnav_graph.core import models
from relnav_graph.core.contracts import Derived, Dynamics, Sensor
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.registry import classes, provides
from relnav_graph.runs.described import FORMATS, MUST, states_of
from relnav_graph.scenario.keys import tables
from relnav_graph.scenario.shipped import shipped
from relnav_graph.scenario.toml import read_toml
from relnav_graph.sim.contracts import GROUP as TRUTHS
from relnav_graph.units import quantities


def _first_line(thing: object) -> str:
    return (inspect.getdoc(thing) or "").split("\n")[0]


def _section(title: str, rows: dict[str, str]) -> None:
    click.echo(title)
    width = max((len(name) for name in rows), default=0)
    for name, text in rows.items():
        click.echo(f"  {name:{width}}  {text}")
    click.echo()


def _default(field: dataclasses.Field[object]) -> str:
    """A field's default in words, "" where it must be given."""
    value = field.default
    if field.default_factory is not dataclasses.MISSING:
        value = np.asarray(field.default_factory()).tolist()
    if value is dataclasses.MISSING:
        return ""
    return "may be left out" if value is None else f"default {value!r}"


def _choice(hint: object) -> str:
    """One of a field's choices: a word, or a type."""
    return hint.__name__ if isinstance(hint, type) else repr(hint)


def _describe(kind: str, cls: type) -> None:
    """What a kind is, and its parameters with units and defaults."""
    click.echo(f"{kind}\n\n{inspect.getdoc(cls) or ''}\n")
    known, rows = quantities(cls), dict[str, str]()
    hints = get_type_hints(cls)
    for field in dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ():
        if field.name in known:
            what = known[field.name].in_words()
        else:
            what = " or ".join(
                map(
                    _choice,
                    [a for a in get_args(hints[field.name]) if a is not type(None)]
                    or [hints[field.name]],
                )
            )
        rows[field.name] = "; ".join(part for part in (what, _default(field)) if part)
    if rows:
        _section("Parameters", rows)


def _describe_state(name: str, blocks: Mapping[Block, Mapping[str, list[str]]]) -> None:
    """What a state is, and which models advance and read it."""
    click.echo(f"{name}, a state\n")
    for block, by in blocks.items():
        numbers = "an attitude (SO3), 3 axes" if block.manifold == "SO3" else f"{block.dim} numbers"
        numbers = "1 number" if numbers == "1 numbers" else numbers
        unit = "without a unit" if block.unit == "1" else f"in {block.unit}"
        axes = f", frame {block.frame}" if block.frame != "-" else ""
        rows = {"advanced by": ", ".join(by["advances"]) or "none by default: a constant then"}
        rows["read by"] = ", ".join(by["reads"]) or "none by default"
        _section(f"{block.symbol}: {numbers}, {unit}{axes}", rows)
    click.echo("Parameters of a model may add to these: relnav list KIND says which it has.")


def _summaries(found: Mapping[str, str], what: str) -> dict[str, str]:
    """The first sentence of each module's docstring; of one that cannot be imported, why."""
    rows = {}
    for name, module in found.items():
        try:
            text = inspect.getdoc(importlib.import_module(module)) or ""
        except (Exception, SystemExit) as error:  # it may be a stranger's code
            text = f"cannot be imported: {type(error).__name__}: {error}"
        first = " ".join(text.split("\n\n")[0].split())
        rows[name] = first.removeprefix(f"{what} of ").removesuffix(".")
    return rows


def _describe_format(name: str) -> None:
    """What reads and what writes files of a name, with the options of both."""
    for what, one in FORMATS.items():
        if name not in one.names():
            continue
        texts, options = one.described(name)
        click.echo(f"{name}, a {what.lower()}\n\n{texts.pop('')}\n")
        if options:
            _section("Options", {n: f"default {d}" if d else MUST for n, d in options.items()})
        for where, text in texts.items():
            click.echo(f"{where}\n\n{textwrap.indent(text, '  ')}\n")


def _describe_keys() -> None:
    """The keys of a scenario file."""
    for table in tables():
        click.echo(f"{table.name}\n\n{textwrap.indent(table.text, '  ')}\n")
        rows = {}
        for key in table.keys:
            default = key.default and f"default {key.default}"
            rows[key.name] = "; ".join(part for part in (key.type, key.text, default) if part)
        _section("  Keys", {f"  {name}": text for name, text in rows.items()})


@click.command("list")
@click.argument("what", metavar="[FOLDER|KIND|STATE|FORMAT|scenario]", required=False)
def command(what: str | None) -> None:
    """List models, estimators, truths, readers, writers, and the scenarios in FOLDER.

    Without one, the scenarios that come with the package, which every command finds by name. Of a
    KIND of model, truth, instrument or estimator: what it is, and its parameters. Of a STATE, such
    as gyro_bias: its unit and axes, and which models advance and read it. Of a FORMAT that is read
    or written: how, and its options. Of the word scenario: the keys of a scenario file.
    """
    folder = None if what is None else Path(what)
    found = classes(models.ENTRY_POINTS)
    every = {**found, **classes(estimators.GROUP), **classes(TRUTHS)}
    states = {} if what is None else states_of(found)
    if what in every or what in states:
        if what in every:
            _describe(what, every[what])
        if what in states:
            _describe_state(what, states[what])
        return
    formats = [name for one in FORMATS.values() for name in one.names()]
    if what == "scenario":
        _describe_keys()
        return
    if what in formats:
        _describe_format(what)
        return
    if folder is not None and not folder.is_dir():
        near = get_close_matches(str(what), [*every, *states, *formats, "scenario"], 1)
        hint = f"; is it {near[0]}?" if near else ""
        raise InputError(f"{folder}: no such folder, kind, state or format{hint}")
    for title, contract in (
        ("Sensors", Sensor),
        ("Dynamics", Dynamics),
        ("Derived quantities", Derived),
    ):
        _section(title, {k: _first_line(c) for k, c in found.items() if provides(c, contract)})
    for title, group in (("Estimators", estimators.GROUP), ("Truth and inputs", TRUTHS)):
        _section(title, {k: _first_line(c) for k, c in classes(group).items()})
    for title, one in FORMATS.items():
        _section(f"{title}s", _summaries(one.names(), title))
    files = shipped() if folder is None else {str(p): p for p in sorted(folder.glob("*.toml"))}
    scenarios = {}
    for name, path in files.items():
        try:
            scenarios[name] = str(read_toml(path).get("title", ""))
        except InputError as error:
            scenarios[name] = str(error).replace("\n", " ")
    _section("Scenarios, by name" if folder is None else f"Scenarios in {folder}", scenarios)
