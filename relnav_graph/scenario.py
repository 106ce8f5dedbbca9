"""Scenario files: TOML -> checked settings -> models, prior and `Problem`.

A file is checked as a whole: every error is reported at once, with its path in the file.
"""

from __future__ import annotations

import dataclasses
import difflib
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from relnav_graph import models, sim, so3
from relnav_graph.errors import InputError, ModelError
from relnav_graph.models import Dynamics, Sensor
from relnav_graph.problem import Prior, Problem, layout_of, make_epochs
from relnav_graph.recording import Recording
from relnav_graph.registry import find_class
from relnav_graph.state import Block, Layout
from relnav_graph.track import Truth
from relnav_graph.units import Quantity

__all__ = ["Scenario", "ScenarioError", "json_schema", "load_scenario", "override"]

Array = NDArray[np.float64]
Problems = list[tuple[str, str]]
Seconds = Annotated[float, Quantity("s", positive=True)]
_STRICT = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class ScenarioError(InputError):
    """Everything that is wrong in a scenario; `problems` holds (path, message) pairs."""

    def __init__(self, source: str, problems: Problems) -> None:
        self.problems = problems
        lines = "\n".join(f"  {path or '(file)'}: {message}" for path, message in problems)
        count = "1 error" if len(problems) == 1 else f"{len(problems)} errors"
        super().__init__(f"{source}: {count}\n{lines}")


class TimeSettings(BaseModel):
    """Epochs of a simulated pass: `epochs` of them, `step` apart, from t = 0."""

    model_config = _STRICT

    step: Seconds
    epochs: int = Field(ge=1)


class DataSettings(BaseModel):
    """Where recorded data come from: a reader of `relnav_graph.io.readers`."""

    model_config = _STRICT

    reader: str
    options: dict[str, Any] = {}


class SensorOptions(BaseModel):
    """Of a sensor, what belongs to no model: `gate`, the probability of the chi-square
    gate on each observation, and `period`, how often it measures in simulation."""

    model_config = _STRICT

    gate: float | None = Field(default=None, gt=0, lt=1)
    period: Seconds | None = None


class BlockPrior(BaseModel):
    """Prior of one block. sigma: one for all axes or one each, SI or strings with units.

    mean: "drawn" about the truth with sigma (simulation only), "truth" itself, or values
    (an attitude as a rotation vector).
    """

    model_config = _STRICT

    sigma: Any
    mean: Literal["drawn", "truth"] | list[Any] = "drawn"


class ScenarioFile(BaseModel):
    """The tables of a scenario file. Models are checked apart, by their `kind`."""

    model_config = _STRICT

    title: str
    description: str = ""
    seed: int = Field(default=0, ge=0)
    estimators: list[str] = ["ekf", "iekf", "rts", "batch", "isam2"]
    evaluate: tuple[float, float] | None = None
    time: TimeSettings | None = None
    data: DataSettings | None = None
    orbit: dict[str, Any] | None = None
    truth: dict[str, Any] | None = None
    inputs: dict[str, dict[str, Any]] = {}
    processes: dict[str, dict[str, Any]] = Field(min_length=1)
    sensors: dict[str, dict[str, Any]] = Field(min_length=1)
    prior: dict[str, BlockPrior]


def _path(prefix: str, location: Sequence[int | str]) -> str:
    out = prefix
    for part in location:
        out += f"[{part}]" if isinstance(part, int) else f".{part}" if out else part
    return out


def _from_pydantic(prefix: str, error: ValidationError) -> Problems:
    found = []
    for e in error.errors():
        message = e["msg"].removeprefix("Value error, ")
        if "found" not in message and e["type"] != "missing":
            message += f" (found {e['input']!r})"
        found.append((_path(prefix, e["loc"]), message))
    return found


