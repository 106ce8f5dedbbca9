"""Numbered blocks: points that are unknown beforehand, in every estimator, offline and online."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gtsam
import numpy as np
import pytest
from passes import ZHANG

from relnav_graph import to_gtsam
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import POINT
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.ekf import IteratedEkf, KalmanEngine
from relnav_graph.estimators.first_sights import first_epochs, first_sights, turned, unseen
from relnav_graph.estimators.online.driver import Online, online
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.partial_update import update_others
from relnav_graph.scenario.build import load_scenario

sys.path.insert(0, str(Path(__file__).parents[2] / "experiments"))
from benchmarks.mapped import WIDE, PointSight, mapped

POINTS = 14


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Ten of 14 unknown points in each of 40 frames, another four after each."""
    scenario = load_scenario(ZHANG.with_name("zhang2015_close.toml"), ["time.epochs=40"])
    recording = scenario.simulate(4)
    assert recording.truth is not None
    return mapped(scenario.problem(recording, 4), recording.truth, POINTS)


@pytest.fixture(scope="module")
def batch(problem: Problem) -> Track:
    track = run_estimator("batch", problem)
    assert track.status == "ok"
    return track


def _far(a: Track, b: Track, k: int = -1) -> float:
    """From the states of a at one epoch, static ones included, to those of b, in sigmas of a."""
    assert a.statics is not None
    assert b.statics is not None
    d = np.concatenate(
        [
            a.layout.local(a.x[k], b.x[k]),
            a.statics.layout.local(a.statics.x[k], b.statics.x[k]),
        ]
    )
    P = np.block(
        [
            [a.P[k], a.statics.cross[k]],
            [a.statics.cross[k].T, a.statics.P[k]],
        ]
    )
    return float(np.sqrt(d @ np.linalg.solve(P, d)))


def test_points_stand_last_in_order_of_first_sight(problem: Problem) -> None:
    names = [block.name for block in problem.layout.statics]
    assert names == [f"point[{i}]" for i in range(POINTS)]
    assert problem.prior.x.shape == (problem.layout.size,)
    np.testing.assert_array_equal(problem.prior.P[-3:, -3:], WIDE**2 * np.eye(3))
    later = replace(problem, epochs=problem.epochs[2:])
    assert later.layout.statics.blocks[0].name == "point[2]"


def test_a_family_without_a_prior_is_refused(problem: Problem) -> None:
    with pytest.raises(InputError, match=r"prior of point: found none, expected x \(3,\)"):
        replace(problem, numbered={})
    short = {"point": Prior(np.zeros(2), np.eye(2))}
    with pytest.raises(InputError, match=r"prior of point: found x of \(2,\)"):
        replace(problem, numbered=short)


def test_estimators_agree(problem: Problem, batch: Track) -> None:
    for kind, limit in (("incremental", 0.05), ("isam2", 0.05), ("fixed_lag", 0.05)):
        track = run_estimator(kind, problem)
        assert track.status == "ok"
        assert _far(batch, track) < limit, kind
        assert track.smoothed is not None
        if kind != "fixed_lag":
            assert _far(batch, track.smoothed, 0) < 1e-3, kind


def test_a_pass_of_less_than_a_quarter_turn_is_doubted(problem: Problem, batch: Track) -> None:
    short = run_estimator("iekf", replace(problem, epochs=problem.epochs[:5]))
    assert [c.name for c in short.cautions] == ["initialising"]
    assert re.match(r"the target has turned by \d+ of 90 deg", short.cautions[0].text)
    assert batch.cautions == ()  # 40 s of 2.5 deg/s


def test_the_graph_of_gtsam_has_the_same_optimum(problem: Problem, batch: Track) -> None:
    """Levenberg and Marquardt's way, over a variable of each point."""
    graph = to_gtsam(problem)
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(1e-14)
    found = gtsam.LevenbergMarquardtOptimizer(graph.factors, graph.values, params).optimize()
    x = graph.keys.trajectory(found, len(problem.epochs))
    d = problem.layout.moving.local(batch.x[-1], x[-1, : problem.layout.moving.size])
    assert np.sqrt(d @ np.linalg.solve(batch.P[-1], d)) < 1e-5
    for i in range(POINTS):
        point = found.atVector(graph.keys[f"point[{i}]", None])
        sigma = np.sqrt(np.diag(batch.covariance(f"point[{i}]")[-1]))
        assert np.abs((point - batch.value(f"point[{i}]")[-1]) / sigma).max() < 1e-5


