"""Scores of synthetic tracks whose errors are known, or drawn from known covariances."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import (
    GYRO_BIAS,
    INERTIA,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    TARGET_ATTITUDE,
)
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track, Truth
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.scoring.deviations import chi2_band, nees
from relnav_graph.scoring.metrics import (
    errors,
    estimates,
    improvement,
    require_same_kind,
    score,
    summary,
    table,
)

LAYOUT = Layout([RELATIVE_POSITION, TARGET_ATTITUDE])
DEGREE = np.pi / 180


@dataclass(frozen=True)
class PositionInTarget:
    """``r_t = R_ot^T r_o``; d r_t = [r_t x] d + R_ot^T dr."""

    kind: ClassVar[str] = "toy_position_in_target"
    block: ClassVar[Block] = Block("position_in_target", "r_tc_t", "vector", 3, "m", "t", "m")
    reads: ClassVar[tuple[Block, ...]] = (TARGET_ATTITUDE, RELATIVE_POSITION)

    def value(self, *x: Array) -> tuple[Array, Array]:
        R_ot, r_o = x
        r_t = R_ot.T @ r_o
        return r_t, np.hstack([so3.skew(r_t), R_ot.T])


@dataclass(frozen=True)
class Ratios:
    """Three inertia ratios of two parameters: their covariance has rank 2."""

    kind: ClassVar[str] = "toy_ratios"
    block: ClassVar[Block] = Block("inertia_ratios", "l_t", "vector", 3, "1", "t", "1")
    reads: ClassVar[tuple[Block, ...]] = (INERTIA,)

    def value(self, *x: Array) -> tuple[Array, Array]:
        to_three = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])
        ratios = np.tanh(to_three @ x[0])
        return ratios, (1 - ratios**2)[:, None] * to_three


def covariance(rng: np.random.Generator, sigma: Array) -> Array:
    """A covariance with these standard deviations and strong correlations."""
    root = np.tril(rng.normal(size=(len(sigma), len(sigma)))) + 0.3 * np.eye(len(sigma))
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    P: Array = (root * sigma[:, None]) @ (root * sigma[:, None]).T
    return P


def sampled(
    layout: Layout, x_true: Array, P: Array, n: int, rng: np.random.Generator, **options: Any
) -> tuple[Track, Truth]:
    """n epochs of one true state, each with an error ``local(x_est, x_true)`` drawn from P."""
    d = rng.multivariate_normal(np.zeros(layout.dim), P, size=n, method="cholesky")
    x = np.array([layout.retract(x_true, -e) for e in d])
    t = np.arange(n, dtype=np.float64)
    values = layout.values(np.tile(x_true, (n, 1)))
    options = {"name": "a", "kind": "smoothed"} | options
    return Track(layout=layout, t=t, x=x, P=np.tile(P, (n, 1, 1)), **options), Truth(t, values)


def small(n: int = 20, **options: Any) -> tuple[Track, Truth]:
    """A short track of position and attitude, with its truth."""
    rng = np.random.default_rng(5)
    x_true = LAYOUT.pack(
        {
            "relative_position": [10.0, -40.0, 3.0],
            "target_attitude": so3.exp(np.array([0.4, -1.0, 2.0])),
        }
    )
    P = covariance(rng, np.array([0.1, 0.2, 0.1, 0.01, 0.02, 0.01]))
    return sampled(LAYOUT, x_true, P, n, rng, **options)


def pairs(track: Track, truth: Truth) -> Iterator[tuple[Array, dict[str, Array]]]:
    """Stored estimate and true values of each epoch."""
    for k, x in enumerate(track.x):
        yield x, {name: value[k] for name, value in truth.values.items()}


def test_nees_of_drawn_errors_lies_in_its_band() -> None:
    rng = np.random.default_rng(1)
    P = covariance(rng, np.array([1e3, 1.0, 1e-3, 1e-6, 1e-5]))  # units far apart
    e = rng.multivariate_normal(np.zeros(5), P, size=2000, method="cholesky")
    value, rank = nees(e, np.tile(P, (2000, 1, 1)))
    low, high = chi2_band(5, runs=2000)
    assert (rank == 5).all()
    assert low < np.mean(value / rank) < high
    np.testing.assert_allclose(value[0], e[0] @ np.linalg.solve(P, e[0]), rtol=1e-8)


def test_band_is_the_tabulated_chi_square() -> None:
    assert chi2_band(3) == pytest.approx((0.2158 / 3, 9.3484 / 3), rel=1e-4)
    assert chi2_band(2, runs=50) == pytest.approx((74.222 / 100, 129.561 / 100), rel=1e-5)


def test_nees_is_nan_where_there_is_no_covariance() -> None:
    P = np.stack([np.eye(2), -np.eye(2), np.full((2, 2), np.nan), np.array([[1, 2], [2, 1]])])
    value, _ = nees(np.ones((4, 2)), P)
    assert value[0] == pytest.approx(2)
    assert np.isnan(value[1:]).all()


def test_two_degrees_are_two_degrees() -> None:
    """A rotation angle, not the half angle of the quaternion nor the norm of R - R'."""
    track, truth = small(1)
    R_true = truth.values["target_attitude"][0]
    axis = np.array([1.0, -2.0, 2.0]) / 3
    x = track.x.copy()
    x[0, LAYOUT.stored("target_attitude")] = (R_true @ so3.exp(-2 * DEGREE * axis)).reshape(9)
    off = replace(track, x=x)
    attitude = score(off, truth, []).states["target_attitude"]
    assert attitude.unit == "deg"
    assert attitude.rmse == pytest.approx(2.0, rel=1e-12)
    e = errors(off, truth, [])["target_attitude"].e
    np.testing.assert_allclose(e, [2 * DEGREE * axis], rtol=1e-12)


