"""A scenario with what it is run on: a simulated pass, a data set, or a recorded folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from relnav_graph.core.copies import with_true_copies
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.dataset import read_dataset, read_scenario_of, read_settings_of
from relnav_graph.io.known import Known
from relnav_graph.io.parts import data_problems, need_known, read_data
from relnav_graph.maths.instants import Instant
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.schema import ScenarioError, from_pydantic
from relnav_graph.scenario.settings import DataSettings
from relnav_graph.scenario.time_settings import TimeSettings
from relnav_graph.scenario.toml import override, read_toml

__all__ = [
    "Pass",
    "is_dataset",
    "known_of",
    "open_dataset",
    "open_pass",
    "recorded_pass",
    "simulated_pass",
]


@dataclass(frozen=True, eq=False)
class Pass:
    """A scenario with the recording that estimators get.

    seed: root of all that is drawn, which is the prior's mean at least; simulated: whether the
    recording was drawn from it too; run: number of the draw, as in a study; flown: whether
    each estimator is to fly a pass of its own in a closed loop: the recording then holds the
    times alone.
    """

    scenario: Scenario
    recording: Recording
    seed: int
    simulated: bool
    run: int = 0
    flown: bool = False

    def __post_init__(self) -> None:
        # Measurements of a sensor that lags have epochs of their own, where no truth is known.
        truth = self.recording.without_lags(self.scenario.stamps).truth
        if truth is not self.recording.truth:
            object.__setattr__(self, "recording", replace(self.recording, truth=truth))

    @cached_property
    def problem(self) -> Problem:
        """What estimators get, of a pass that is not flown; made once: a long one takes
        seconds. Raises InputError when the recording gives none."""
        return self.scenario.problem(self.recording, self.seed, self.run)


def is_dataset(folder: Path) -> bool:
    """Whether a folder is a data set (it has a scenario.toml)."""
    return (folder / "scenario.toml").is_file()


def _as_it_came(raw: Mapping[str, Any], folder: Path) -> bool:
    """Whether a scenario names readers for a folder, of files of others, which nobody has
    converted."""
    data = raw.get("data")
    named = isinstance(data, dict) and ("parts" in data or "reader" in data)
    return named and not (folder / "dataset.toml").exists()


def _is_raw(raw: Mapping[str, Any], folder: Path) -> bool:
    return not is_dataset(folder) or _as_it_came(raw, folder)


def simulated_pass(scenario: Scenario, seed: int, run: int = 0, loops: bool = True) -> Pass:
    """A pass drawn from a scenario.

    loops: whether, of a scenario with a controller, the pass is left to be flown in closed
    loops; else it is simulated without control. Raises
    InputError on a scenario that is not for simulation.
    """
    scenario.refuse_noise()
    if loops and scenario.control is not None:
        return Pass(scenario, Recording(scenario.times, ()), seed, True, run, True)
    return Pass(scenario, scenario.simulate(seed, run), seed, True, run)


def open_dataset(folder: Path, assignments: Sequence[str] = (), trust: bool = False) -> Pass:
    """A data set with its own scenario, settings changed by "key=value" assignments.

    trust: its scenario may name modules ("module:Class"), which are then imported. Raises
    InputError on whatever is wrong.
    """
    _need_folder(folder)
    raw = override(read_scenario_of(folder, trust), assignments)
    name = folder.resolve().name

    def made(settings: Mapping[str, Any] | None) -> Scenario:
        return make_scenario(raw, name, settings, trust)

    if _as_it_came(raw, folder):
        recording = _read_folder(name, raw, folder, made)
        scenario = made(recording.settings)
        recording, seed = _window(scenario, recording), scenario.file.seed
        return Pass(scenario, scenario.completed(recording, seed), seed, False)
    scenario = made(read_settings_of(folder, raw))
    recording = _window(scenario, _recorded(scenario, folder))
    return Pass(scenario, recording, scenario.file.seed, False)


def open_pass(
    scenario: Scenario | str | Path,
    seed: int | None = None,
    data: Recording | str | Path | None = None,
    assignments: Sequence[str] = (),
    run: int = 0,
    loops: bool = False,
) -> Pass:
    """A scenario with simulated data, a recording, a data set, or a raw folder that its reader
    knows.

    scenario: one that is loaded, or its file; seed: by default the scenario's; data: a folder, or
    a recording, whose times are of the pass's clock; assignments: "key=value", settings to change;
    run: number of the draw; loops: see `simulated_pass`.

    Raises InputError on whatever is wrong with any of them.
    """
    if data is None:
        own = _tables_of(scenario, assignments)[2](None)
        return simulated_pass(own, own.file.seed if seed is None else seed, run, loops)
    own, recording = recorded_pass(scenario, data, assignments)
    root = own.file.seed if seed is None else seed
    if isinstance(data, Recording) or _is_raw(own.raw, Path(data)):
        recording = own.completed(recording, root, run)
    return Pass(own, recording, root, False, run)


def recorded_pass(
    scenario: Scenario | str | Path,
    data: Recording | str | Path,
    assignments: Sequence[str] = (),
) -> tuple[Scenario, Recording]:
    """A scenario with what recorded data bring for it, and the data, without the sensors that are
    to be simulated on their truth; see `open_pass`, which simulates them.

    Raises InputError on whatever is wrong with any of them.
    """
    where, raw, made = _tables_of(scenario, assignments)
    if isinstance(data, Recording):
        own = made(data.settings)
        return own, _window(own, data)
    folder = Path(data)
    if not folder.exists():
        raise InputError(f"{folder}: no such folder")
    if not _is_raw(raw, folder):
        own = made(read_settings_of(folder, raw))
        return own, _window(own, _recorded(own, folder))
    recording = _read_folder(where, raw, folder, made)
    own = made(recording.settings)
    return own, _window(own, recording)


def _window(scenario: Scenario, recording: Recording) -> Recording:
    """The part of a recording that [data] begin and end leave. Raises InputError where that is
    nothing."""
    data = scenario.file.data
    if data is None or (data.begin is None and data.end is None):
        return recording
    begin = -math.inf if data.begin is None else data.begin
    part = recording.between(begin, math.inf if data.end is None else data.end)
    if len(recording.times) and not len(part.times):
        first, last = recording.times[[0, -1]].tolist()
        window = f"data: found no epoch from begin = {data.begin} until before end = {data.end} s"
        raise InputError(f"{window}, expected some: those of the data are from {first} to {last} s")
    return part


def _tables_of(
    scenario: Scenario | str | Path, assignments: Sequence[str]
) -> tuple[str, dict[str, Any], Callable[[Mapping[str, Any] | None], Scenario]]:
    """Where a scenario is from, its tables, and what makes it of them and of the settings that
    data bring, if there are any."""
    known = scenario if isinstance(scenario, Scenario) else None
    path = Path() if isinstance(scenario, Scenario) else Path(scenario)
    raw = override(known.raw if known else read_toml(path), assignments)

    def made(settings: Mapping[str, Any] | None) -> Scenario:
        if known and not assignments and not settings:
            return known
        return make_scenario(raw, known.name if known else path.stem, settings)

    return known.name if known else str(path), raw, made


def _read_folder(
    where: str,
    raw: Mapping[str, Any],
    folder: Path,
    made: Callable[[Mapping[str, Any] | None], Scenario],
) -> Recording:
    """What the readers that a scenario names make of raw data, in the clock of the pass.

    made: makes the scenario, of the settings of the data or before they are known.
    """
    data = raw.get("data")
    if not isinstance(data, dict) or not ("reader" in data or "parts" in data):
        raise InputError(
            f"{folder}: no scenario.toml in it, and {where} names no [data] reader for raw folders"
        )
    try:
        DataSettings.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(where, from_pydantic("data", error)) from error
    if problems := data_problems(data):
        raise ScenarioError(where, problems)
    time = raw.get("time", {})
    try:
        told = TimeSettings.model_validate(time)
    except ValidationError as error:
        raise ScenarioError(where, from_pydantic("time", error)) from error
    known = known_of(made(None)) if need_known(data) else Known(origin=told.origin)
    epoch = None if told.epoch is None else Instant.parse(told.epoch)
    return read_data(data, folder, known, epoch)


def known_of(scenario: Scenario) -> Known:
    """What readers may know of a scenario."""
    return Known(
        scenario.sensors,
        scenario.input_columns,
        {b.name: b for b in scenario.layout},
        {b.name for b in scenario.layout.statics},
        scenario.file.orbit is not None,
        scenario.file.time.tolerance,
        scenario.file.time.origin,
        {name for name, stamps in scenario.stamps.items() if stamps.lag},
        complete=scenario.file.sensors.keys() <= scenario.sensors.keys()
        and scenario.file.processes.keys() <= scenario.processes.keys(),
    )


def _recorded(scenario: Scenario, folder: Path) -> Recording:
    """The recording in a data set; a sensor's table is read by the scenario's model."""
    layout, time = scenario.layout, scenario.file.time
    blocks = {b.name: b for b in layout}
    models = scenario.sensors, scenario.input_columns
    late = [name for name, stamps in scenario.stamps.items() if stamps.lag]
    data = scenario.file.data
    found = read_dataset(
        *(folder, *models, blocks, time.tolerance, layout.statics, time.origin, late),
        *((data.sort, data.truth_gap) if data is not None else ()),
    )
    if found.truth is None:
        return found
    truth = with_true_copies(found.truth, scenario.sensors)
    return replace(found, truth=scenario.with_noise(scenario.with_map(truth)))


def _need_folder(folder: Path) -> None:
    if not folder.is_dir():
        what = "is a file, expected a folder" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: {what}")
