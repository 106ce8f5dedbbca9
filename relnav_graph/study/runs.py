"""One run of a study: simulate, estimate, record. Depends on nothing but its number."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.estimators import try_estimator
from relnav_graph.runs.comparison import estimate_pass
from relnav_graph.runs.passes import Pass, simulated_pass
from relnav_graph.runs.warm_up import warm_up
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.sim.sensors import stream
from relnav_graph.study.record import RunRecord, make_record
from relnav_graph.study.recorded import StudyData, read_again

__all__ = ["StudySpec", "prepare", "run_record"]


@dataclass(frozen=True)
class StudySpec:
    """What decides the numbers of a study, and nothing else.

    raw: the tables of the scenario, as in its file; seed: root of all random numbers;
    estimators: kinds, in order; data: what is recorded, on which sensors are drawn anew in each
    run; None: each run is simulated.
    """

    name: str
    raw: Mapping[str, Any]
    seed: int
    estimators: tuple[str, ...]
    data: StudyData | None = None

    def to_json(self) -> str:
        """A text that tells two specs apart, and travels to workers. The order of tables
        stays: the state is laid out, and drawn, in the order of the processes."""
        found = asdict(self)
        if self.data is None:
            del found["data"]
        return json.dumps(found)

    @staticmethod
    def of(
        scenario: Scenario,
        seed: int | None,
        estimators: tuple[str, ...],
        data: StudyData | None = None,
    ) -> StudySpec:
        """Of a scenario that can be simulated, or whose sensors can be, on recorded data; its own
        seed and estimators by default.

        Raises InputError on one that cannot.
        """
        if scenario.truth is None and data is None:
            raise InputError(
                f"{scenario.name}: no [truth] to draw runs from; a study needs one, or recorded"
                " data (--data) with a truth on which sensors are simulated (data.simulate)"
            )
        chosen = dict.fromkeys(estimators or scenario.file.estimators)
        seed = scenario.file.seed if seed is None else seed
        return StudySpec(scenario.name, dict(scenario.raw), seed, tuple(chosen), data)

    def read(self) -> tuple[Scenario, Recording | None]:
        """The scenario, and the recording where there is one. Raises InputError where it cannot be
        read, or is another one than the study began with."""
        if self.data is None:
            return make_scenario(self.raw, self.name), None
        return read_again(self.raw, self.name, self.data)

    def drawn(self, scenario: Scenario, recording: Recording | None, run: int) -> Pass:
        """The pass of a run, of what `read` gives. Raises InputError when it cannot be drawn."""
        if recording is None:
            return simulated_pass(scenario, self.seed, run)
        whole = scenario.completed(recording, self.seed, run)
        return Pass(scenario, whole, self.seed, False, run)


@lru_cache(maxsize=4)
def _prepared(spec_json: str) -> tuple[StudySpec, Scenario, Recording | None]:
    """Spec, scenario and what is recorded, made once in each worker."""
    fields = json.loads(spec_json)
    data = StudyData(**fields["data"]) if "data" in fields else None
    spec = StudySpec(**{**fields, "estimators": tuple(fields["estimators"]), "data": data})
    return spec, *spec.read()


def prepare(spec_json: str) -> None:
    """Compile what the runs will need, in time for workers to find it compiled."""
    spec, scenario, recording = _prepared(spec_json)
    warm_up(spec.drawn(scenario, recording, 0), spec.estimators)


def run_record(spec_json: str, run: int) -> bytes:
    """The record of a run, as bytes. A run that fails gives a record that says why."""
    spec, scenario, recording = _prepared(spec_json)
    # On one thread throughout: the order of sums, and so the last digit, depends on it.
    with threadpool_limits(1, "blas"):
        try:
            record = _run(spec, scenario, recording, run)
        except (RelnavError, ArithmeticError, np.linalg.LinAlgError) as error:
            record = RunRecord({"run": run, "failed": f"{type(error).__name__}: {error}"}, {})
    return record.to_bytes()


def _run(spec: StudySpec, scenario: Scenario, recording: Recording | None, run: int) -> RunRecord:
    opened = spec.drawn(scenario, recording, run)
    times = scenario.times if recording is None else opened.problem.times
    return make_record(
        run,
        estimate_pass(opened, spec.estimators, try_estimator),
        scenario.derived,
        scenario.window(times),
        stream(spec.seed, run, "probes"),
        scenario.scored.without,
    )