def test_vector_errors_are_truth_minus_estimate_in_table_units() -> None:
    layout = Layout([GYRO_BIAS])
    per_hour = DEGREE / 3600
    t = np.arange(2.0)
    x = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]) * per_hour
    track = Track("a", "filtered", layout, t, x, np.tile(4 * per_hour**2 * np.eye(3), (2, 1, 1)))
    truth = Truth(t, {"gyro_bias": np.zeros((2, 3))})
    np.testing.assert_array_equal(errors(track, truth, [])["gyro_bias"].e, -x)
    bias = score(track, truth, []).states["gyro_bias"]
    assert bias.unit == "deg/h"
    assert bias.rmse == pytest.approx(5 / np.sqrt(2))  # sqrt(mean |e|^2), over axes a norm
    assert bias.rmse_last == 0
    assert bias.sigma == pytest.approx(2 * np.sqrt(3))
    assert bias.inside_3sigma == 1
    assert bias.anees == pytest.approx(25 / 4 / 3 / 2)


def test_derived_covariance_agrees_with_monte_carlo() -> None:
    n = 3000
    track, truth = small(n)
    found = errors(track, truth, [PositionInTarget()])["position_in_target"]
    empirical = np.cov(found.e.T, bias=True)
    # Relative to the sigmas, an entry of a sample covariance scatters by about sqrt(2 / n).
    sigma = np.sqrt(np.diag(found.P[0]))
    assert np.abs((empirical - found.P[0]) / np.outer(sigma, sigma)).max() < 5 * np.sqrt(2 / n)
    anees = score(track, truth, [PositionInTarget()]).states["position_in_target"].anees
    low, high = chi2_band(3, runs=n)
    assert anees is not None
    # Twice the band: the linearisation error of 0.02 rad at 40 m adds to the scatter.
    assert 1 - 2 * (1 - low) < anees < 1 + 2 * (high - 1)


def test_rank_deficient_ratios_count_their_two_freedoms() -> None:
    rng = np.random.default_rng(3)
    P = covariance(rng, np.array([1e-4, 3e-4]))
    track, truth = sampled(Layout([INERTIA]), np.array([0.3, -0.5]), P, 50, rng)
    result = score(track, truth, [Ratios()])
    ratios, parameters = result.states["inertia_ratios"], result.states["inertia_parameters"]
    assert ratios.anees_band == parameters.anees_band == chi2_band(2)
    assert ratios.anees == pytest.approx(parameters.anees, rel=1e-2)


def test_joint_anees_uses_the_correlation_between_blocks() -> None:
    n = 500
    track, truth = small(n)
    result = score(track, truth, [])
    low, high = chi2_band(6, runs=n)
    assert result.anees is not None
    assert low < result.anees < high
    assert result.anees_band == chi2_band(6)
    e = np.array([LAYOUT.local(x, LAYOUT.pack(true)) for x, true in pairs(track, truth)])
    direct = np.einsum("ki,ij,kj->k", e, np.linalg.inv(track.P[0]), e)
    assert result.anees == pytest.approx(direct.mean() / 6, rel=1e-8)


