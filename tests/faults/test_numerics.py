"""Transactions, Jacobians, keys, scales and ratios of noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numeric import assert_jacobian
from online_passes import KINDS, assert_same, driven, fresh, snapshot, toy
from passes import FIX, ONE_ID, PROCESSES, RANGER, SENSORS, toy_measurements, toy_problem
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from toy_model import RANGE_DRIFT, DriftingRange, PositionFix

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.conformance.numeric import differences
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Block
from relnav_graph.errors import EstimationError, InputError, ModelError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.source import UNSOLVED
from relnav_graph.linear import gtsam_factors
from relnav_graph.maths.losses import Loss

# --- a step that fails changes nothing ---------------------------------------------------------


def _raise(error: BaseException) -> Callable[..., Any]:
    def fail(*arguments: Any, **options: Any) -> Any:
        raise error

    return fail


#: Where a step may be struck: before the update, in it, and after it.
PLACES: dict[str, list[str]] = {
    "iekf": ["ekf.filter_epochs", "online.monitor.Monitor.after"],
    "fixed_lag": ["ekf.filter_epochs", "window.linearize", "fixed_lag.solve_gated"],
    "incremental": ["ekf.filter_epochs", "incremental.linearize", "online.monitor.Monitor.after"],
    "isam2": ["ekf.filter_epochs", "isam2.Tree.update", "online.monitor.Monitor.after"],
}
STRUCK = [(kind, place) for kind, places in PLACES.items() for place in places]


@pytest.mark.parametrize(("kind", "place"), STRUCK)
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, MemoryError])
def test_row_24_a_step_that_fails_changes_nothing(
    kind: str, place: str, error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    # With a loss, the window is searched for its minimum in every step.
    problem = toy() if "solve" not in place else replace(toy(), losses={"fix": Loss("huber")})
    one, reference = driven(kind, problem, problem.epochs[:20]), driven(kind, problem)
    before = snapshot(one)
    with monkeypatch.context() as patch:
        patch.setattr(f"relnav_graph.estimators.{place}", _raise(error("struck")))
        # As it is, or chained to a ModelError that says where.
        with pytest.raises((error, ModelError), match="struck"):
            one.step(problem.epochs[20])
        late = replace(problem.epochs[15].measurements[0], t=15.5)
        with pytest.raises((error, ModelError), match="struck"):
            one.insert([late])
    assert_same(snapshot(one), before)
    for epoch in problem.epochs[20:]:
        one.step(epoch)
    assert_same(snapshot(one), snapshot(reference))


def _untold() -> Problem:
    """A prior so wide that its numbers overflow with one fix."""
    wide = Prior(np.zeros(7), np.diag([1e308] * 3 + [1.0] * 4))
    return replace(toy(), prior=wide)


@pytest.mark.parametrize("kind", KINDS)
def test_row_24_an_indeterminate_system(kind: str) -> None:
    problem = _untold()
    one = fresh(kind, problem)
    before = snapshot(one) | {"t": np.array(-1.0)}
    with pytest.raises((EstimationError, ModelError), match=r"t = 0.0 s|at t = 0"):
        one.step(problem.epochs[0])
    assert_same(snapshot(one) | {"t": np.array(-1.0)}, before)
    assert one.health() == ("LOST", "no epoch was taken in yet")
    for kind_of_pass in ("ekf", "batch"):
        track = run_estimator(kind_of_pass, problem)
        assert track.status == "diverged"
        assert not np.isfinite(track.x).any()


def test_row_24_the_reason_names_blocks_and_times() -> None:
    from relnav_graph.linear.assembly import Assembly
    from relnav_graph.linear.conditionals import Anchor
    from relnav_graph.linear.elimination import linearize

    problem = toy()
    fixes = [m for m in toy_measurements() if m.sensor == "fix"]
    epochs = make_epochs(PROCESSES, fixes, {})[:3]
    assembly = Assembly(problem.layout, PROCESSES, SENSORS, epochs)
    x = np.tile(problem.prior.x, (3, 1))
    whiten = assembly.whitening(x[:-1])
    nothing = Anchor(problem.prior.x, np.zeros((7, 7)), np.zeros(7))
    says = rf"does not determine {RANGE_DRIFT.name} at t = 2\.0 s"
    with pytest.raises(EstimationError, match=says):
        linearize(assembly, nothing, x, whiten, np.ones(assembly.observations))
    assert EstimationError in UNSOLVED


# --- models and keys ------------------------------------------------------------------------


@jit
def wrong_by_a_millionth(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    H[:, :] = 0.0
    for i in range(3):
        r[i] = x[i] - z[i]
        H[i, i] = 1.000003
    return 0


@pytest.mark.parametrize(("kernel", "right"), [(None, True), (wrong_by_a_millionth, False)])
def test_row_22_a_wrong_jacobian_is_caught(kernel: Any, right: bool) -> None:
    """The check that every model of `factors` has to pass, on one that is wrong by 3e-6."""
    members = {} if kernel is None else {"kernel": staticmethod(kernel)}
    sensor = type("Checked", (PositionFix,), members)(covariance=np.eye(3))
    m, x = Measurement("fix", 0.0, np.zeros((1, 3)), ONE_ID), np.array([1.0, 2.0, 3.0])

    def r(d: Array) -> Array:
        found: Array = sensor.residual(m, x + d)[0]
        return found

    got = sensor.residual(m, x)[1][0]
    rows = columns = [slice(0, 3)]
    want = differences(r, np.full(3, 1e-3))
    if right:
        assert_jacobian(got, want, rows, columns, np.ones(3))
        return
    with pytest.raises(AssertionError):
        assert_jacobian(got, want, rows, columns, np.ones(3))


RANGES = Measurement("ranger", 0.0, np.ones((3, 1)), np.arange(3))
BAD_KEYS: dict[str, Any] = {
    "too few": [1],
    "too many": [1, 2, 3],
    "twice the same": [1, 1],
    "none": [],
    "text": ["a", "b"],
    "fractions": [0.5, 1.5],
    "negative": [-1, 2],
}


@pytest.mark.parametrize("name", BAD_KEYS)
def test_row_25_bad_keys_are_refused_before_gtsam_sees_them(name: str) -> None:
    with pytest.raises(InputError, match=r"drifting_range: found keys .*'relative_position'"):
        gtsam_factors.measurement_factor(RANGER, RANGES, BAD_KEYS[name])


@pytest.mark.parametrize(
    ("key", "block", "value"),
    [
        (1, RELATIVE_POSITION, np.zeros(2)),
        (1, RELATIVE_POSITION, "a"),
        (1, RELATIVE_POSITION, np.full(3, np.nan)),
        (1, Block("a", "R", "SO3", 3, "rad", "ab", "deg"), np.ones((3, 3))),
        (1, RELATIVE_POSITION, np.zeros((3, 1))),
    ],
)
def test_row_25_a_value_of_the_wrong_size_or_type(key: int, block: Block, value: Any) -> None:
    import gtsam

    values = gtsam.Values()
    with pytest.raises((InputError, ValueError), match=r"found|convert|not a rotation"):
        gtsam_factors.insert_block(values, key, block, value)
    assert values.size() == 0


def test_row_25_unknown_and_unused_names() -> None:
    one = fresh("ekf", toy())
    with pytest.raises(InputError, match="unknown sensor 'sonar', expected one of: fix, ranger"):
        one.admit("sonar", 0.0, np.zeros((1, 1)), ONE_ID)
    assert one.counts.keys() == {"fix", "ranger"}  # or names would take memory without end
    for option in ("gates", "losses"):
        with pytest.raises(InputError, match=f"{option}: unknown sensor 'sonar'"):
            toy_problem(toy_measurements(), **{option: {"sonar": 0.9}})


# --- scales and ratios ----------------------------------------------------------------------


def _rest(ratio: float, count: int = 40) -> Problem:
    """A body in one place but for process noise of that ratio to the prior's sigma, 10 m."""
    processes = {"motion": _Still(sigma=10.0 * ratio)}
    rng, out = np.random.default_rng(1), []
    for t in range(count):
        z = np.array([3.0, -2.0, 1.0]) + 0.1 * rng.normal(size=3)
        out.append(Measurement("fix", float(t), z[None], ONE_ID))
    prior = Prior(np.zeros(3), 100.0 * np.eye(3))
    return Problem(processes, {"fix": FIX}, prior, make_epochs(processes, out, {}))


