"""One run of a study: simulate, estimate, record. Depends on nothing but its number."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.errors import InputError, RelnavError
from relnav_graph.estimators import try_estimator
from relnav_graph.runs.comparison import estimate_pass
from relnav_graph.runs.passes import simulated_pass
from relnav_graph.runs.warm_up import warm_up
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.sim.sensors import stream
from relnav_graph.study.record import RunRecord, make_record

__all__ = ["StudySpec", "prepare", "run_record"]


@dataclass(frozen=True)
class StudySpec:
    """What decides the numbers of a study, and nothing else.

    raw: the tables of the scenario, as in its file; seed: root of all random numbers;
    estimators: kinds, in order.
    """

    name: str
    raw: Mapping[str, Any]
    seed: int
    estimators: tuple[str, ...]

    def to_json(self) -> str:
        """A text that tells two specs apart, and travels to workers. The order of tables
        stays: the state is laid out, and drawn, in the order of the processes."""
        return json.dumps(asdict(self))

    @staticmethod
    def of(scenario: Scenario, seed: int | None, estimators: tuple[str, ...]) -> StudySpec:
        """Of a scenario that can be simulated; its own seed and estimators by default.

        Raises InputError on one that cannot.
        """
        if scenario.truth is None:
            raise InputError(f"{scenario.name}: no [truth] to draw runs from; a study needs one")
        chosen = dict.fromkeys(estimators or scenario.file.estimators)
        seed = scenario.file.seed if seed is None else seed
        return StudySpec(scenario.name, dict(scenario.raw), seed, tuple(chosen))


@lru_cache(maxsize=4)
def _prepared(spec_json: str) -> tuple[StudySpec, Scenario]:
    """Spec and scenario, made once in each worker."""
    fields = json.loads(spec_json)
    spec = StudySpec(**{**fields, "estimators": tuple(fields["estimators"])})
    return spec, make_scenario(spec.raw, spec.name)


def prepare(spec_json: str) -> None:
    """Compile what the runs will need, in time for workers to find it compiled."""
    spec, scenario = _prepared(spec_json)
    warm_up(simulated_pass(scenario, spec.seed), spec.estimators)


def run_record(spec_json: str, run: int) -> bytes:
    """The record of a run, as bytes. A run that fails gives a record that says why."""
    spec, scenario = _prepared(spec_json)
    # On one thread throughout: the order of sums, and so the last digit, depends on it.
    with threadpool_limits(1, "blas"):
        try:
            record = _run(spec, scenario, run)
        except (RelnavError, ArithmeticError, np.linalg.LinAlgError) as error:
            record = RunRecord({"run": run, "failed": f"{type(error).__name__}: {error}"}, {})
    return record.to_bytes()


def _run(spec: StudySpec, scenario: Scenario, run: int) -> RunRecord:
    return make_record(
        run,
        estimate_pass(simulated_pass(scenario, spec.seed, run), spec.estimators, try_estimator),
        scenario.derived,
        scenario.window(scenario.times),
        stream(spec.seed, run, "probes"),
        scenario.scored.without,
    )
