"""From a TOML file to a `Scenario`: every table made a model, every error named, all at once."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from relnav_graph.arrays import Array
from relnav_graph.compiled.helpers import compile_ahead
from relnav_graph.core import catalogue, models
from relnav_graph.core.contracts import Dynamics, IntegratesBySteps, Sensor
from relnav_graph.core.copies import with_copiers
from relnav_graph.core.measurement import Bridge
from relnav_graph.core.numbered import families
from relnav_graph.core.problem import check_orbits, layout_of
from relnav_graph.core.scored import Scored
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.steps import check_steps
from relnav_graph.errors import InputError, ModelError
from relnav_graph.estimators import find_estimator
from relnav_graph.files import check_name, printable
from relnav_graph.memory import check_room
from relnav_graph.registry import find_class
from relnav_graph.scenario.absolute import NEEDED, Clock, in_pass_time, pass_clock, with_data_epoch
from relnav_graph.scenario.closures import at_keyframes, copy_priors
from relnav_graph.scenario.gaps import check_stamps, make_bridges
from relnav_graph.scenario.priors import check_prior, true_statics
from relnav_graph.scenario.scenario import NO_NOISE, Scenario, freed
from relnav_graph.scenario.schema import (
    BESIDE_TRUTH,
    MISSING,
    Problems,
    ScenarioError,
    ScenarioFile,
    from_pydantic,
    make_kind,
    named_mount,
    shared_orbit,
)
from relnav_graph.scenario.scores import make_scored, make_truth_noise
from relnav_graph.scenario.settings import SensorOptions, besides
from relnav_graph.scenario.toml import merge, override, read_toml, refuse_modules, strange_values
from relnav_graph.scenario.true_map import true_map
from relnav_graph.sim.contracts import GROUP as TRUTHS
from relnav_graph.sim.contracts import (
    ControlledTruth,
    Controller,
    DrivenTruth,
    Instrument,
    KnownInput,
    PlannedInput,
    SimulatedTruth,
)

__all__ = [
    "load_scenario",
    "make_scenario",
]


#: How the names of blocks end that a sensor has of its own: how it is mounted.
MOUNTED = ("_misalignment", "_displacement")
#: Sections whose tables recorded data may bring, or complete.
_BROUGHT = ("processes", "sensors")


def _check_choices(file: ScenarioFile, problems: Problems) -> None:
    for i, kind in enumerate(file.estimators):
        try:
            find_estimator(kind)
        except ModelError as error:
            problems.append((f"estimators[{i}]", str(error)))
    for i, name in enumerate(file.data.simulate if file.data is not None else []):
        if name not in file.sensors:
            known = ", ".join(file.sensors)
            problems.append((f"data.simulate[{i}]", f"unknown sensor {name!r}; known are {known}"))
    low, high = file.evaluate or (0.0, 1.0)
    if isinstance(low, float) and isinstance(high, float) and not low < high:
        problems.append(("evaluate", f"found {file.evaluate}, expected the earlier end first"))


def _check_names(
    file: ScenarioFile, processes: Mapping[str, Dynamics | None], problems: Problems
) -> None:
    """Names are names, and each table of a data set has its own."""
    inputs = [name for p in processes.values() if p is not None for name in p.inputs]
    for section, names in (
        ("processes", file.processes),
        ("inputs", file.inputs),
        ("sensors", file.sensors),
    ):
        for name in names:
            try:
                check_name(f"one of {section}", name)
            except InputError as error:
                problems.append((section, str(error)))
    for name in file.sensors:
        if name in inputs or name == "epochs" or name.startswith("truth_"):
            message = "the name is that of another table of a data set; choose another"
            problems.append((f"sensors.{name}", message))


def _check_inputs(
    processes: Mapping[str, Dynamics],
    file: ScenarioFile,
    inputs: Mapping[str, Any],
    problems: Problems,
) -> None:
    """Note in `problems` each input of a process that a simulated pass has no instrument for."""
    for name, process in processes.items() if file.simulated else ():
        for needed in process.inputs:
            if needed not in inputs:
                message = f"missing: processes.{name} ({process.kind}) needs this input"
                problems.append((f"inputs.{needed}", message))


def _check_steps(
    processes: Mapping[str, Dynamics], truth: Any, file: ScenarioFile, problems: Problems
) -> None:
    """In a simulated pass, whose intervals are known, nothing takes steps without end."""
    step = (file.time.step or 0.0) if file.simulated else 0.0
    paths = {f"processes.{name}": process for name, process in processes.items()}
    for path, model in {**paths, "truth": truth}.items():
        if isinstance(model, IntegratesBySteps):
            try:
                check_steps("in this pass", step, model.max_step)
            except InputError as error:
                problems.append((f"{path}.max_step", str(error)))


def _check_room(
    file: ScenarioFile,
    inputs: Mapping[str, Any],
    options: Mapping[str, SensorOptions],
    layout: Layout,
    problems: Problems,
) -> None:
    """A simulated pass must fit into memory: of each epoch at least its estimate (with some
    hundred numbers of bookkeeping), of each sample of an input some twenty."""
    step, epochs = file.time.step, file.time.epochs
    if step is None or epochs is None or not file.simulated:
        return
    each = layout.dim**2 + 100.0
    asked = [("time.epochs", f"{epochs} epochs", epochs * each)]
    for name, one in options.items():
        for own in besides(step, [one]):
            more = step * epochs / own
            what = f"a period of {own} s, {more:.3g} epochs"
            asked.append((f"sensors.{name}.period", what, more * each))
    for name, source in inputs.items():
        if isinstance(period := getattr(source, "period", None), float):
            samples = step * epochs / period
            what = f"a period of {period} s, {samples:.3g} samples"
            asked.append((f"inputs.{name}.period", what, 20 * samples))
    for path, found, numbers in asked:
        try:
            check_room(found, numbers)
        except InputError as error:
            problems.append((path, str(error)))


def _is_wrong(sensor: str, problems: Problems) -> bool:
    path = f"sensors.{sensor}"
    return any(where == path or where.startswith(f"{path}.") for where, _ in problems)


def _perhaps_read(kinds: Iterable[object], names: Iterable[str]) -> set[str]:
    """Which of these names of blocks sensors of some kinds may read, whatever their parameters:
    those that their modules or the catalogue have, and how they are mounted; all, where a kind is
    none."""
    try:
        own = [sys.modules[find_class(models.ENTRY_POINTS, str(k)).__module__] for k in kinds]
    except ModelError:
        return set(names)
    found = (value for module in (catalogue, *own) for value in vars(module).values())
    known = {block.name for block in found if isinstance(block, Block)}
    return {name for name in names if name in known or name.endswith(MOUNTED)}


def _without(merged: Mapping[str, Any], wrong: set[int | str]) -> ScenarioFile | None:
    """The file without its wrong tables, or its title, so that the others are checked all the
    same."""
    rest = {k: v for k, v in merged.items() if k not in wrong}
    try:
        return ScenarioFile.model_validate({"title": "", **rest})
    except ValidationError:
        return None


def make_scenario(
    raw: Mapping[str, Any],
    name: str,
    settings: Mapping[str, Any] | None = None,
    trust: bool = False,
) -> Scenario:
    """A scenario from the tables of its file; they win over the `settings` of recorded data.

    name: what it is called, a label; trust: the settings may name modules, which are code.
    Raises ScenarioError with everything that is wrong, InputError on a module named by data.
    """
    name = printable(name)
    if not trust:
        refuse_modules(f"{name}: settings of the data", settings or {})
    problems: Problems = strange_values(settings or {}) + strange_values(raw)
    if problems:  # nor could they be written into what a run leaves
        raise ScenarioError(name, problems)
    # Until the data are read, settings that they may bring count as present, not as missing.
    waiting = settings is None and "data" in raw
    merged = merge({k: v for k, v in (settings or {}).items() if k in _BROUGHT}, raw)
    merged = with_data_epoch(merged, settings, problems)
    merged.setdefault("prior", {})  # so that what it lacks is named, block by block
    file: ScenarioFile | None
    try:
        file = ScenarioFile.model_validate(merged)
    except ValidationError as error:
        problems += from_pydantic("", error)
        file = _without(merged, {e["loc"][0] for e in error.errors() if e["loc"]})
    clock = pass_clock(merged, problems)
    tables_of = in_pass_time(merged, clock, waiting, problems)
    orbit = tables_of.get("orbit")
    made: dict[str, dict[str, Any]] = {section: {} for section in _BROUGHT}
    options: dict[str, SensorOptions] = {}
    waits = False
    for section, found in made.items():
        tables = tables_of.get(section)
        for key, table in tables.items() if isinstance(tables, Mapping) else ():
            path = f"{section}.{key}"
            if not isinstance(table, Mapping):
                continue  # reported above
            own = shared_orbit(models.ENTRY_POINTS, table, orbit)
            own = clock.given_to(models.ENTRY_POINTS, own)
            several = {key: own}
            if section == "sensors":
                general = {k: own.pop(k) for k in SensorOptions.model_fields if k in own}
                time = merged.get("time")
                simulated = settings is None and "data" not in raw
                several = at_keyframes(key, named_mount(own, key), time, problems, simulated)
                try:
                    options |= dict.fromkeys(several, SensorOptions.model_validate(general))
                except ValidationError as error:
                    problems += from_pydantic(path, error)
            for each, one in several.items():
                before = len(problems)
                contract = Dynamics if section == "processes" else Sensor
                model = make_kind(models.ENTRY_POINTS, path, one, problems, contract)
                if model is not None and not isinstance(model, contract):
                    problems.append((f"{path}.kind", f"{own['kind']!r} is not one of {section}"))
                    model = None
                if model is None and waiting and all(m == MISSING for _, m in problems[before:]):
                    waits = True
                    break
                found[each] = model
                if not waiting and clock.lacks(model):
                    problems.append((path, NEEDED))
                if model is None:
                    break  # what is wrong with one keyframe is wrong with all
    truth, inputs = _make_truth(tables_of, orbit, clock, problems)
    control = _make_control(tables_of, orbit, truth, problems)
    brought: Problems = []
    if waiting:
        brought = [p for p in problems if p[1] == MISSING and p[0].split(".")[0] in _BROUGHT]
        problems = [p for p in problems if p not in brought]
    if file is not None:
        _check_choices(file, problems)
        _check_names(file, made["processes"], problems)
    layout, every = None, Layout(())  # with all mountings in the state
    bridges, statics, points = dict[str, Bridge](), dict[str, Array](), None
    scored, noise = Scored(), dict[str, Array]()
    if made["processes"] and all(model is not None for model in made["processes"].values()):
        sensors = {key: model for key, model in made["sensors"].items() if model is not None}
        try:
            sensors = with_copiers(sensors)
            layout = layout_of(made["processes"], sensors)
            check_orbits(made["processes"], sensors)
            every = layout_of(made["processes"], freed(sensors))
        except (ModelError, InputError) as error:
            problems.append(("", str(error)))
    if file is not None and layout is not None:
        made["sensors"] |= sensors
        options |= {key: SensorOptions() for key in sensors if key not in options}
        priors = copy_priors(sensors, layout) | file.prior
        file = file.model_copy(update={"prior": priors})
        told, numbered = file.truth or {}, families(sensors)
        lost = {t.get("kind") for n, t in file.sensors.items() if _is_wrong(n, problems)}
        if waits or lost:
            # What a model reads that is wrong, or waits for the data, is not known: one error, not
            # one for each block.
            spared = set(file.prior) if waits else _perhaps_read(lost, file.prior)
            check_prior(layout, file, problems, numbered, {*spared, *(b.name for b in every)})
        else:
            check_prior(layout, file, problems, numbered, every)
            statics = true_statics(every, told.get("statics", {}), problems)
            points = true_map(told.get("map"), sensors, settings, file.simulated, problems)
            scored = make_scored(file.score, layout, numbered, problems)
            noise = make_truth_noise(file.truth_noise, layout, numbered, problems)
            if noise and settings is None and "data" not in raw:
                problems.append(("truth_noise", NO_NOISE))
        _check_inputs(made["processes"], file, inputs, problems)
        bridges = make_bridges(file, made["processes"], problems)
        check_stamps(file, made["processes"], problems)
        _check_steps(made["processes"], truth, file, problems)
        _check_room(file, inputs, options, layout, problems)
    if problems or file is None or layout is None:
        raise ScenarioError(name, problems or brought)
    compile_ahead(
        list({model.kernel: 0 for model in made["sensors"].values()}),
        [model.kernel for model in made["processes"].values()],
    )
    return Scenario(
        *(name, file, merged, made["processes"], made["sensors"], options),
        *(truth, inputs, layout, control, bridges, statics),
        map=points,
        scored=scored,
        truth_noise=noise,
    )


def _make_truth(
    raw: Mapping[str, Any], orbit: Mapping[str, Any] | None, clock: Clock, problems: Problems
) -> tuple[Any, dict[str, Any]]:
    truth, inputs = None, {}
    own = raw.get("truth")
    if isinstance(own, Mapping) and not own.keys() <= BESIDE_TRUTH:
        model = {k: v for k, v in own.items() if k not in BESIDE_TRUTH}
        own = clock.given_to(TRUTHS, shared_orbit(TRUTHS, model, orbit))
        truth = make_kind(TRUTHS, "truth", own, problems, SimulatedTruth, DrivenTruth)
        if clock.lacks(truth):
            problems.append(("truth", NEEDED))
        if truth is not None and not isinstance(truth, SimulatedTruth | DrivenTruth):
            problems.append(("truth.kind", f"found {own['kind']!r}, expected a truth"))
            truth = None
    tables = raw.get("inputs")
    for key, table in tables.items() if isinstance(tables, Mapping) else ():
        if isinstance(table, Mapping):
            kinds = Instrument, KnownInput, PlannedInput
            inputs[key] = made = make_kind(TRUTHS, f"inputs.{key}", table, problems, *kinds)
            if made is not None and not isinstance(made, Instrument | KnownInput | PlannedInput):
                found = f"found {table['kind']!r}, expected an instrument"
                problems.append((f"inputs.{key}.kind", found))
    return truth, inputs


def _make_control(
    raw: Mapping[str, Any], orbit: Mapping[str, Any] | None, truth: Any, problems: Problems
) -> Controller | None:
    if not isinstance(raw.get("control"), Mapping):
        return None
    own = shared_orbit(TRUTHS, raw["control"], orbit)
    control = make_kind(TRUTHS, "control", own, problems, Controller)
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
    """The scenario in a TOML file, or of that name in the package; a path beats a name.

    Raises ScenarioError, or InputError on an assignment.
    """
    path = Path(path)
    return make_scenario(override(read_toml(path), assignments), path.stem, settings)