@jit
def _still(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    for i in range(3):
        x_next[i] = x[i]
        for j in range(3):
            F[i, j] = 1.0 if i == j else 0.0
            Q[i, j] = p[0] ** 2 if i == j else 0.0
    return 0


class _Still(DynamicsModel):
    """Position as a random walk, sigma per step; zero is allowed."""

    kind = "still"
    kernel = staticmethod(_still)

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma

    @property
    def advances(self) -> tuple[Block, ...]:
        return (RELATIVE_POSITION,)

    def constants(self) -> Array:
        return np.array([self.sigma])


@pytest.mark.parametrize("ratio", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 0.0])
@pytest.mark.parametrize("kind", ["incremental", "isam2", "fixed_lag", "batch"])
def test_row_27_ratios_of_process_noise(kind: str, ratio: float) -> None:
    """Against a Kalman filter and a smoother of a few lines."""
    problem = _rest(ratio)
    q, P, filtered = (10.0 * ratio) ** 2, 100.0, []
    for k in range(len(problem.epochs)):
        P = P + (q if k else 0.0)
        P = P * 0.01 / (P + 0.01)
        filtered.append(P)
    smoothed = filtered.copy()
    for k in range(len(filtered) - 2, -1, -1):
        gain = filtered[k] / (filtered[k] + q)
        smoothed[k] = filtered[k] + gain**2 * (smoothed[k + 1] - filtered[k] - q)
    track = run_estimator(kind, problem)
    if track.kind == "filtered":
        np.testing.assert_allclose(np.sqrt(track.P[:, 0, 0]), np.sqrt(filtered), rtol=1e-3)
    ahead = track if track.kind == "smoothed" else track.smoothed
    assert ahead is not None
    last = -30 if ahead.kind == "fixed-lag" else 0
    found, want = np.sqrt(ahead.P[last:, 0, 0]), np.sqrt(smoothed[last:])
    np.testing.assert_allclose(found, want, rtol=1e-3)
    assert track.status == "ok", track.message


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("kind", ["iekf", "batch", "incremental", "isam2", "fixed_lag"])
def test_row_28_another_scale_is_the_same_problem(kind: str, scale: float) -> None:
    """Every length in other units."""
    reference = run_estimator(kind, toy())
    processes = {
        "motion": WhiteNoiseAcceleration(acceleration_density=scale * 0.002),
        "electronics": replace(PROCESSES["electronics"], density=scale * 0.002),
    }
    sensors: dict[str, Any] = {
        "fix": PositionFix(covariance=scale**2 * 0.01 * np.eye(3)),
        "ranger": DriftingRange(points=scale * 2 * np.eye(3), sigma=scale * 0.005),
    }
    prior = Prior(scale * toy().prior.x, scale**2 * toy().prior.P)
    measurements = [replace(m, z=scale * m.z) for m in toy_measurements()]
    epochs = make_epochs(processes, measurements, {}, np.arange(30.0))
    track = run_estimator(kind, Problem(processes, sensors, prior, epochs, window=12.0))
    sigma = np.sqrt(np.einsum("kii->ki", reference.P))
    assert (np.abs(track.x / scale - reference.x) / sigma).max() < 1e-5
    np.testing.assert_allclose(np.sqrt(np.einsum("kii->ki", track.P)) / scale, sigma, rtol=1e-5)
