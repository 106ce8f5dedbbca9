"""From a TOML file to a `Scenario`: every table made a model, every error named, all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from relnav_graph.compiled.helpers import compile_ahead
from relnav_graph.core import models
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.problem import layout_of
from relnav_graph.errors import ModelError
from relnav_graph.registry import find_class
from relnav_graph.scenario.priors import check_prior
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.schema import (
    MISSING,
    Problems,
    ScenarioError,
    ScenarioFile,
    SensorOptions,
    from_pydantic,
    make_kind,
    shared_orbit,
)
from relnav_graph.scenario.toml import merge, override, read_toml
from relnav_graph.sim.contracts import GROUP as TRUTHS
from relnav_graph.sim.contracts import ControlledTruth, Controller, SimulatedTruth

__all__ = [
    "load_scenario",
    "make_scenario",
]


def _check_choices(file: ScenarioFile, problems: Problems) -> None:
    for i, kind in enumerate(file.estimators):
        try:
            find_class("relnav_graph.estimators", kind)
        except ModelError as error:
            problems.append((f"estimators[{i}]", str(error)))
    for i, name in enumerate(file.data.simulate if file.data is not None else []):
        if name not in file.sensors:
            known = ", ".join(file.sensors)
            problems.append((f"data.simulate[{i}]", f"unknown sensor {name!r}; known are {known}"))
    low, high = file.evaluate or (0.0, 1.0)
    if isinstance(low, float) and isinstance(high, float) and not low < high:
        problems.append(("evaluate", f"found {file.evaluate}, expected the earlier end first"))


def _check_inputs(
    processes: Mapping[str, Dynamics],
    file: ScenarioFile,
    inputs: Mapping[str, Any],
    problems: Problems,
) -> None:
    """A simulated pass needs a source for each input of its processes."""
    for name, process in processes.items() if file.truth is not None else ():
        for needed in process.inputs:
            if needed not in inputs:
                message = f"missing: processes.{name} ({process.kind}) needs this input"
                problems.append((f"inputs.{needed}", message))


def _without(merged: Mapping[str, Any], wrong: set[int | str]) -> ScenarioFile | None:
    """The file without its wrong tables, so that the others are checked all the same."""
    try:
        return ScenarioFile.model_validate({k: v for k, v in merged.items() if k not in wrong})
    except ValidationError:
        return None


def _check_settings(name: str, settings: Mapping[str, Any]) -> None:
    """Settings are data, from a stream or a data set: they never name a module, which is code."""
    found: Problems = []
    for section, tables in settings.items():
        for key, table in tables.items() if isinstance(tables, Mapping) else ():
            kind = table.get("kind") if isinstance(table, Mapping) else None
            if isinstance(kind, str) and ":" in kind:
                message = f"found {kind!r} in the data; only a scenario file may name a module"
                found.append((f"{section}.{key}.kind", message))
    if found:
        raise ScenarioError(name, found)


def make_scenario(
    raw: Mapping[str, Any], name: str, settings: Mapping[str, Any] | None = None
) -> Scenario:
    """A scenario from its tables, over the settings that recorded data bring.

    Raises ScenarioError with everything that is wrong.
    """
    sections = {"processes", "sensors"}
    _check_settings(name, settings or {})
    # Before the data are read, what they will bring may be missing, and nothing else.
    waiting = settings is None and "data" in raw
    merged = merge({k: v for k, v in (settings or {}).items() if k in sections}, raw)
    problems: Problems = []
    file: ScenarioFile | None
    try:
        file = ScenarioFile.model_validate(merged)
    except ValidationError as error:
        problems += from_pydantic("", error)
        file = _without(merged, {e["loc"][0] for e in error.errors() if e["loc"]})
    orbit = merged.get("orbit")
    orbit = orbit if isinstance(orbit, Mapping) else None  # reported above
    made: dict[str, dict[str, Any]] = {"processes": {}, "sensors": {}}
    options: dict[str, SensorOptions] = {}
    for section, found in made.items():
        tables = merged.get(section)
        for key, table in tables.items() if isinstance(tables, Mapping) else ():
            path = f"{section}.{key}"
            if not isinstance(table, Mapping):
                continue  # reported above
            own = shared_orbit(models.ENTRY_POINTS, table, orbit)
            if section == "sensors":
                general = {k: own.pop(k) for k in SensorOptions.model_fields if k in own}
                try:
                    options[key] = SensorOptions.model_validate(general)
                except ValidationError as error:
                    problems += from_pydantic(path, error)
            model = make_kind(models.ENTRY_POINTS, path, own, problems)
            contract = Dynamics if section == "processes" else Sensor
            if model is not None and not isinstance(model, contract):
                problems.append((f"{path}.kind", f"{own['kind']!r} is not one of {section}"))
                model = None
            found[key] = model
    truth, inputs = _make_truth(merged, orbit, problems)
    control = _make_control(merged, orbit, truth, problems)
    if waiting:
        problems = [p for p in problems if p[1] != MISSING]
        made = {s: {k: m for k, m in found.items() if m is not None} for s, found in made.items()}
    if file is not None:
        _check_choices(file, problems)
    layout = None
    if all(model is not None for model in made["processes"].values()):
        sensors = {key: model for key, model in made["sensors"].items() if model is not None}
        try:
            layout = layout_of(made["processes"], sensors)
        except ModelError as error:
            problems.append(("", str(error)))
    if file is not None and layout is not None:
        check_prior(layout, file, problems)
        _check_inputs(made["processes"], file, inputs, problems)
    if problems or file is None or layout is None:
        raise ScenarioError(name, problems)
    compile_ahead(
        [model.kernel for model in made["sensors"].values()],
        [model.kernel for model in made["processes"].values()],
    )
    return Scenario(
        *(name, file, merged, made["processes"], made["sensors"], options),
        *(truth, inputs, layout, control),
    )


def _make_truth(
    raw: Mapping[str, Any], orbit: Mapping[str, Any] | None, problems: Problems
) -> tuple[Any, dict[str, Any]]:
    truth, inputs = None, {}
    if isinstance(raw.get("truth"), Mapping):
        own = shared_orbit(TRUTHS, raw["truth"], orbit)
        truth = make_kind(TRUTHS, "truth", own, problems)
        if truth is not None and not isinstance(truth, SimulatedTruth):
            problems.append(("truth.kind", f"{own['kind']!r} is an input, expected a truth"))
    tables = raw.get("inputs")
    for key, table in tables.items() if isinstance(tables, Mapping) else ():
        if isinstance(table, Mapping):
            inputs[key] = make_kind(TRUTHS, f"inputs.{key}", table, problems)
    return truth, inputs


def _make_control(
    raw: Mapping[str, Any], orbit: Mapping[str, Any] | None, truth: Any, problems: Problems
) -> Controller | None:
    if not isinstance(raw.get("control"), Mapping):
        return None
    own = shared_orbit(TRUTHS, raw["control"], orbit)
    control = make_kind(TRUTHS, "control", own, problems)
    if control is not None and not isinstance(control, Controller):
        problems.append(("control.kind", f"found {own['kind']!r}, expected a controller"))
        return None
    if truth is not None and not isinstance(truth, ControlledTruth):
        problems.append(("truth.kind", f"found {truth.kind!r}, which takes no commands"))
    found: Controller | None = control
    return found


def load_scenario(
    path: str | Path,
    assignments: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
) -> Scenario:
    """The scenario in a TOML file. Raises ScenarioError, or InputError on an assignment."""
    path = Path(path)
    return make_scenario(override(read_toml(path), assignments), path.stem, settings)
