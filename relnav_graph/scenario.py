"""Scenarios: checked settings become models, a prior and a `Problem`."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from relnav_graph.arrays import Array
from relnav_graph.compiled.helpers import compile_ahead
from relnav_graph.core import models
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.epochs import Epoch, make_epochs
from relnav_graph.core.problem import Prior, Problem, layout_of
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError, ModelError
from relnav_graph.initialise import initialise
from relnav_graph.magnitude import wrong_unit
from relnav_graph.maths.losses import Loss
from relnav_graph.priors import check_prior, make_prior
from relnav_graph.registry import find_class
from relnav_graph.settings import (
    MISSING,
    Problems,
    ScenarioError,
    ScenarioFile,
    SensorOptions,
    from_pydantic,
    make_kind,
    merge,
    override,
    read_toml,
    shared_orbit,
)
from relnav_graph.sim.contracts import GROUP as TRUTHS
from relnav_graph.sim.contracts import ControlledTruth, Controller
from relnav_graph.sim.passes import simulate
from relnav_graph.sim.sensors import Timing, measure_all, stream
from relnav_graph.units import parse_quantity

__all__ = ["Scenario", "ScenarioError", "load_scenario", "make_scenario", "override", "read_toml"]

_LOG = logging.getLogger(__name__)


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
    control: Controller | None = None

    @property
    def gates(self) -> dict[str, float]:
        """Probability of the gate of each sensor that has one."""
        return {name: o.gate for name, o in self.options.items() if o.gate is not None}

    @property
    def losses(self) -> dict[str, Loss]:
        """Robust loss of each sensor that has one."""
        found = self.options.items()
        return {name: Loss(o.loss, o.tuning) for name, o in found if o.loss is not None}

    @property
    def timings(self) -> dict[str, Timing]:
        """How each sensor measures when it is simulated."""
        return {name: o.timing() for name, o in self.options.items()}

    @property
    def input_columns(self) -> dict[str, tuple[str, ...]]:
        """Inputs that the processes need: the columns of each, by name."""
        return {k: v for p in self.processes.values() for k, v in p.inputs.items()}

    def window(self, times: Array) -> tuple[float, float] | None:
        """The scored part of a pass at `times` (N,), s, as fractions of it; None for all."""
        if self.file.evaluate is None:
            return None
        t0, length = float(times[0]), float(times[-1] - times[0]) or 1.0
        low, high = (
            (parse_quantity(end, "s") - t0) / length if isinstance(end, str) else end
            for end in self.file.evaluate
        )
        if not low < high or high < 0 or low > 1:
            _LOG.info(
                "evaluate = %s leaves no part of a pass from %g s to %g s: all of it is scored",
                *(self.file.evaluate, t0, t0 + length),
            )
            return None
        return max(low, 0.0), min(high, 1.0)

    @property
    def times(self) -> Array:
        """Epochs (N,) of a simulated pass, s. Raises InputError without [time]."""
        if self.file.time is None:
            raise InputError(f"{self.name}: no [time] to simulate at")
        return self.file.time.step * np.arange(self.file.time.epochs, dtype=np.float64)

    def simulate(self, seed: int, run: int = 0) -> Recording:
        """A simulated pass, without any control. Raises InputError when the scenario is not
        for simulation."""
        if self.truth is None or self.file.time is None:
            raise InputError(
                f"{self.name}: no [truth] and [time] to simulate from; give recorded data"
            )
        for name, o in self.options.items():
            cycles = (o.period or self.file.time.step) / self.file.time.step
            if cycles < 1 - 1e-6 or abs(cycles - round(cycles)) > 1e-6:
                raise InputError(
                    f"{self.name}: sensors.{name}.period: found {o.period} s, expected a multiple"
                    f" of time.step, {self.file.time.step} s"
                )
        models = self.processes, self.sensors
        return simulate(self.truth, self.inputs, *models, self.timings, self.times, seed, run)

    def completed(self, recording: Recording, seed: int, run: int = 0) -> Recording:
        """A recording with the sensors that [data] has simulated on its truth.

        Raises InputError when there is no truth, or none of what a sensor reads.
        """
        names = self.file.data.simulate if self.file.data is not None else []
        if not names:
            return recording
        if recording.truth is None:
            raise InputError(f"data.simulate: found {names}, but the recording has no truth")
        sensors = {name: self.sensors[name] for name in names}
        made = measure_all(sensors, self.timings, recording.truth, seed, run)
        return replace(recording, measurements=(*recording.measurements, *made))

    @property
    def measured(self) -> tuple[str, ...]:
        """Blocks whose prior is to be taken from the first measurements."""
        prior = self.file.prior
        return tuple(b.name for b in self.layout if prior[b.name].mean == "measured")

    def problem(self, recording: Recording, seed: int, run: int = 0) -> Problem:
        """The problem of a recording, with the scenario's prior.

        Raises InputError when the prior asks for a truth that is not known, or when the
        first measurements fit it in another unit only; EstimationError when it is to be
        measured and cannot be.
        """
        epochs = make_epochs(
            self.processes, recording.measurements, recording.inputs, recording.times
        )
        problem = self.problem_at(self.prior(recording.truth, epochs[0].t, seed, run), epochs)
        if self.measured:
            problem = replace(problem, prior=initialise(problem, self.measured))
        prior = problem.prior
        for m in epochs[0].measurements:
            reason = wrong_unit(self.sensors[m.sensor], m, self.layout, prior.x, prior.P)
            if reason is not None:
                raise InputError(f"sensor {m.sensor!r} at t = {m.t} s: {reason}")
        return problem

    def problem_at(self, prior: Prior, epochs: Sequence[Epoch] = ()) -> Problem:
        """The problem with a given prior; without epochs, one to be driven online."""
        models, options = (self.processes, self.sensors), (self.gates, self.file.online.window)
        return Problem(*models, prior, tuple(epochs), *options, self.losses)

    def prior(self, truth: Truth | None, t: float, seed: int, run: int = 0) -> Prior:
        """The prior at time t, s, drawn about the truth where it has no mean.

        Raises InputError when it needs a truth that is not known.
        """
        rng = stream(seed, run, "prior")
        return make_prior(self.layout, self.file.prior, truth, t, rng)

    def prior_with(self, means: Mapping[str, Array], t: float) -> Prior:
        """The prior at time t, s, with `means` for blocks whose mean the scenario leaves open.

        Those to be measured may lack one. Raises InputError when another one is missing.
        """
        given = {n: self.file.prior[n].model_copy(update={"mean": "truth"}) for n in means}
        given |= {n: p for n, p in self.file.prior.items() if isinstance(p.mean, list)}
        truth = Truth(np.array([t]), {n: value[None] for n, value in means.items()})
        rng = stream(0, 0, "prior")  # nothing is drawn
        return make_prior(self.layout, {**self.file.prior, **given}, truth, t, rng)


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


def make_scenario(
    raw: Mapping[str, Any], name: str, settings: Mapping[str, Any] | None = None
) -> Scenario:
    """A scenario from its tables, over the settings that recorded data bring.

    Raises ScenarioError with everything that is wrong.
    """
    sections = {"processes", "sensors"}
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
        if truth is not None and not hasattr(truth, "simulate"):
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
