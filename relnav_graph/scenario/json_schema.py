"""The JSON Schema of scenario files, for editors.

A file that builds on another (`base`), or whose data bring settings ([data]), may hold parts of
tables; any other one must be whole. What needs the models' own judgement (units, signs, names of
blocks) is left to `relnav validate`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from pydantic import TypeAdapter

from relnav_graph.core import models
from relnav_graph.core.contracts import Dynamics, ReadsCopies, Sensor
from relnav_graph.maths.orbit import KeplerOrbit
from relnav_graph.registry import classes, provides
from relnav_graph.scenario.schema import ScenarioFile
from relnav_graph.scenario.settings import SensorOptions
from relnav_graph.sim.contracts import GROUP as TRUTHS
from relnav_graph.sim.contracts import Instrument, KnownInput, PlannedInput

__all__ = ["json_schema"]

Schema = dict[str, Any]
#: A table without which the base's one stands: "processes.NAME = false" takes it out.
_REMOVED: Schema = {"const": False}
#: A model of somebody's module, of which nothing is known here.
_MODULE: Schema = {
    "type": "object",
    "properties": {"kind": {"type": "string", "pattern": ":"}},
    "required": ["kind"],
}


_KEYFRAMES: Schema = {
    "description": "times of the epochs that loops are closed to; strings may name a unit",
    "type": "array",
    "items": {"anyOf": [{"type": "number"}, {"type": "string"}]},
}


def json_schema() -> Schema:
    """JSON Schema (2020-12) of scenario files, with all registered models."""
    schema = ScenarioFile.model_json_schema()
    own_options = SensorOptions.model_json_schema()
    schema["$defs"] |= own_options.pop("$defs", {})
    options, whole, part = own_options["properties"], Schema(), Schema()
    for section, group, contracts, general in (
        ("processes", models.ENTRY_POINTS, (Dynamics,), {}),
        ("sensors", models.ENTRY_POINTS, (Sensor,), options),
        ("inputs", TRUTHS, (Instrument, KnownInput, PlannedInput), {}),
    ):
        choices = _choices(schema["$defs"], group, contracts, general)
        parts = [_partial(choice) for choice in choices]
        whole[section] = {"additionalProperties": {"anyOf": [*choices, _MODULE]}}
        part[section] = {"additionalProperties": {"anyOf": [_REMOVED, *parts, _MODULE]}}
        schema["properties"][section] = {"type": "object", "description": f"{section}, by name"}
    for section in ("prior", "stamps", "gaps"):
        rows = schema["properties"][section]["additionalProperties"]
        schema["properties"][section] = {"type": "object", "description": f"{section}, by name"}
        whole[section] = {"additionalProperties": rows}
        part[section] = {"additionalProperties": {"anyOf": [_REMOVED, rows]}}
    required = schema.pop("required")
    text = {"type": "string"}
    schema["properties"]["base"] = {
        "description": "the scenario, or scenarios, that this one changes; later ones win",
        "anyOf": [text, {"type": "array", "items": text, "minItems": 1}],
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "if": {"anyOf": [{"required": ["base"]}, {"required": ["data"]}]},
        "then": {"properties": part},
        "else": {"properties": whole, "required": required},
    }


def _choices(
    defs: Schema, group: str, contracts: Sequence[type], general: Mapping[str, Any]
) -> list[Schema]:
    """The schemas of all models of a group that keep one of some contracts; what they refer to goes
    to `defs`."""
    choices, elements = [], [field.name for field in fields(KeplerOrbit)]
    for kind, cls in classes(group).items():
        if any(provides(cls, contract) for contract in contracts):
            choice = TypeAdapter(cls).json_schema()
            defs |= choice.pop("$defs", {})
            own = choice.get("properties", {})
            loops = {"keyframes": _KEYFRAMES} if provides(cls, ReadsCopies) else {}
            choice["properties"] = {"kind": {"const": kind}, **general, **loops, **own}
            # The scenario's [orbit] serves all models that ask for one, or for its elements, and
            # its keyframes give a sensor for each.
            given = {"orbit", "keyframe", *(elements if "semi_major_axis" in own else ())}
            required = [n for n in choice.get("required", []) if n not in given]
            choice["required"] = ["kind", *required]
            choice["additionalProperties"] = False
            choices.append(choice)
    return choices


def _partial(choice: Schema) -> Schema:
    """A table of which the rest, its kind maybe, comes from elsewhere."""
    return {k: v for k, v in choice.items() if k != "required"}
