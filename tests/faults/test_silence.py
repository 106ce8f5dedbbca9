"""Sensors that fall silent, and come back."""

from __future__ import annotations

import numpy as np
import pytest
from online_passes import KINDS, driven, fresh, toy, without, zhang
from passes import stored

from relnav_graph.core.epochs import Epoch


def _idle(t: float) -> Epoch:
    return Epoch(t, (), {k: np.array([[1.0]]) for k in toy().processes})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("periods", "one_silent", "all_silent"),
    [(1, "OK", "OK"), (10, "DEGRADED", "DEGRADED"), (100, "DEGRADED", "LOST")],
)
def test_row_13_silent_sensors(kind: str, periods: int, one_silent: str, all_silent: str) -> None:
    problem = toy()
    start = problem.epochs[:20]
    sigma = driven(kind, problem, start).P[0, 0]
    one = driven(kind, problem, start)
    for k in range(periods + 1):
        found = one.step(_idle(20.0 + k))
        assert found.P[0, 0] > sigma  # grows from step to step
        sigma = found.P[0, 0]
    assert found.status == all_silent
    assert ("fix: silent for" in found.message) == (all_silent != "OK")
    quiet, ids = driven(kind, problem, start), np.arange(3)
    for k in range(periods + 1):
        x = quiet.predict(20.0 + k)[0]
        ranges = problem.sensors["ranger"].predict(ids, x[:3], x[6:])
        m = quiet.admit("ranger", 20.0 + k, ranges, ids)
        found = quiet.step(Epoch(20.0 + k, (m,), _idle(20.0).inputs))
    assert found.status == one_silent
    assert ("fix: silent for" in found.message) == (one_silent != "OK")


@pytest.mark.parametrize("kind", KINDS)
def test_row_13_recovery_without_reset(kind: str) -> None:
    problem = toy()
    one = driven(kind, problem, problem.epochs[:20])
    for k in range(110):
        one.step(_idle(20.0 + k))
    assert one.health()[0] == "LOST"
    wide = one.P[0, 0]
    for k in range(5):
        t, x = 130.0 + k, one.predict(130.0 + k)[0]
        fix = one.admit("fix", t, x[None, :3] + 0.05, np.zeros(1, dtype=np.int64))
        ids = np.arange(3)
        ranges = problem.sensors["ranger"].predict(ids, x[:3] + 0.05, x[6:])
        found = one.step(Epoch(t, (fix, one.admit("ranger", t, ranges, ids)), _idle(t).inputs))
    assert found.status == "OK", found.message
    assert found.P[0, 0] < 1e-3 * wide


@pytest.mark.parametrize("kind", ["iekf", "fixed_lag", "incremental"])
def test_row_14_all_silent_for_several_tumbles(kind: str) -> None:
    """144 s a tumble; four of them without a beacon, then back."""
    problem, recording = zhang(150)
    one, truth = fresh(kind, problem), recording.truth
    assert truth is not None
    true_x, nees = stored(problem.layout, truth), []
    for k, epoch in enumerate(problem.epochs):
        silent = 80 <= k < 138
        found = one.step(without(epoch, "beacons") if silent else epoch)
        if k == 137:
            assert found.status == "LOST"
        if k >= 140:
            e = problem.layout.local(found.x, true_x[k])
            nees.append(e @ np.linalg.solve(found.P, e))
    assert found.status == "OK", found.message
    assert np.mean(nees) / problem.layout.dim < 2.0
