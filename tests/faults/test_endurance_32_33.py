"""Many steps at the same cost; threads and processes."""

from __future__ import annotations

import multiprocessing
import threading
import tracemalloc
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from online_passes import KINDS, driven, toy
from passes import FIX, ONE_ID, PRIOR, PROCESSES

from relnav_graph.assembly import Assembly
from relnav_graph.errors import EstimationError
from relnav_graph.estimators import fixed_lag
from relnav_graph.estimators.fixed_lag import FixedLagEngine
from relnav_graph.models import Measurement
from relnav_graph.problem import Epoch, Problem

Array = NDArray[np.float64]
STEPS, WINDOW = 20_000, 2.0


def _steady() -> Problem:
    return Problem(PROCESSES, {"fix": FIX}, PRIOR, (), window=WINDOW)


def test_row_32_twenty_thousand_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is flat, and so is the work: epochs in the window, Gauss-Newton steps, rows."""
    problem, work = _steady(), list[tuple[int, int, int]]()
    solve_gated = fixed_lag.solve_gated

    def counted(assembly: Assembly, *arguments: Any) -> Any:
        solution = solve_gated(assembly, *arguments)
        rows, numbers = int(assembly.row_offsets[-1]), len(assembly.tables.numbers)
        work.append((len(assembly.times), solution.iterations, rows + numbers))
        return solution

    monkeypatch.setattr(fixed_lag, "solve_gated", counted)
    engine = FixedLagEngine(problem, WINDOW)
    state, u = engine.begin(), {name: np.array([[1.0]]) for name in PROCESSES}
    held, window = list[int](), work
    tracemalloc.start()
    try:
        for t in range(STEPS):
            z = PRIOR.x[None, :3] + 0.1 * np.sin(0.37 * t)
            m = Measurement("fix", float(t), z, ONE_ID)
            state = engine.advance(state, Epoch(float(t), (m,), u))
            if t in (STEPS // 20, STEPS - 1):
                held.append(tracemalloc.get_traced_memory()[0])
                window, work[:] = work[-100:], []
    finally:
        tracemalloc.stop()
    assert abs(held[1] - held[0]) < 200_000  # bytes
    assert len(state.parts) == WINDOW + 1
    assert {epochs for epochs, _, _ in window} == {WINDOW + 3}
    assert max(iterations for _, iterations, _ in window) <= 3
    assert len({size for _, _, size in window}) == 1


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
