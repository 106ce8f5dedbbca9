"""What was simulated or recorded, and by which models it was estimated, in words."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import tomli_w

from relnav_graph.core.copies import closure_of
from relnav_graph.report.cells import Cell, Table
from relnav_graph.report.figures import plain
from relnav_graph.scenario.scenario import Scenario

__all__ = ["models", "orbit", "prior", "simulated", "toml"]

#: Values longer than this are in the scenario's tables at the end of the report.
_LONG = 60
_MEANS = {"drawn": "drawn about the truth", "truth": "the truth"}


def _says(model: Any) -> str:
    """The first sentence of a model's documentation."""
    text = " ".join((inspect.getdoc(type(model)) or "").split("\n\n")[0].split())
    return text.partition(". ")[0].removesuffix(".") + "."


def _value(value: Any) -> str:
    if isinstance(value, list) and value and isinstance(value[0], list):
        return f"{len(value)} rows"
    text = f"[{', '.join(map(str, value))}]" if isinstance(value, list) else str(value)
    return text if len(text) <= _LONG else f"{text[:_LONG]} …"


def _parameters(table: Mapping[str, Any]) -> str:
    return ", ".join(f"{k} = {_value(v)}" for k, v in table.items() if k != "kind") or "–"


_HEAD = ("", "name", "kind", "what it is", "parameters")


def _model(what: str, name: str, model: Any, table: Mapping[str, Any]) -> list[Cell]:
    texts = (Cell(_says(model)), Cell(_parameters(table)))
    return [Cell(what), Cell(name, "strong"), Cell(model.kind, "code"), *texts]


def models(scenario: Scenario) -> Table:
    """Processes and sensors that the estimators assume, with their parameters."""
    body = []
    for what, section, found in (
        ("process", "processes", scenario.processes),
        ("sensor", "sensors", scenario.sensors),
    ):
        for name, model in found.items():
            closure = closure_of(name, model)  # one of those that a table stands for, or none
            table = name if closure is None else closure[0]
            body.append(_model(what, name, model, scenario.raw[section].get(table, {})))
    return Table(_HEAD, body, 5)


def simulated(scenario: Scenario) -> Table | None:
    """Truth, control and inputs, where they are simulated."""
    if scenario.truth is None:
        return None
    pairs = [("truth", "", scenario.truth, scenario.raw["truth"])]
    if scenario.control is not None:
        pairs.append(("control", "", scenario.control, scenario.raw["control"]))
    pairs += [("input", n, m, scenario.raw["inputs"][n]) for n, m in scenario.inputs.items()]
    return Table(_HEAD, [_model(*pair) for pair in pairs], 5)


def prior(scenario: Scenario) -> Table:
    """What is known at the first epoch."""
    body = []
    for block in scenario.layout:
        one = scenario.file.prior[block.name]
        mean = _MEANS.get(str(one.mean), _value(one.mean))
        texts = (block.frame[-1:], _value(one.sigma), mean)
        body.append([Cell(plain(block.name), "strong"), *map(Cell, texts)])
    return Table(["state", "frame", "1-sigma", "mean"], body, 4)


def orbit(scenario: Scenario) -> str:
    """The orbit of the target, as the scenario states it, in words; empty without one."""
    table = scenario.raw.get("orbit")
    if not table:
        return ""
    said = ", ".join(f"{k.replace('_', ' ')} {_value(v)}" for k, v in table.items())
    return f"Orbit of the target: {said}. Numbers without a unit are in SI units and radians."


def toml(scenario: Scenario) -> str:
    """The scenario's tables as they were used, settings and changes included."""
    return tomli_w.dumps(dict(scenario.raw))
