"""Where theory says that estimators agree on a linear pass, they do: with each other, with
a textbook Kalman filter and with dense least squares."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from passes import ESTIMATORS, LINEAR_PRIOR, R_FIX, linear_problem, sigmas

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators import run_estimator


def _model(dt: float, q: float) -> tuple[Array, Array]:
    """Transition and noise of a velocity that walks at random, by Kronecker products."""
    F = np.asarray(np.kron(np.array([[1.0, dt], [0.0, 1.0]]), np.eye(3)), dtype=np.float64)
    walk = q**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return F, np.asarray(np.kron(walk, np.eye(3)), dtype=np.float64)


def _textbook_filter(problem: Problem, q: float) -> tuple[Array, Array]:
    """Kalman 1960, one fix after the other."""
    x, P = LINEAR_PRIOR.x, LINEAR_PRIOR.P
    H, xs, Ps = np.eye(3, 6), [], []
    for k, epoch in enumerate(problem.epochs):
        if k:
            F, Q = _model(epoch.t - problem.epochs[k - 1].t, q)
            x, P = F @ x, F @ P @ F.T + Q
        for z in [z for m in epoch.measurements for z in m.z]:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R_FIX)
            x, P = x + K @ (z - H @ x), (np.eye(6) - K @ H) @ P
        xs.append(x)
        Ps.append(P)
    return np.array(xs), np.array(Ps)


def _dense_least_squares(problem: Problem, q: float) -> tuple[Array, Array]:
    """The whole pass as one least-squares problem, by the QR decomposition of NumPy."""
    count = len(problem.epochs)
    rows, rhs = [], []

    def add(parts: dict[int, Array], value: Array, covariance: Array) -> None:
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        row = np.zeros((len(value), 6 * count))
        for k, A in parts.items():
            row[:, 6 * k : 6 * k + 6] = whiten @ A
        rows.append(row)
        rhs.append(whiten @ value)

    add({0: np.eye(6)}, LINEAR_PRIOR.x, LINEAR_PRIOR.P)
    for k, (a, b) in enumerate(pairwise(problem.epochs)):
        F, Q = _model(b.t - a.t, q)
        add({k: -F, k + 1: np.eye(6)}, np.zeros(6), Q)
    for k, epoch in enumerate(problem.epochs):
        for z in [z for m in epoch.measurements for z in m.z]:
            add({k: np.eye(3, 6)}, z, R_FIX)
    q_factor, r_factor = np.linalg.qr(np.concatenate(rows))
    inverse = np.linalg.inv(r_factor)
    x = inverse @ (q_factor.T @ np.concatenate(rhs))
    P = inverse @ inverse.T
    blocks = [P[i : i + 6, i : i + 6] for i in range(0, 6 * count, 6)]
    return x.reshape(count, 6), np.array(blocks)


def _assert_same(found: Track, x: Array, P: Array, tolerance: float) -> None:
    """Means and covariances, relative to sigma."""
    sigma = sigmas(P)
    assert np.abs((found.x - x) / sigma).max() < tolerance
    scale = sigma[:, :, None] * sigma[:, None, :]
    assert np.abs((found.P - P) / scale).max() < tolerance


@pytest.fixture(scope="module")
def linear_tracks() -> tuple[Problem, dict[str, Track]]:
    problem = linear_problem(0.02)
    return problem, {kind: run_estimator(kind, problem) for kind in ESTIMATORS}


@pytest.mark.parametrize("kind", ["ekf", "iekf", "incremental"])
def test_linear_filters_equal_the_textbook(
    linear_tracks: tuple[Problem, dict[str, Track]], kind: str
) -> None:
    problem, tracks = linear_tracks
    _assert_same(tracks[kind], *_textbook_filter(problem, 0.02), 1e-9)


@pytest.mark.parametrize("kind", ["rts", "batch", "incremental_smoothed"])
def test_linear_smoothers_equal_dense_least_squares(
    linear_tracks: tuple[Problem, dict[str, Track]], kind: str
) -> None:
    problem, tracks = linear_tracks
    track = tracks[kind] if kind in tracks else tracks["incremental"].smoothed
    assert track is not None
    assert track.kind == "smoothed"
    _assert_same(track, *_dense_least_squares(problem, 0.02), 1e-9)


def test_smoother_ends_where_the_filter_ends(
    linear_tracks: tuple[Problem, dict[str, Track]],
) -> None:
    _, tracks = linear_tracks
    batch, ekf = tracks["batch"], tracks["ekf"]
    sigma = np.sqrt(np.diag(ekf.P[-1]))
    assert np.abs((batch.x[-1] - ekf.x[-1]) / sigma).max() < 1e-9
    assert np.abs((batch.P[-1] - ekf.P[-1]) / np.outer(sigma, sigma)).max() < 1e-9


@pytest.mark.parametrize("ratio", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_tiny_process_noise_keeps_graphs_and_filters_together(ratio: float) -> None:
    """ratio: of the velocity's noise in one second to its prior sigma, 0.1 m/s."""
    problem = linear_problem(0.1 * ratio, seed=3)
    ekf, rts, batch, incremental = (
        run_estimator(k, problem) for k in ("ekf", "rts", "batch", "incremental")
    )
    assert incremental.smoothed is not None
    for found, reference in ((batch, rts), (incremental.smoothed, rts), (incremental, ekf)):
        sigma = sigmas(reference.P)
        np.testing.assert_allclose(sigmas(found.P), sigma, rtol=1e-3)
        assert np.abs((found.x - reference.x) / sigma).max() < 1e-3
    if ratio <= 1e-8:  # what is left is the fit of a straight line through all fixes
        information = np.linalg.inv(LINEAR_PRIOR.P)
        right = information @ LINEAR_PRIOR.x
        for epoch in problem.epochs:
            H = np.kron([1.0, epoch.t], np.eye(3))
            for z in [z for m in epoch.measurements for z in m.z]:
                information = information + H.T @ np.linalg.solve(R_FIX, H)
                right = right + H.T @ np.linalg.solve(R_FIX, z)
        P = np.linalg.inv(information)
        sigma = np.sqrt(np.diag(P))
        np.testing.assert_allclose(np.sqrt(np.diag(rts.P[0])), sigma, rtol=1e-3)
        assert np.abs((rts.x[0] - P @ right) / sigma).max() < 1e-3