def test_the_map_is_as_good_as_it_says(problem: Problem, batch: Track) -> None:
    """14 points, 42 numbers: their normalised error, jointly, within the 99.9 % band."""
    X = np.random.default_rng(0).normal(0.0, 1.0, (POINTS, 3))
    names = [f"point[{i}]" for i in range(POINTS)]
    e = np.concatenate([batch.value(n)[-1] for n in names]) - X.ravel()
    nees = e @ np.linalg.solve(batch.covariance(*names)[-1], e)
    assert 18.0 < nees < 79.0


# --- where points begin -----------------------------------------------------------------


def test_first_sights_are_where_the_sensor_sees_them(problem: Problem) -> None:
    assembly = Assembly.of(problem)
    assert first_epochs(assembly) == {0, 1, 2, 3, 4}
    one = assembly.at(0)
    x, P = problem.prior.x, problem.prior.P
    step = first_sights(one, x, P)
    moving = problem.layout.moving.dim
    assert not step[:moving].any()
    rows = one.measure(problem.layout.retract(x, step)[None], np.ones(one.observations))
    seen = one.rows_of(np.array([one.sensor_names[i] == "points" for i in one.sensor_of]))
    np.testing.assert_allclose(rows.r[seen], 0.0, atol=1e-9)
    # A point that is correlated with the pose has been seen.
    tied = P.copy()
    column = problem.layout.tangent("point[3]").start
    tied[column, 0] = tied[0, column] = 1e-3 * np.sqrt(P[column, column] * P[0, 0])
    assert len(unseen(one, P)) == 10
    assert len(unseen(one, tied)) == 9


class _Lines(PointSight):
    """The same sensor, as if it saw no depth."""

    sees_depth = False

    def sights(self, ids: Indices, z: Array, *x: Array) -> tuple[Array, Array]:
        origins, lines = super().sights(ids, z, *x)
        return origins, lines / np.linalg.norm(lines, axis=1, keepdims=True)


def test_on_a_line_a_point_begins_where_it_is_nearest_to_the_centre(problem: Problem) -> None:
    lines = replace(problem, sensors={**problem.sensors, "points": _Lines()})
    assembly, layout = Assembly.of(lines).at(0), problem.layout
    x = problem.prior.x
    step = first_sights(assembly, x, problem.prior.P)
    R_oc, R_ot, r = (
        layout.value(x, n) for n in ("chaser_attitude", "target_attitude", "relative_position")
    )
    z = next(m.z for m in problem.epochs[0].measurements if m.sensor == "points")
    line = R_ot.T @ R_oc @ z[0]
    point = step[layout.tangent("point[0]")]
    assert abs(point @ line) < 1e-9 * np.linalg.norm(line)
    np.testing.assert_allclose(np.cross(point - R_ot.T @ r, line), 0.0, atol=1e-9)


def test_turns_are_added_up() -> None:
    scenario = load_scenario(ZHANG, ["time.epochs=5"])
    layout = scenario.layout
    x = np.tile(layout.identity, (9, 1))
    for k in range(9):
        c, s = np.cos(0.5 * k), np.sin(0.5 * k)
        x[k, layout.stored("target_attitude")] = [c, -s, 0, s, c, 0, 0, 0, 1]
    np.testing.assert_allclose(turned(layout, x), 0.5 * np.arange(9), atol=1e-12)
    position = Layout([layout.block("relative_position")])
    assert np.isinf(turned(position, np.zeros((4, 3)))).all()  # nothing tells


# --- the update of some blocks ----------------------------------------------------------


@jit(from_python=True)
def _others(own: Indices, d: Array, after: Array, kinds: Indices, x: Array, P: Array) -> bool:
    return update_others(own, d, kinds[:1], after, kinds, x, P)


