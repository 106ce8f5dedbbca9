"""Rows 20 and 21: models that raise in a callback, and models that break their contract."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from broken_runs import run_broken
from passes import ONE_ID, PRIOR, PROCESSES
from toy_model import PositionFix, ThermalDrift

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.errors import ModelError
from relnav_graph.estimators.online.driver import Estimate, Online, online
from relnav_graph.streaming.lines import Header
from relnav_graph.streaming.session import Options, Session

KINDS = ("ekf", "iekf", "incremental", "fixed_lag")
#: A measured x above this makes the models of this file raise.
FAR = 100.0


class _Unplugged(Exception):
    """What a third party's model may raise."""


@jit
def raising_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    if z[0] > 100.0:
        raise ValueError("out of range")
    H[:, :] = 0.0
    for i in range(3):
        r[i] = x[i] - z[i]
        H[i, i] = 1.0
    return 0


class _RaisesInKernel(PositionFix):
    kernel = staticmethod(raising_kernel)


class _RaisesInNoise(PositionFix):
    def noise(self, m: Measurement) -> Array:
        if m.z[0, 0] > FAR:
            raise _Unplugged("the lamp is out")
        return super().noise(m)


class _RaisesInAccept(PositionFix):
    def accept(self, z: Array) -> Array:
        if z[0, 0] > FAR:
            raise _Unplugged("no such value")
        return super().accept(z)


CAUSES: list[tuple[Any, type[Exception], str]] = [
    (_RaisesInKernel, ValueError, "out of range"),
    (_RaisesInNoise, _Unplugged, "the lamp is out"),
    (_RaisesInAccept, _Unplugged, "no such value"),
]


def _epoch(t: float, x: float = 9.0) -> Epoch:
    inputs = {name: np.ones((1, 1)) for name in PROCESSES} if t else {}
    return Epoch(t, (Measurement("fix", t, np.array([[x, -6.0, 4.0]]), ONE_ID),), inputs)


def _problem(sensor: Any) -> Problem:
    return Problem(PROCESSES, {"fix": sensor(covariance=0.01 * np.eye(3))}, PRIOR, ())


def _same(a: Online, b: Online) -> bool:
    x, y = a.state(), b.state()
    return x.keys() == y.keys() and all(np.array_equal(x[k], y[k], equal_nan=True) for k in x)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("sensor", "cause", "says"), CAUSES)
def test_row_20_an_error_of_a_model_is_chained_and_undone(
    kind: str, sensor: Any, cause: type[Exception], says: str
) -> None:
    """At the newest epoch and in a late insertion; what follows is as if it had not been."""
    driven, spared = online(kind, _problem(sensor)), online(kind, _problem(sensor))
    for t in range(4):
        for estimator in (driven, spared):
            estimator.step(_epoch(float(t)))
    attempts: list[Callable[[], Estimate]] = [
        lambda: driven.step(_epoch(4.0, 2 * FAR)),
        lambda: driven.insert(_epoch(2.5, 2 * FAR).measurements),
    ]
    for attempt in attempts:
        with pytest.raises(ModelError, match=f"fix.*: a model raised .*{says}") as caught:
            attempt()
        assert isinstance(caught.value.__cause__, cause)
        assert _same(driven, spared)
    for estimator in (driven, spared):
        estimator.step(_epoch(4.0))
    assert _same(driven, spared)


@pytest.mark.parametrize(("sensor", "cause", "says"), CAUSES)
def test_row_20_a_stream_refuses_the_measurement_and_goes_on(
    sensor: Any, cause: type[Exception], says: str
) -> None:
    def line(t: int, x: float) -> bytes:
        return b'{"sensor": "fix", "t": %d, "id": [0], "z": [[%f, -6.0, 4.0]]}' % (t, x)

    problem = _problem(sensor)
    session = Session(problem, online("fixed_lag", problem), Header(t=0.0), Options())
    out = []
    for t in range(8):
        out += session.take(session.parse(line(t, 2 * FAR if t == 4 else 9.0)))
    out += session.pause()
    rejected = [r for o in out for r in o["rejected"]]
    assert [(r["sensor"], r["t"]) for r in rejected] == [("fix", 4.0)]
    assert says in rejected[0]["reason"]
    assert out[-1]["t"] == 7.0
    assert [o["status"] for o in out[5:]] == ["OK"] * (len(out) - 5)


def test_row_20_a_process_that_raises() -> None:
    @jit
    def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
        if t > 1.5:
            raise ValueError("overheated")
        x_next[0] = x[0]
        F[0, 0] = 1.0
        Q[0, 0] = 1.0
        return 0

    cls = type("Raising", (ThermalDrift,), {"kernel": staticmethod(kernel)})
    processes = {**PROCESSES, "electronics": cls(time_constant=1.0, density=1.0)}
    problem = Problem(processes, {"fix": PositionFix(covariance=np.eye(3))}, PRIOR, ())
    for kind in KINDS:
        estimator = online(kind, problem)
        for t in range(3):
            estimator.step(_epoch(float(t)))
        before = estimator.x.copy(), estimator.P.copy(), estimator.t
        with pytest.raises(ModelError, match="a model raised ValueError: overheated"):
            estimator.step(_epoch(3.0))
        with pytest.raises(ModelError, match="a model raised ValueError: overheated"):
            estimator.predict(3.0)
        np.testing.assert_array_equal(estimator.x, before[0])
        np.testing.assert_array_equal(estimator.P, before[1])
        assert estimator.t == before[2]


def test_row_21_broken_models_online_are_named_and_crash_nothing() -> None:
    """A wrong shape, None, an unfilled or NaN Jacobian, memory of others: in a process of its
    own, by filter, iSAM2 and fixed-lag smoother, which are each as before."""
    found = run_broken("online_sensor", "online_process")
    assert len(found) >= 14
    for (way, name), verdict in found.items():
        assert verdict.startswith("ModelError: "), f"{way} {name}: {verdict}"
