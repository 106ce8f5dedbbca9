"""Sensors with h(x) in plain Python: as good as those with a kernel, wherever these run."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest
import third_party
from passes import relnav
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from toy_model import DriftingRange, ThermalDrift

import relnav_graph as rg
from relnav_graph.arrays import Array, Indices
from relnav_graph.core.catalogue import CHASER_ATTITUDE, RELATIVE_POSITION
from relnav_graph.core.conformance.checks import check_example
from relnav_graph.core.conformance.examples import example_of
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.numerical import NumericalSensor
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Block
from relnav_graph.core.timed import TimedSensor
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.maths import so3
from relnav_graph.units import Quantity


@dataclass(frozen=True)
class Bearing(NumericalSensor):
    """As `third_party.Bearing`, without its kernel."""

    kind: ClassVar[str] = "numerical_bearing"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    blocks: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, RELATIVE_POSITION)

    sigma: Annotated[float, Quantity("m", positive=True)] = 0.1

    def h(self, R_oc: Array, r_tc_o: Array) -> Array:
        return R_oc.T @ r_tc_o


@dataclass(frozen=True)
class Ranges(NumericalSensor):
    """Distances from reflectors; one that is behind a wall cannot be seen."""

    kind: ClassVar[str] = "numerical_ranges"
    columns: ClassVar[tuple[str, ...]] = ("range_m",)
    blocks: ClassVar[tuple[Block, ...]] = (RELATIVE_POSITION,)

    points: Annotated[Array, Quantity("m", (None, 3))]
    sigma: Annotated[float, Quantity("m", positive=True)] = 0.01
    wall: float = -np.inf
    fails: str = ""

    def observables(self) -> Indices:
        return np.arange(len(self.points))

    def observation_data(self, ids: Indices) -> Array:
        return np.ascontiguousarray(self.points[ids])

    def h(self, q: Array, r_tc_o: Array) -> Any:
        if self.fails:
            raise ZeroDivisionError(self.fails)
        if r_tc_o[0] - q[0] < self.wall:
            raise GeometryError("behind the wall")
        return np.linalg.norm(r_tc_o - q)


RATE = Block("rate", "e", "vector", 1, "m/s", "-", "m/s")
POINTS = np.array([[2.0, 0, 0], [-2, 0, 1], [0, 2, -1], [0, -2, 0]])


def test_it_passes_the_checks_of_a_model() -> None:
    for model in (Bearing(), Ranges(points=POINTS)):
        found = list(check_example(example_of(model), 8))
        assert [c.name for c in found] == ["contract", "outputs", "jacobian", "noise"]
        assert not [str(f) for c in found for f in c.faults]


def test_its_jacobian_is_that_of_the_kernel() -> None:
    """To 1e-9, for positions from a millimetre to an orbit's."""
    rng, known = np.random.default_rng(0), third_party.Bearing(sigma=0.1)
    for size in (1e-3, 1.0, 1e3, 7e6):
        R, r = so3.exp(rng.normal(size=3)), size * rng.normal(size=3)
        m = Measurement("s", 0.0, rng.normal(size=(1, 3)), np.zeros(1, np.int64))
        (e, own), (e_known, parts) = (s.residual(m, R, r) for s in (Bearing(), known))
        np.testing.assert_allclose(e, e_known, rtol=1e-14)
        for a, b in zip(own, parts, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-9 * max(1.0, np.abs(b).max()))


def ranged(sensor: Any, count: int = 15) -> Problem:
    rng, t = np.random.default_rng(3), np.arange(count) * 1.0
    places = np.array([9.0, -6, 4]) + np.outer(t, [-0.2, 0.1, 0])
    z = [np.linalg.norm(p - POINTS, axis=1) + 0.01 * rng.normal(size=4) for p in places]
    ids = np.arange(4)
    seen = [Measurement("ranges", s, v[:, None], ids) for s, v in zip(t, z, strict=True)]
    own = {"motion": WhiteNoiseAcceleration(acceleration_density=1e-3)}
    prior = Prior(np.array([9.0, -6, 4, 0, 0, 0]), np.diag([1.0] * 3 + [0.1] * 3))
    return Problem(own, {"ranges": sensor}, prior, rg.make_epochs(own, seen, {}))


@pytest.mark.parametrize("kind", ["iekf", "batch", "isam2"])
def test_filters_and_smoothers_run_on_it(kind: str) -> None:
    """As on the sensor that has a kernel: here the built-in way to the same ranges."""
    track = rg.run_estimator(kind, ranged(Ranges(points=POINTS)))
    drift = ThermalDrift(time_constant=1.0, density=1e-9)
    other = ranged(Ranges(points=POINTS))
    own = {**other.processes, "drift": drift}
    prior = Prior(np.append(other.prior.x, 0.0), np.diag([*np.diag(other.prior.P), 1e-18]))
    seen = [m for e in other.epochs for m in e.measurements]
    sensors = {"ranges": DriftingRange(points=POINTS, sigma=0.01)}
    known = Problem(own, sensors, prior, rg.make_epochs(own, seen, {}))
    reference = rg.run_estimator(kind, known)
    sigma = np.sqrt(np.diagonal(reference.P, axis1=1, axis2=2))[:, :6]
    assert np.abs((track.x - reference.x[:, :6]) / sigma).max() < 1e-5
    assert track.status == "ok"


