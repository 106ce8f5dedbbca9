"""Estimators driven online over small passes, for the tests of faults."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from passes import ZHANG, toy_measurements, toy_problem

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording
from relnav_graph.estimators.online.driver import Estimate, Online, online
from relnav_graph.scenario.build import load_scenario

KINDS = ("ekf", "iekf", "ukf", "ekf_batch_start", "fixed_lag", "incremental", "isam2")
WINDOW = 12.0


@cache
def toy(**changes: Any) -> Problem:
    """Position fixes and ranges, 30 epochs one second apart, with a window of 12 s."""
    return toy_problem(toy_measurements(), window=WINDOW, **changes)


@cache
def zhang(count: int = 20, *settings: str) -> tuple[Problem, Recording]:
    """The first epochs of zhang2015, and what is true of them."""
    scenario = load_scenario(ZHANG, [f"time.epochs={count}", *settings])
    recording = scenario.simulate(0)
    return scenario.problem(recording, 0), recording


def fresh(kind: str, problem: Problem) -> Online:
    """An estimator that has taken in nothing yet."""
    return online(kind, replace(problem, epochs=()))


def driven(kind: str, problem: Problem, epochs: Iterable[Epoch] | None = None) -> Online:
    """An estimator that has taken in all epochs."""
    one = fresh(kind, problem)
    for epoch in problem.epochs if epochs is None else epochs:
        one.step(epoch)
    return one


def without(epoch: Epoch, sensor: str) -> Epoch:
    """An epoch without what one sensor measured."""
    return replace(epoch, measurements=tuple(m for m in epoch.measurements if m.sensor != sensor))


def snapshot(one: Online) -> dict[str, Array]:
    """Everything that an estimator knows, but for its counts of refusals."""
    state = {k: v.copy() for k, v in one.state().items() if not k.startswith("counts.")}
    return {**state, "x": one.x.copy(), "P": one.P.copy(), "t": np.array(one.t or np.nan)}


def assert_same(a: dict[str, Array], b: dict[str, Array]) -> None:
    """Bit for bit."""
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def in_sigmas(layout: Layout, one: Online | Estimate, reference: Online | Estimate) -> float:
    """Largest distance between two estimates, in sigmas of the second."""
    d = np.abs(layout.local(reference.x, one.x)) / np.sqrt(np.diag(reference.P))
    return float(d.max())
