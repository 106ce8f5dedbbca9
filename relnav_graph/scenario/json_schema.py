"""The JSON Schema of scenario files, for editors."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from relnav_graph.core import models
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.registry import classes, provides
from relnav_graph.scenario.schema import ScenarioFile
from relnav_graph.scenario.settings import SensorOptions
from relnav_graph.sim.contracts import GROUP as TRUTHS
from relnav_graph.sim.contracts import Instrument

__all__ = ["json_schema"]


def json_schema() -> dict[str, Any]:
    """JSON Schema of scenario files, for editors."""
    schema = ScenarioFile.model_json_schema()
    own_options = SensorOptions.model_json_schema()
    schema["$defs"] |= own_options.pop("$defs", {})
    options = own_options["properties"]
    for section, group, contract, general in (
        ("processes", models.ENTRY_POINTS, Dynamics, {}),
        ("sensors", models.ENTRY_POINTS, Sensor, options),
        ("inputs", TRUTHS, Instrument, {}),
    ):
        choices = []
        for kind, cls in classes(group).items():
            if provides(cls, contract):
                choice = TypeAdapter(cls).json_schema()
                schema["$defs"] |= choice.pop("$defs", {})
                own = choice.get("properties", {})
                choice["properties"] = {"kind": {"const": kind}, **general, **own}
                # The scenario's [orbit] serves all models that ask for one.
                required = [n for n in choice.get("required", []) if n != "orbit"]
                choice["required"] = ["kind", *required]
                choices.append(choice)
        schema["properties"][section]["additionalProperties"] = {"anyOf": choices}
    return schema
