"""Many steps at the same cost; threads and processes."""

from __future__ import annotations

import multiprocessing
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from online_passes import KINDS, driven, toy
from passes import FIX, ONE_ID, PRIOR, PROCESSES

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.errors import EstimationError
from relnav_graph.estimators import window
from relnav_graph.estimators.fixed_lag import FixedLagEngine
from relnav_graph.linear import elimination
from relnav_graph.linear.assembly import Assembly

STEPS, WINDOW = 20_000, 2.0


def _resident() -> int:
    """Memory of this process, bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _fixes() -> Problem:
    rest = PRIOR.x[None, :3]
    fixes = [
        Measurement("fix", float(t), rest + 0.1 * np.sin(0.37 * t), ONE_ID) for t in range(STEPS)
    ]
    return Problem(PROCESSES, {"fix": FIX}, PRIOR, make_epochs(PROCESSES, fixes, {}), window=WINDOW)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
def test_row_32_twenty_thousand_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is flat, and so is the work: epochs in the window, rows linearised."""
    problem, work = _fixes(), list[int]()
    linearize = elimination.linearize

    def counted(assembly: Assembly, *arguments: Any, **options: Any) -> Any:
        work[-1] += int(assembly.row_offsets[-1])
        return linearize(assembly, *arguments, **options)

    monkeypatch.setattr(window, "linearize", counted)
    engine, whole = FixedLagEngine(problem, WINDOW), Assembly.of(problem)
    state, before = engine.begin(), 0
    for k, epoch in enumerate(problem.epochs):
        work.append(0)
        state = engine.advance(state, epoch, whole.at(k))
        if k == 1000:
            before = _resident()
    assert _resident() - before < 2_000_000
    assert len(state.parts) == WINDOW + 1
    early, late = np.array(work[1000:4000]), np.array(work[-3000:])
    # A step linearises the newest epoch's 3 rows, and at most all of the window twice.
    assert early.min() == late.min() == 3
    assert max(work[1000:]) <= 3 + 2 * 3 * (WINDOW + 2)
    assert late.mean() == pytest.approx(early.mean(), rel=0.1)


def _estimate(kind: str) -> Array:
    one = driven(kind, toy())
    return np.concatenate([one.x, one.P.ravel()])


@pytest.mark.parametrize("kind", KINDS)
def test_row_33_two_estimators_in_two_threads(kind: str) -> None:
    want, found = _estimate(kind), list[Array]()
    threads = [threading.Thread(target=lambda: found.append(_estimate(kind))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 2
    for result in found:
        np.testing.assert_array_equal(result, want)


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_row_33_pools_of_processes(method: str) -> None:
    kinds = ["iekf", "fixed_lag"]
    with multiprocessing.get_context(method).Pool(2) as pool:
        found = pool.map(_estimate, kinds)
    for kind, result in zip(kinds, found, strict=True):
        np.testing.assert_array_equal(result, _estimate(kind))


def test_row_33_sharing_one_estimator_is_refused() -> None:
    one, caught = driven("fixed_lag", toy(), toy().epochs[:5]), list[str]()
    x = one.x.copy()

    def intrude() -> None:
        for action in (one.step, lambda e: one.insert(e.measurements)):
            try:
                action(toy().epochs[5])
            except EstimationError as error:
                caught.append(str(error))

    thread = threading.Thread(target=intrude)
    thread.start()
    thread.join()
    assert caught == 2 * ["an estimator serves one thread: make one for each"]
    np.testing.assert_array_equal(one.x, x)
    one.step(toy().epochs[5])