def test_joint_anees_is_of_the_blocks_that_truth_knows() -> None:
    track, truth = small()
    only = Truth(truth.t, {"relative_position": truth.values["relative_position"]})
    result = score(track, only, [])
    assert result.anees == result.states["relative_position"].anees
    assert result.anees_band == chi2_band(3)


def test_truth_of_a_derived_quantity_may_be_given() -> None:
    track, truth = small()
    given = Truth(truth.t, {"position_in_target": np.zeros((20, 3))})
    found = errors(track, given, [PositionInTarget()])
    estimate = estimates(track, [PositionInTarget()])["position_in_target"]
    assert list(found) == ["position_in_target"]
    np.testing.assert_array_equal(found["position_in_target"].e, -estimate.value)


def test_derived_needs_its_very_blocks() -> None:
    """A position in another frame bears the same name and must not be taken for it."""
    layout = Layout([RELATIVE_POSITION_T, TARGET_ATTITUDE])
    track, truth = small()
    assert "position_in_target" not in errors(
        replace(track, layout=layout), truth, [PositionInTarget()]
    )


def test_evaluate_restricts_every_number() -> None:
    track, truth = small(101)
    x, P = track.x.copy(), track.P.copy()
    outside = np.r_[0:25, 76:101]
    x[outside, :3] += 1e3
    P[outside] *= 1e6
    off = replace(track, x=x, P=P)
    window = score(off, truth, [], evaluate=(0.25, 0.75)).states["relative_position"]
    kept = slice(25, 76)
    e = truth.values["relative_position"][kept] - track.x[kept, :3]
    assert window.rmse == pytest.approx(np.sqrt((e**2).sum(axis=1).mean()))
    assert window.rmse_last == pytest.approx(np.linalg.norm(e[-1]))
    assert window.sigma == pytest.approx(np.sqrt(np.trace(track.P[0, :3, :3])))
    np.testing.assert_array_equal(window.t, track.t[kept])
    with pytest.raises(InputError, match="evaluate"):
        score(track, truth, [], evaluate=(0.5, 0.5))
    with pytest.raises(InputError, match="evaluate"):
        score(track, truth, [], evaluate=(0.501, 0.502))


def test_unknown_epochs_of_truth_are_left_out() -> None:
    track, truth = small()
    values = {name: value.copy() for name, value in truth.values.items()}
    values["relative_position"][[3, 19]] = np.nan
    gaps = Truth(truth.t, values)
    found = errors(track, gaps, [PositionInTarget()])
    assert len(found["target_attitude"].t) == 20
    for name in ("relative_position", "position_in_target"):
        np.testing.assert_array_equal(found[name].t, np.delete(track.t, [3, 19]))
    result = score(track, gaps, [])
    assert result.states["relative_position"].rmse_last == pytest.approx(
        np.linalg.norm(found["relative_position"].e[-1])
    )
    assert result.anees is not None


def test_truth_is_matched_by_time() -> None:
    track, truth = small()
    dense = Truth(
        np.arange(-5, 60) / 2 + 4e-7,
        {"relative_position": np.outer(np.arange(-5, 60) / 2, np.ones(3))},
    )
    e = errors(track, dense, [])["relative_position"].e
    np.testing.assert_allclose(e, track.t[:, None] - track.x[:, :3])
    late = Truth(truth.t[1:], {name: value[1:] for name, value in truth.values.items()})
    with pytest.raises(InputError, match=r"no epoch at 0\.0 s"):
        errors(track, late, [])
    with pytest.raises(InputError, match="no epoch"):
        errors(track, Truth(truth.t + 2e-6, truth.values), [])
    with pytest.raises(InputError, match="no epoch"):
        errors(track, Truth(np.zeros(0), {"relative_position": np.zeros((0, 3))}), [])


def test_truth_of_a_wrong_shape_is_refused() -> None:
    track, truth = small()
    with pytest.raises(InputError, match="target_attitude"):
        errors(track, Truth(truth.t, {"target_attitude": np.zeros((20, 4))}), [])
    with pytest.raises(InputError, match="3 values at 20 times"):
        errors(track, Truth(truth.t, {"relative_position": np.zeros((3, 3))}), [])


def test_kinds_are_never_mixed() -> None:
    track, _ = small()
    assert require_same_kind([track, track]) == "smoothed"
    with pytest.raises(InputError, match="b is filtered"):
        require_same_kind([track, replace(track, name="b", kind="filtered")])
    with pytest.raises(InputError, match="none"):
        require_same_kind([])


