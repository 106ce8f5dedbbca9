"""The unscented filter against the Kalman filter, against a library's, and against the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from independent import filterpy_kalman_apart, filterpy_ukf_apart, vector_models, wide_toy
from passes import (
    EXPERIMENTS,
    beyond_digits,
    differences,
    linear_problem,
    spoilt_toy,
    stored,
    toy_measurements,
    toy_problem,
)
from scipy.special import chdtri
from static_tracks import drifting_pass
from textbook_ukf import TextbookUkf

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.online.driver import online
from relnav_graph.estimators.ukf import IteratedUkf, Ukf
from relnav_graph.maths.losses import Loss
from relnav_graph.maths.sigma_points import weights_of
from relnav_graph.runs.passes import open_pass
from relnav_graph.scenario.build import load_scenario

#: Spreads alpha, beta, kappa of seven states: the default, spherical, one with a negative central
#: weight, and the textbook's.
SPREADS = [(0.3, 2.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, -4.0), (1e-3, 2.0, 0.0)]


@pytest.mark.parametrize("spread", SPREADS)
@pytest.mark.parametrize("kind", [Ukf, IteratedUkf])
def test_on_a_linear_pass_it_is_the_kalman_filter(
    spread: tuple[float, float, float], kind: type[Ukf]
) -> None:
    """Weights of a million leave nine digits of the mean, in sigmas of 0.02 m."""
    problem = linear_problem(0.02)
    estimator = replace(kind(), alpha=spread[0], beta=spread[1], kappa=spread[2])
    ekf, rts, track = run_estimator("ekf", problem), run_estimator("rts", problem), None
    track = estimator.run(problem)
    assert track.status == "ok"
    assert track.smoothed is not None
    for a, b in ((track, ekf), (track.smoothed, rts)):
        np.testing.assert_allclose(a.x, b.x, rtol=1e-9, atol=2e-9)
        np.testing.assert_allclose(a.P, b.P, rtol=1e-9, atol=1e-11)
    for name, found in ekf.innovations.items():
        np.testing.assert_allclose(track.innovations[name].v, found.v, atol=1e-7)


@pytest.mark.parametrize("spread", SPREADS[:3])
def test_it_is_the_textbooks_on_a_nonlinear_pass(spread: tuple[float, float, float]) -> None:
    """With the same points, drawn anew after the prediction, and the same weights."""
    problem = wide_toy()
    track = replace(Ukf(), alpha=spread[0], beta=spread[1], kappa=spread[2]).run(problem)
    ekf = run_estimator("ekf", problem)
    one = TextbookUkf(problem.prior.x, problem.prior.P, *spread)
    apart = 0.0
    for k in range(len(problem.epochs)):
        f, Q, h, z, R = vector_models(problem, k)
        if f is not None:
            one.predict(f, Q)
        one.update(h, z, R)
        sigma = np.sqrt(np.diag(one.P))
        np.testing.assert_allclose(track.x[k], one.x, rtol=0, atol=1e-6 * sigma.min())
        np.testing.assert_allclose(track.P[k], one.P, rtol=1e-6, atol=1e-6 * sigma.min() ** 2)
        apart = max(apart, float((np.abs(ekf.x[k] - one.x) / sigma).max()))
    assert apart > 0.1  # else the pass would be a linear one


def test_it_is_filterpys_on_a_nonlinear_pass() -> None:
    pytest.importorskip("filterpy.kalman", reason="needs the extra dev")
    assert max(filterpy_ukf_apart()) < 1e-6


def test_a_linear_filter_and_smoother_are_filterpys() -> None:
    pytest.importorskip("filterpy.kalman", reason="needs the extra dev")
    assert max(filterpy_kalman_apart()) < 1e-7


def test_weights_are_those_of_the_scaled_transformation() -> None:
    c, w0, v0, w = weights_of(7, 0.5, 2.0, 1.0)
    assert c**2 == pytest.approx(0.25 * 8)
    assert w0 + 14 * w == pytest.approx(1.0)
    assert v0 == pytest.approx(w0 + 1 - 0.25 + 2)
    with pytest.raises(InputError, match=r"found alpha = 1\.0, kappa = -7\.0 for 7 states"):
        Ukf(kappa=-7.0, alpha=1.0).run(toy_problem(toy_measurements()))


RUNS = 8


@pytest.fixture(scope="module")
def nees() -> dict[str, Array]:
    """Of each run and epoch (RUNS, N) over the first epochs of zhang2015_close, every state drawn
    by a prior that leaves the first updates near to linear."""
    scenario = load_scenario(
        EXPERIMENTS / "zhang2015_close.toml",
        [
            "time.epochs=30",
            'prior.target_attitude={sigma="0.2 deg"}',
            'prior.target_rate={sigma="0.1 deg/s", mean="drawn"}',
            'prior.inertia_parameters={sigma=0.05, mean="drawn"}',
        ],
    )
    found: dict[str, list[Array]] = {"ukf": [], "iukf": []}
    for run in range(RUNS):
        recording = scenario.simulate(11, run)
        assert recording.truth is not None
        problem = scenario.problem(recording, 11, run)
        for kind, rows in found.items():
            track = run_estimator(kind, problem)
            e = differences(track.layout, track.x, stored(track.layout, recording.truth))
            rows.append(np.einsum("ki,ki->k", e, np.linalg.solve(track.P, e[..., None])[..., 0]))
    return {kind: np.array(rows) for kind, rows in found.items()}


@pytest.mark.parametrize("kind", ["ukf", "iukf"])
@pytest.mark.parametrize("epoch", [0, 15, 29])
def test_nees_is_chi_square_on_the_close_pass(
    nees: dict[str, Array], kind: str, epoch: int
) -> None:
    """Runs are independent, epochs of one run are not: one epoch of each run is judged."""
    n = RUNS * 20
    assert chdtri(n, 0.999) < nees[kind][:, epoch].sum() < chdtri(n, 0.001)


@pytest.mark.parametrize("kind", ["ukf", "iukf"])
def test_gates_and_losses_are_those_of_the_other_filters(kind: str) -> None:
    spoilt = spoilt_toy()
    for changes in ({"gates": {"fix": 0.999}}, {"losses": {"fix": Loss("cauchy")}}):
        problem = replace(spoilt, **changes)
        track, ekf = run_estimator(kind, problem), run_estimator("iekf", problem)
        assert track.status == "ok"
        assert track.rejected == ekf.rejected
        assert track.downweighted == ekf.downweighted
        sigma = np.sqrt(np.einsum("kii->ki", ekf.P))
        assert (np.abs(track.x - ekf.x) / sigma)[5:].max() < 0.3


@pytest.mark.parametrize("kind", ["ukf", "iukf"])
def test_constants_are_estimated_with_the_rest(kind: str) -> None:
    problem, _ = drifting_pass(epochs=20)
    track, reference = run_estimator(kind, problem), run_estimator("iekf", problem)
    assert track.statics is not None
    assert reference.statics is not None
    for a, b in ((track, reference), (track.statics, reference.statics)):
        sigma = np.sqrt(np.einsum("kii->ki", b.P))
        assert (np.abs(a.x - b.x) / sigma)[10:].max() < 0.3
        np.testing.assert_allclose(a.P[10:], b.P[10:], rtol=0.1, atol=0.01 * np.abs(b.P).max())
    assert track.smoothed is not None
    statics = track.smoothed.statics
    assert statics is not None  # a constant, smoothed, is one
    np.testing.assert_allclose(statics.x, statics.x[-1:].repeat(20, 0), atol=1e-8)


def test_points_that_are_first_seen_are_begun_where_they_are_seen() -> None:
    settings = ["time.epochs=25", "truth.map.count=6"]
    problem = open_pass(EXPERIMENTS / "inspection.toml", 0, assignments=settings).problem
    track = run_estimator("iukf", problem)
    assert track.status != "diverged", track.message
    assert sum(track.rejected.values()) == 0
    assert track.statics is not None
    points = slice(track.statics.layout.dim - 18, None)
    begun, ended = (np.diag(track.statics.P[k])[points] for k in (0, -1))
    assert (ended < 0.1 * begun).all()


@pytest.mark.parametrize("kind", ["ukf", "iukf"])
@pytest.mark.parametrize("changes", [{}, {"gates": {"fix": 0.999}}])
def test_online_is_offline_bit_for_bit_and_goes_on_from_what_was_saved(
    kind: str, changes: dict[str, Any]
) -> None:
    problem = replace(spoilt_toy(), window=5.0, **changes)
    track, one = run_estimator(kind, problem), online(kind, problem)
    for k, epoch in enumerate(problem.epochs):
        if k == 17:
            after = online(kind, problem)
            after.restore(one.state())
            one = after
        one.step(epoch)
        np.testing.assert_array_equal(one.x, track.x[k])
        np.testing.assert_array_equal(one.P, track.P[k])


@pytest.mark.parametrize("kind", ["ukf", "iukf"])
def test_the_root_carries_what_no_covariance_can(kind: str) -> None:
    """A prior of 10 km, fixes of 0.1 mm: a covariance has no digits for both."""
    track = run_estimator(kind, beyond_digits())
    assert track.status == "ok"
    # Fixes at six times, of a line: the variance at its end is (4 n - 2) / (n (n + 1)) of one's.
    np.testing.assert_allclose(np.diag(track.P[-1])[:3], 1e-8 * 22 / 42, rtol=1e-3)
