"""The keys of a scenario file in words, from its JSON Schema: for `relnav list scenario`, and for
the documentation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from relnav_graph.scenario.json_schema import json_schema
from relnav_graph.scenario.settings import SensorOptions

__all__ = ["Key", "KeyTable", "tables"]

#: What stands at the top of a scenario file; the schema says of it what it may be.
_TOP: Mapping[str, str] = {
    "title": "a line, with the name of the scenario before a colon",
    "description": "what it is, and where its numbers are from",
    "base": "the scenario, or scenarios, that this one changes; later ones win",
    "seed": "root of all random numbers",
    "estimators": "those that `relnav compare` runs, where none is named",
    "evaluate": "the part of the pass that is scored, as fractions or times",
    "time": "step, epochs, absolute time",
    "data": "recorded data, and how they are read",
    "online": "the window of what runs online",
    "orbit": "of the target; the chaser's own where it is estimated",
    "truth": "what is true in a simulated pass, `statics` and `map` of recorded ones, too",
    "truth_noise": "one sigma of a truth that was measured",
    "score": "axes in which vectors are compared, blocks that are left out",
    "control": "the controller of a loop",
    "inputs": "instruments, such as a gyro, by name: how they are simulated",
    "gaps": "how gaps of an input are bridged, by its name",
    "stamps": "lag and jitter of clocks, by name of an input or a sensor",
    "processes": "how states go on, by name: any of the processes",
    "sensors": "what is measured, by name: any of the sensors, with gate, loss, period",
    "prior": "what is known beforehand, by the name of a state",
}


@dataclass(frozen=True)
class Key:
    """A key: its name, what it may be, what it is, and its default, "" where there is none."""

    name: str
    type: str
    text: str
    default: str


@dataclass(frozen=True)
class KeyTable:
    """A table, or the top level: its name, what is said of it, and its keys."""

    name: str
    text: str
    keys: tuple[Key, ...]


def tables() -> list[KeyTable]:
    """The top level, and each table that is no model's. Models have keys of their own, by kind."""
    schema = json_schema()
    found = [KeyTable("Top level", schema["description"], _keys(schema["properties"], _TOP))]
    for name, one in schema["$defs"].items():
        if "properties" in one:
            found.append(KeyTable(name, one.get("description", ""), _keys(one["properties"], {})))
    own = SensorOptions.model_json_schema()
    found.append(KeyTable("Any sensor", own["description"], _keys(own["properties"], {})))
    return found


def _keys(properties: Mapping[str, Any], about: Mapping[str, str]) -> tuple[Key, ...]:
    found = []
    for name, schema in properties.items():
        default = schema.get("default")
        plain = isinstance(default, int | float | str) and default != ""
        text = about.get(name) or str(schema.get("description", ""))
        found.append(Key(name, _type(schema), text, repr(default) if plain else ""))
    return tuple(found)


def _type(schema: Mapping[str, Any]) -> str:
    """The type that a piece of the schema allows, in words."""
    if "$ref" in schema:
        return f"table, see {schema['$ref'].rsplit('/', 1)[1]}"
    if "enum" in schema:
        return " or ".join(repr(value) for value in schema["enum"])
    if "const" in schema:
        return repr(schema["const"])
    if "anyOf" in schema:
        parts = [_type(one) for one in schema["anyOf"]]
        both = {"number", "text"} <= set(parts)
        parts = [p for p in parts if p != "nothing" and not (both and p in ("number", "text"))]
        return " or ".join(dict.fromkeys([*(["number, or text with its unit"] * both), *parts]))
    kind = str(schema.get("type", ""))
    if kind == "array":
        return f"list of {_type(schema['items'])}" if "items" in schema else "list"
    names = {"string": "text", "object": "table", "null": "nothing", "boolean": "true or false"}
    return names.get(kind, kind or "anything")
