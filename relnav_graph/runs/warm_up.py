"""Compiling ahead, so that compilation does not count as the run time of an estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from relnav_graph.estimators import try_estimator
from relnav_graph.runs.closed_loop import fly_all
from relnav_graph.runs.passes import Pass
from relnav_graph.scenario.scenario import Scenario

__all__ = ["warm_up"]


def warm_up(opened: Pass, kinds: Sequence[str]) -> None:
    """Compile what estimators need, by running them on a few epochs of a pass.

    Raises InputError as a whole run would.
    """
    if opened.flown:
        for _ in fly_all(_first_epochs(opened.scenario), kinds, opened.seed):
            pass
        return
    few = replace(opened.problem, epochs=opened.problem.epochs[:3])
    for kind in kinds:
        try_estimator(kind, few)


def _first_epochs(scenario: Scenario) -> Scenario:
    few = scenario.file.time.model_copy(update={"epochs": min(4, len(scenario.times))})
    return replace(scenario, file=scenario.file.model_copy(update={"time": few}))