def _make(path: str, cls: type[Any], table: Mapping[str, Any], problems: Problems) -> Any:
    """An instance of a dataclass from a table; problems collects what is wrong."""
    names = [f.name for f in dataclasses.fields(cls) if f.init]
    for key in table:
        if key not in names:
            near = difflib.get_close_matches(key, names, 1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; expected {', '.join(names)}"
            problems.append((f"{path}.{key}", f"unknown key{hint}"))
    known = {key: value for key, value in table.items() if key in names}
    try:
        return TypeAdapter(cls).validate_python(known)
    except ValidationError as error:
        problems += _from_pydantic(path, error)
    except (InputError, ModelError) as error:
        problems.append((path, str(error)))
    return None


def _make_kind(group: str, path: str, table: Mapping[str, Any], problems: Problems) -> Any:
    kind = table.get("kind")
    if not isinstance(kind, str):
        problems.append((f"{path}.kind", f"found {kind!r}, expected the name of a kind"))
        return None
    try:
        cls = find_class(group, kind)
    except ModelError as error:
        problems.append((f"{path}.kind", str(error)))
        return None
    rest = {key: value for key, value in table.items() if key != "kind"}
    return _make(path, cls, rest, problems)


def _shared_orbit(
    group: str, table: Mapping[str, Any], orbit: Mapping[str, Any] | None
) -> dict[str, Any]:
    """The table with what the scenario's [orbit] gives to a model that asks for it."""
    out = dict(table)
    try:
        cls = find_class(group, str(table.get("kind")))
    except ModelError:
        return out
    names = {f.name for f in dataclasses.fields(cls)}
    if orbit is not None and "orbit" in names:
        out.setdefault("orbit", dict(orbit))
    elif orbit is not None and "semi_major_axis" in names:
        out = {**orbit, **out}
    return out


@dataclass(frozen=True, eq=False)
class Scenario:
    """A checked scenario: settings and models, ready to meet simulated or recorded data."""

    name: str
    file: ScenarioFile
    raw: Mapping[str, Any]
    processes: Mapping[str, Dynamics]
    sensors: Mapping[str, Sensor]
    options: Mapping[str, SensorOptions]
    truth: Any
    inputs: Mapping[str, Any]
    layout: Layout

    @property
    def gates(self) -> dict[str, float]:
        """Probability of the gate of each sensor that has one."""
        return {name: o.gate for name, o in self.options.items() if o.gate is not None}

    @property
    def input_names(self) -> list[str]:
        """Inputs that the processes need."""
        return sorted({i for p in self.processes.values() for i in p.inputs})

    def simulate(self, seed: int, run: int = 0) -> Recording:
        """A simulated pass. Raises InputError when the scenario is not for simulation."""
        if self.truth is None or self.file.time is None:
            raise InputError(
                f"{self.name}: no [truth] and [time] to simulate from; give recorded data"
            )
        timings = {name: sim.Timing(o.period) for name, o in self.options.items()}
        times = self.file.time.step * np.arange(self.file.time.epochs)
        return sim.simulate(
            self.truth, self.inputs, self.processes, self.sensors, timings, times, seed, run
        )

    def problem(self, recording: Recording, seed: int, run: int = 0) -> Problem:
        """The problem of a recording, with the scenario's prior.

        Raises InputError when the prior asks for a truth that is not known.
        """
        epochs = make_epochs(
            self.processes, recording.measurements, recording.inputs, recording.times
        )
        rng = sim.stream(seed, run, "prior")
        prior = make_prior(self.layout, self.file.prior, recording.truth, epochs[0].t, rng)
        return Problem(self.processes, self.sensors, prior, epochs, self.gates)


def _prior_sigma(block: Block, value: Any) -> Array:
    if isinstance(value, list):
        sigma = Quantity(block.unit, (block.dim,), positive=True).parse(value)
    else:
        sigma = np.full(block.dim, Quantity(block.unit, positive=True).parse(value))
    return np.asarray(sigma)


def _prior_mean(block: Block, value: list[Any]) -> Array:
    tangent = np.array(Quantity(block.unit, (block.dim,)).parse(value))
    return so3.exp(tangent) if block.manifold == "SO3" else tangent


def _check_prior(layout: Layout, file: ScenarioFile, problems: Problems) -> None:
    names = [b.name for b in layout]
    for name in file.prior:
        if name not in names:
            problems.append((f"prior.{name}", f"unknown block; the state has {', '.join(names)}"))
    for block in layout:
        prior = file.prior.get(block.name)
        if prior is None:
            problems.append((f"prior.{block.name}", "missing: every block needs a prior"))
            continue
        try:
            _prior_sigma(block, prior.sigma)
        except InputError as error:
            problems.append((f"prior.{block.name}.sigma", str(error)))
        try:
            if isinstance(prior.mean, list):
                _prior_mean(block, prior.mean)
        except InputError as error:
            problems.append((f"prior.{block.name}.mean", str(error)))


def make_prior(
    layout: Layout,
    priors: Mapping[str, BlockPrior],
    truth: Truth | None,
    t: float,
    rng: np.random.Generator,
) -> Prior:
    """The prior at time t, s. Raises InputError when it needs a truth that is not known."""
    sigma = np.concatenate([_prior_sigma(b, priors[b.name].sigma) for b in layout])
    draw = sigma * rng.standard_normal(layout.dim)
    means: dict[str, Array] = {}
    for block in layout:
        mean = priors[block.name].mean
        if isinstance(mean, list):
            means[block.name] = _prior_mean(block, mean)
            draw[layout.tangent(block.name)] = 0.0
            continue
        value = np.full(1, np.nan)
        if truth is not None and block.name in truth.values:
            k = int(np.abs(truth.t - t).argmin())
            if abs(truth.t[k] - t) < 1e-6:
                value = truth.values[block.name][k]
        if not np.isfinite(value).all():
            raise InputError(
                f"prior.{block.name}: mean = {mean!r} needs the truth at t = {t} s, which is"
                " not known; give the mean as values"
            )
        means[block.name] = value
        if mean == "truth":
            draw[layout.tangent(block.name)] = 0.0
    return Prior(layout.retract(layout.pack(means), draw), np.diag(sigma**2))


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested tables; a value in `over` wins."""
    out = dict(base)
    for key, value in over.items():
        inner = out.get(key)
        both = isinstance(value, Mapping) and isinstance(inner, Mapping)
        out[key] = _merge(inner, value) if both else value  # type: ignore[arg-type]
    return out


def make_scenario(
    raw: Mapping[str, Any], name: str, settings: Mapping[str, Any] | None = None
) -> Scenario:
    """A scenario from its tables, over the settings that recorded data bring.

    Raises ScenarioError with everything that is wrong.
    """
    sections = {"processes", "sensors"}
    merged = _merge({k: v for k, v in (settings or {}).items() if k in sections}, raw)
    problems: Problems = []
    try:
        file = ScenarioFile.model_validate(merged)
    except ValidationError as error:
        problems += _from_pydantic("", error)
        file = None  # type: ignore[assignment]
    orbit = merged.get("orbit")
    made: dict[str, dict[str, Any]] = {"processes": {}, "sensors": {}}
    options: dict[str, SensorOptions] = {}
    for section, found in made.items():
        tables = merged.get(section)
        for key, table in tables.items() if isinstance(tables, Mapping) else ():
            path = f"{section}.{key}"
            if not isinstance(table, Mapping):
                continue  # reported above
            own = _shared_orbit(models.ENTRY_POINTS, table, orbit)
            if section == "sensors":
                general = {k: own.pop(k) for k in SensorOptions.model_fields if k in own}
                try:
                    options[key] = SensorOptions.model_validate(general)
                except ValidationError as error:
                    problems += _from_pydantic(path, error)
            model = _make_kind(models.ENTRY_POINTS, path, own, problems)
            contract = Dynamics if section == "processes" else Sensor
            if model is not None and not isinstance(model, contract):
                problems.append((f"{path}.kind", f"{own['kind']!r} is not one of {section}"))
            found[key] = model
    truth, inputs = _make_truth(merged, orbit, problems)
    if problems:
        raise ScenarioError(name, problems)
    try:
        layout = layout_of(made["processes"], made["sensors"])
    except ModelError as error:
        raise ScenarioError(name, [("", str(error))]) from error
    _check_prior(layout, file, problems)
    if problems:
        raise ScenarioError(name, problems)
    return Scenario(
        name, file, merged, made["processes"], made["sensors"], options, truth, inputs, layout
    )


def _make_truth(
    raw: Mapping[str, Any], orbit: Mapping[str, Any] | None, problems: Problems
) -> tuple[Any, dict[str, Any]]:
    truth, inputs = None, {}
    if isinstance(raw.get("truth"), Mapping):
        own = _shared_orbit(sim.GROUP, raw["truth"], orbit)
        truth = _make_kind(sim.GROUP, "truth", own, problems)
    tables = raw.get("inputs")
    for key, table in tables.items() if isinstance(tables, Mapping) else ():
        if isinstance(table, Mapping):
            inputs[key] = _make_kind(sim.GROUP, f"inputs.{key}", table, problems)
    return truth, inputs


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises ScenarioError when it cannot be read."""
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ScenarioError(str(path), [("", f"cannot be read: {error.strerror}")]) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(str(path), [("", f"not valid TOML: {error}")]) from error


def override(raw: Mapping[str, Any], assignments: Sequence[str]) -> dict[str, Any]:
    """The tables with ``key.path=value`` assignments made; values as in TOML, else text.

    Raises InputError on an assignment that cannot be read.
    """
    out = dict(raw)
    for text in assignments:
        key, equals, value = text.partition("=")
        parts = key.strip().split(".")
        if not equals or not all(parts):
            raise InputError(f"--set: found {text!r}, expected key.path=value")
        try:
            parsed: Any = tomllib.loads(f"v = {value}")["v"]
        except tomllib.TOMLDecodeError:
            parsed = value.strip()
        nested: Any = parsed
        for part in reversed(parts):
            nested = {part: nested}
        out = _merge(out, nested)
    return out


def load_scenario(
    path: str | Path,
    assignments: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
) -> Scenario:
    """The scenario in a TOML file. Raises ScenarioError, or InputError on an assignment."""
    path = Path(path)
    return make_scenario(override(read_toml(path), assignments), path.stem, settings)


def json_schema() -> dict[str, Any]:
    """JSON Schema of scenario files, for editors."""
    schema = ScenarioFile.model_json_schema()
    for section, group, contract in (
        ("processes", models.ENTRY_POINTS, "advances"),
        ("sensors", models.ENTRY_POINTS, "observables"),
        ("inputs", sim.GROUP, "sample"),
    ):
        choices = []
        for kind, cls in models.classes(group).items():
            if hasattr(cls, contract):
                choice = TypeAdapter(cls).json_schema()
                choice["properties"] = {"kind": {"const": kind}, **choice.get("properties", {})}
                choices.append(choice)
        schema["properties"][section]["additionalProperties"] = {"anyOf": choices}
    return schema