def test_what_it_does_not_see_is_left_out_and_what_it_raises_ends_the_estimate() -> None:
    track = rg.run_estimator("iekf", ranged(Ranges(points=POINTS, wall=8.5)))
    assert 5 < track.rejected["ranges"] < 45
    fails = rg.run_estimator("batch", ranged(Ranges(points=POINTS, fails="no such thing")))
    assert fails.status == "diverged"
    assert "h raised ZeroDivisionError: no such thing" in fails.message
    with pytest.raises(GeometryError, match=r"id 1.*behind the wall"):
        Ranges(points=POINTS, wall=8.5).predict(np.array([1]), np.zeros(3))


def test_copies_answer_for_themselves() -> None:
    """A pickled one, as of a worker process, and a changed one have numbers of their own."""
    first = Ranges(points=POINTS)
    near, place = np.array([0]), np.array([5.0, 0, 0])
    assert first.predict(near, place) == 3.0
    moved, copied = replace(first, points=POINTS + 1.0), pickle.loads(pickle.dumps(first))
    assert moved.predict(near, place) != 3.0
    assert copied.predict(near, place) == first.predict(near, place) == 3.0
    numbers = {s.constants()[0] for s in (first, moved, copied)}
    assert len(numbers) == 3
    assert first.constants()[0] in numbers  # and keep them


def test_a_width_that_is_wrong_is_said() -> None:
    class Wide(Bearing):
        kind = "numerical_wide"

        def h(self, R_oc: Array, r_tc_o: Array) -> Array:
            return np.zeros(4)

    m = Measurement("s", 0.0, np.zeros((1, 3)), np.zeros(1, np.int64))
    with pytest.raises(GeometryError, match=r"InputError: found \(4,\), expected 3: \('x_m'"):
        Wide().residual(m, np.eye(3), np.zeros(3))
    with pytest.raises(InputError, match=r"Bearing\.sigma: found -1"):
        Bearing(sigma=-1.0)


@dataclass(frozen=True)
class Drifting(TimedSensor, NumericalSensor):
    """A ranger whose error grows at a rate that is in the state."""

    kind: ClassVar[str] = "numerical_drifting"
    columns: ClassVar[tuple[str, ...]] = ("range_m",)
    blocks: ClassVar[tuple[Block, ...]] = (RELATIVE_POSITION, RATE)

    points: Annotated[Array, Quantity("m", (None, 3))]
    sigma: Annotated[float, Quantity("m", positive=True)] = 0.01

    def observables(self) -> Indices:
        return np.arange(len(self.points))

    def data_of(self, ids: Indices) -> Array:
        return self.points[ids]

    def h(self, q: Array, r_tc_o: Array, rate: Array) -> Any:
        return np.linalg.norm(r_tc_o - q[:3]) + q[3] * rate[0]


def test_a_sensor_that_needs_the_time_gets_it() -> None:
    """In filter and smoother: the rate is found, and with nothing but its growth."""
    checked = list(check_example(example_of(Drifting(points=POINTS)), 4))
    assert not [str(f) for c in checked for f in c.faults]
    problem = ranged(Ranges(points=POINTS))
    seen = [replace(m, z=m.z + 3.0 * m.t) for epoch in problem.epochs for m in epoch.measurements]
    prior = Prior(np.append(problem.prior.x, 0.0), np.diag([*np.diag(problem.prior.P), 100.0]))
    own, sensors = problem.processes, {"ranges": Drifting(points=POINTS)}
    timed = Problem(own, sensors, prior, rg.make_epochs(own, seen, {}))
    for kind in ("iekf", "batch"):
        track = rg.run_estimator(kind, timed)
        assert track.status == "ok"
        rate, sigma = track.value("rate")[-1], track.covariance("rate")[-1] ** 0.5
        assert abs(rate - 3.0) < 4 * sigma < 0.2
    residual = Drifting(points=POINTS).residual(seen[-1], np.zeros(3), np.array([1.0]))[0]
    expected = np.linalg.norm(POINTS, axis=1) + seen[-1].t - seen[-1].z[:, 0]
    np.testing.assert_allclose(residual, expected)


def test_relnav_check_takes_it(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = relnav(capsys, "check", "test_numerical:Bearing", "--states", 3)
    assert code == 0, out