def test_blocks_that_are_not_read_follow_as_in_one_update() -> None:
    """A Kalman update of four states that reads the first two, whole and in two parts."""
    rng = np.random.default_rng(5)
    A = rng.standard_normal((5, 5))
    P, x, H = A @ A.T, rng.standard_normal(5), np.zeros((3, 5))
    H[:, :2] = rng.standard_normal((3, 2))
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.eye(3))
    z = rng.standard_normal(3)
    whole_x, whole_P = x + K @ (z - H @ x), (np.eye(5) - K @ H) @ P
    kinds = np.array([[0, 0, 0, 2], [0, 2, 2, 3]])
    part_x, part_P = x.copy(), P.copy()
    part_x[:2] = whole_x[:2]
    after = np.ascontiguousarray(whole_P[:2, :2])
    assert _others(np.arange(2), whole_x[:2] - x[:2], after, kinds, part_x, part_P)
    np.testing.assert_allclose(part_x, whole_x, atol=1e-12)
    np.testing.assert_allclose(part_P, whole_P, atol=1e-12)


# --- online -----------------------------------------------------------------------------


def _bare(problem: Problem) -> Problem:
    """The problem as it is before anything was seen."""
    n, size = problem.layout.dim - 3 * POINTS, problem.layout.size - 3 * POINTS
    prior = Prior(problem.prior.x[:size], problem.prior.P[:n, :n])
    return replace(problem, prior=prior, epochs=())


def _same(a: Online, b: Online) -> bool:
    return bool(np.array_equal(a.x, b.x) and np.array_equal(a.P, b.P))


@pytest.mark.parametrize(
    "kind", ["iekf", "iukf", "iekf_batch_start", "incremental", "fixed_lag", "isam2"]
)
def test_points_come_as_they_are_seen(problem: Problem, kind: str) -> None:
    offline, bare = run_estimator(kind, problem), _bare(problem)
    one, resumed, late = online(kind, bare), online(kind, bare), online(kind, bare)
    assert not one.layout.statics
    statuses, held = [], list[Measurement]()
    for k, epoch in enumerate(problem.epochs[:12]):
        statuses.append(one.step(epoch).status)
        if k == 5:
            resumed.restore(one.state())
            points = [m for m in epoch.measurements if m.sensor == "points"]
            held, rest = points, [m for m in epoch.measurements if m.sensor != "points"]
            late.step(replace(epoch, measurements=tuple(rest)))
            continue
        late.step(epoch)
        if k > 5:
            resumed.step(epoch)
    assert one.layout == problem.layout
    assert set(statuses) == {"INITIALISING"}  # four seconds of a slow tumble
    assert offline.statics is not None
    x, layout = np.concatenate([offline.x[11], offline.statics.x[11]]), problem.layout
    sigma = np.sqrt(np.diag(one.P))
    # The spread of sigma points grows with the number of states: offline, points to come count.
    assert np.abs(layout.local(x, one.x) / sigma).max() < (1e-2 if kind == "iukf" else 1e-3)
    assert _same(resumed, one)
    late.insert(held)
    assert np.abs(layout.local(late.x, one.x) / sigma).max() < 1e-4


def test_an_estimator_that_takes_no_new_points_says_so(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    def engine(_: IteratedEkf, problem: Problem) -> Any:
        own = KalmanEngine(problem, 1)
        return SimpleNamespace(
            compact=True, begin=own.begin, advance=own.advance, save=own.save, load=own.load
        )

    monkeypatch.setattr(IteratedEkf, "engine", engine)
    one = online("iekf", _bare(problem))
    with pytest.raises(InputError, match=r"takes no point\[0\], which was not known beforehand"):
        one.step(problem.epochs[0])
    assert one.t is None


def test_points_known_beforehand_need_no_growth(problem: Problem) -> None:
    known = tuple(POINT.numbered(i) for i in range(POINTS))
    one: Any = online("iekf", replace(_bare(problem), known=known))
    assert one.layout == problem.layout
    one.step(problem.epochs[0])
    assert one.layout == problem.layout
