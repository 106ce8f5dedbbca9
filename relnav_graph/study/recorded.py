"""Studies on recorded data: of a truth that was recorded, with sensors drawn anew on it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.runs.passes import is_dataset, recorded_pass
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.study.record import bin_edges

__all__ = ["StudyData", "open_data", "read_again"]


@dataclass(frozen=True)
class StudyData:
    """The recorded data of a study. folder: where they are; digest: of what the reader made of
    them; epochs: of a run; centres: mean time of each bin of its series, s; same: the inputs and
    sensors that are recorded, and so the same in every run."""

    folder: str
    digest: str
    epochs: int
    centres: tuple[float, ...]
    same: tuple[str, ...]


def _digest(recording: Recording) -> str:
    found = hashlib.sha256()
    arrays = [recording.times]
    for name in sorted(recording.truth.values if recording.truth else {}):
        assert recording.truth is not None
        found.update(name.encode())
        arrays += [recording.truth.t, recording.truth.values[name]]
    for name in sorted(recording.inputs):
        found.update(name.encode())
        series = recording.inputs[name]
        arrays += [series.t_start, series.t_end, series.values]
    for m in recording.measurements:
        found.update(m.sensor.encode())
        arrays += [np.array([m.t]), m.z, m.ids.astype(np.float64)]
        arrays += [] if m.covariance is None else [m.covariance]
    for array in arrays:
        found.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def open_data(
    path: Path, folder: Path, assignments: tuple[str, ...], seed: int | None
) -> tuple[Scenario, StudyData]:
    """The scenario in a file with what a folder of recorded data brings, and that folder.

    Raises InputError where nothing would be drawn but the prior, where there is no truth, or on
    whatever is wrong with scenario or data.
    """
    scenario, recording = recorded_pass(path, folder, assignments)
    drawn = scenario.file.data.simulate if scenario.file.data is not None else []
    if not drawn or is_dataset(folder):
        held = "a data set, whose measurements are recorded" if is_dataset(folder) else "none"
        raise InputError(
            f"{folder}: found {held}, expected sensors that are drawn anew on it in each run"
            " (data.simulate, of a raw folder)"
        )
    root = scenario.file.seed if seed is None else seed
    times = scenario.problem(scenario.completed(recording, root), root).times
    edges = pairwise(bin_edges(len(times)))
    centres = tuple(float(0.5 * (times[a] + times[b - 1])) for a, b in edges)
    heard = {m.sensor for m in recording.measurements}
    same = (*recording.inputs, *(name for name in scenario.sensors if name in heard))
    data = StudyData(str(folder.resolve()), _digest(recording), len(times), centres, same)
    return scenario, data


def read_again(raw: Mapping[str, Any], name: str, data: StudyData) -> tuple[Scenario, Recording]:
    """Scenario and recording of a study, in a worker or later. raw: the scenario's tables.

    Raises InputError where the data are not there, or are not what the study began with.
    """
    known = make_scenario(raw, name)
    scenario, recording = recorded_pass(known, Path(data.folder))
    if _digest(recording) != data.digest:
        raise InputError(f"{data.folder}: found other data than those that the study began with")
    return scenario, recording