def test_improvement_wants_the_same_epochs() -> None:
    track, truth = small()
    half = truth.values["relative_position"] + track.x[:, :3]
    better = replace(track, x=np.hstack([half / 2, track.x[:, 3:]]))
    a, b = score(track, truth, []), score(better, truth, [])
    assert improvement(a, b, "relative_position") == pytest.approx(0.5)
    with pytest.raises(InputError, match="different epochs"):
        improvement(a, score(better, truth, [], evaluate=(0.5, 1.0)), "relative_position")
    with pytest.raises(InputError, match="no state 'speed'"):
        improvement(a, b, "speed")


def test_summary_is_strict_json_in_the_documented_form() -> None:
    track, truth = small()
    online = replace(
        track,
        name="incremental",
        kind="filtered",
        step_s=np.concatenate([np.full(10, 1e-3), np.full(10, 3e-3)]),
        runtime_s=0.5,
        rejected={"beacons": 3},
        smoothed=replace(track, name="whatever"),
    )
    result = summary("toy", 7, [online], truth, [PositionInTarget()], None, 20)
    assert result["schema"] == 1
    assert (result["scenario"], result["seed"], result["epochs"]) == ("toy", 7, 20)
    assert set(result["versions"]) == {"relnav-graph", "gtsam", "numpy", "numba", "python"}
    assert list(result["estimators"]) == ["incremental", "incremental_smoothed"]
    read = json.loads(json.dumps(result, allow_nan=False))["estimators"]
    assert read["incremental"]["kind"] == "filtered"
    assert read["incremental_smoothed"]["kind"] == "smoothed"
    assert "step_ms" not in read["incremental_smoothed"]
    assert read["incremental"]["rejected"] == {"beacons": 3}
    assert read["incremental"]["step_ms"] == pytest.approx(
        {"median": 2.0, "p99": 3.0, "first_tenth_median": 1.0, "last_tenth_median": 3.0}
    )
    assert set(read["incremental"]["states"]) == {
        "relative_position",
        "target_attitude",
        "position_in_target",
    }
    assert set(read["incremental"]["states"]["relative_position"]) == {
        "unit",
        "rmse",
        "rmse_last",
        "sigma",
        "anees",
        "anees_band",
        "inside_3sigma",
    }


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_diverged_track_gives_null(value: float) -> None:
    track, truth = small()
    x, P = track.x.copy(), track.P.copy()
    x[10:], P[10:] = value, value
    lost = replace(track, x=x, P=P, status="diverged", message="the covariance is not finite")
    result = summary("toy", 0, [lost], truth, [PositionInTarget()], None, 20)
    json.dumps(result, allow_nan=False)
    row = result["estimators"]["a"]
    assert row["status"] == "diverged"
    assert row["states"]["relative_position"]["rmse"] is None
    if not np.isfinite(value):
        assert row["anees"] is None
        assert row["states"]["relative_position"]["anees"] is None
        assert row["states"]["relative_position"]["inside_3sigma"] is None
    assert "the covariance is not finite" in table(result)
    assert improvement(score(track, truth, []), score(lost, truth, []), "relative_position") is None


def test_without_truth_there_is_sigma_alone() -> None:
    track, truth = small()
    known = summary("toy", 0, [track], truth, [PositionInTarget()], None, 20)
    blind = summary("toy", None, [track], None, [PositionInTarget()], None, 20)
    json.dumps(blind, allow_nan=False)
    row = blind["estimators"]["a"]
    assert row["anees"] is None
    assert "relative_position [m]: estimate at t = " in table(blind)
    for name, state in row["states"].items():
        expected = known["estimators"]["a"]["states"][name]["sigma"]
        last = state.pop("estimate")
        assert state == {"unit": state["unit"], "sigma": expected}
        assert (last["t"], len(last["sigma"])) == (track.t[-1], 3)


def test_table_fits_a_terminal() -> None:
    track, truth = small()
    ekf = replace(track, name="ekf", kind="filtered", rejected={"beacons": 3})
    lag = replace(ekf, name="fixed_lag", smoothed=replace(track, kind="fixed-lag"))
    text = table(summary("toy", 0, [ekf, lag, track], truth, [PositionInTarget()], None, 20))
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    for expected in ("toy: 20 epochs, seed 0", "target_attitude [deg]", "beacons 3"):
        assert expected in text
    blocks = [k for k, line in enumerate(lines) if line.endswith("]")]
    assert len(blocks) == 3
    # Columns stand one below the other through all blocks.
    assert len({lines[k + 1] for k in blocks}) == 1
    assert {len(line) for k in blocks for line in lines[k + 1 : k + 6]} == {
        len(lines[blocks[0] + 1])
    }
