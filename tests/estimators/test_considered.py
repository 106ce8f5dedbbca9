"""Blocks that are counted and not estimated (Schmidt): held where they were, with their uncertainty
in the covariance of all others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from passes import EXPERIMENTS

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.online.driver import Online
from relnav_graph.linear.assembly import Assembly
from relnav_graph.runs.graph import to_gtsam
from relnav_graph.runs.passes import open_pass
from relnav_graph.scoring.agreement import distances, row_cautions
from relnav_graph.scoring.metrics import score

MOUNTING = ("camera_misalignment", "camera_displacement")


def mounted(run: int = 0, epochs: int = 40, considered: tuple[str, ...] = MOUNTING) -> Problem:
    """A camera that is mounted a little off, with a narrow prior: nearly linear."""
    sets = [f"prior.{name}.considered=true" for name in considered]
    opened = open_pass(
        EXPERIMENTS / "mounting.toml", 0, assignments=[f"time.epochs={epochs}", *sets], run=run
    )
    return opened.problem


def joint(track: Track) -> Array:
    """Covariances (N, n + m, n + m) of all blocks."""
    return track.covariance(*(b.name for b in track.blocks))


def test_one_update_is_schmidts() -> None:
    problem = mounted(epochs=2)
    layout, columns = problem.layout, problem.considered_columns
    track = run_estimator("ekf", problem)
    x, P = problem.prior.x, problem.prior.P
    assembly = Assembly.of(problem).at(0)
    rows = assembly.measure(x[None], np.ones(assembly.observations))
    # Schmidt 1966, as Woodbury and Junkins 2010 write it, with R = I.
    K = P @ rows.H.T @ np.linalg.inv(rows.H @ P @ rows.H.T + np.eye(len(rows.r)))
    K[columns] = 0.0
    left = np.eye(layout.dim) - K @ rows.H
    expected = left @ P @ left.T + K @ K.T
    moved = layout.local(x, track.states[0])
    sigma = np.sqrt(np.diag(P))
    assert np.abs((moved + K @ rows.r) / sigma).max() < 1e-9
    J = np.linalg.inv(layout.right_jacobian_inverse(moved))  # to the tangent of the new state
    scale = np.sqrt(np.diag(expected))
    difference = (joint(track)[0] - J @ expected @ J.T) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-6


@pytest.mark.parametrize("kind", ["batch", "isam2"])
def test_the_covariance_is_that_of_an_estimate_that_holds_the_block(kind: str) -> None:
    """P_x|p of the block held, S = dx/dp by moving where it is held."""
    problem = mounted(epochs=15)
    layout, columns = problem.layout, problem.considered_columns
    made = run_estimator(kind, problem)
    track = made.smoothed or made

    def held_at(step: Array) -> Track:
        """By a prior so narrow that nothing moves the block."""
        P = problem.prior.P.copy()
        P[columns, columns] *= 1e-12
        prior = Prior(layout.retract(problem.prior.x, step), P)
        return run_estimator("batch", replace(problem, prior=prior, considered=()))

    centre = held_at(np.zeros(layout.dim))
    sigma = np.sqrt(np.diag(problem.prior.P))
    S = np.empty((len(problem.epochs), layout.dim, len(columns)))
    for i, column in enumerate(columns):
        step = np.zeros(layout.dim)
        step[column] = 0.1 * sigma[column]
        ahead, back = held_at(step), held_at(-step)
        for k in range(len(S)):
            difference = layout.local(back.states[k], ahead.states[k])
            S[k, :, i] = difference / (2 * step[column])
    P_p = problem.prior.P[np.ix_(columns, columns)]
    expected = joint(centre) + S @ P_p @ S.transpose(0, 2, 1)
    scale = np.sqrt(np.einsum("kii->ki", expected))
    difference = (joint(track) - expected) / (scale[:, :, None] * scale[:, None, :])
    # The smoothers' S leaves out how residuals bend the cost (Gauss-Newton).
    assert np.abs(difference).max() < 1e-2
    assert (
        np.abs(layout.local(problem.prior.x, track.states[-1])[columns] / sigma[columns]).max()
        < 1e-4
    )


def test_consider_covariances_hold_over_many_passes() -> None:
    """Considered, the error is what the covariance says; taken for known, it is far more."""
    anees: dict[str, list[float]] = {"ekf": [], "batch": [], "ignored": []}
    # Else known so well that the filter, too, bends little.
    sets = [
        "time.epochs=40",
        'prior.target_attitude.sigma="0.5 deg"',
        'prior.target_rate.sigma="0.02 deg/s"',
        "prior.inertia_matrix_parameters.sigma=0.01",
        *(f"prior.{name}.considered=true" for name in MOUNTING),
    ]
    for run in range(20):
        opened = open_pass(EXPERIMENTS / "mounting.toml", 5, assignments=sets, run=run)
        problem, truth = opened.problem, opened.recording.truth
        assert truth is not None
        P = problem.prior.P.copy()
        P[problem.considered_columns, problem.considered_columns] *= 1e-8
        ignoring = replace(problem, considered=(), prior=Prior(problem.prior.x, P))
        for name, track in (
            ("ekf", run_estimator("ekf", problem)),
            ("batch", run_estimator("batch", problem)),
            ("ignored", run_estimator("batch", ignoring)),
        ):
            found = score(track, truth, ()).anees
            assert found is not None
            anees[name].append(found)
    # Six numbers are drawn for each pass that all its errors hang on: the mean over the passes is
    # that of 120 squares, and has a sigma of 0.13.
    assert 0.6 < np.mean(anees["ekf"]) < 1.6
    assert 0.6 < np.mean(anees["batch"]) < 1.4
    assert np.mean(anees["ignored"]) > 1000.0


def test_estimates_that_consider_are_not_called_overconfident() -> None:
    """What is considered draws each of them in a way of its own, which the covariance of the other
    does not bound; their own covariances are true all the same."""
    sets = ["time.epochs=300", *(f"prior.{name}.considered=true" for name in MOUNTING)]
    opened = open_pass(EXPERIMENTS / "mounting.toml", 0, assignments=sets)
    rows = {kind: run_estimator(kind, opened.problem) for kind in ("batch", "isam2")}
    references, apart = distances(rows)
    assert apart["isam2"] is not None
    assert apart["isam2"] < 1
    cautions = row_cautions(rows, references, apart)["isam2"]
    assert [caution.name for caution in cautions] == ["consider-covariance"]
    assert opened.recording.truth is not None
    anees = score(rows["isam2"], opened.recording.truth, ()).anees
    assert anees is not None
    assert anees < 2


def test_a_block_that_moves_is_considered_by_the_filter() -> None:
    """The gyro's bias: it stays where its process takes it, and its covariance only grows."""
    sets = ["time.epochs=60", "prior.gyro_bias.considered=true"]
    problem = open_pass(EXPERIMENTS / "zhang2015_close.toml", 0, assignments=sets).problem
    own = run_estimator("ekf", problem)
    every = run_estimator("ekf", replace(problem, considered=()))
    bias, P = own.value("gyro_bias"), own.covariance("gyro_bias")
    assert np.ptp(bias, axis=0).max() == 0.0
    assert (np.diff(np.einsum("kii->ki", P), axis=0) >= 0).all()
    assert np.ptp(every.value("gyro_bias"), axis=0).max() > 0
    # Not to estimate it costs: no state is known better for it.
    ratio = np.einsum("kii->ki", own.P[-1:]) / np.einsum("kii->ki", every.P[-1:])
    assert ratio.min() > 1 - 1e-2


@pytest.mark.parametrize("kind", ["iekf", "rts", "incremental", "fixed_lag", "ekf_batch_start"])
def test_who_cannot_consider_says_so(kind: str) -> None:
    with pytest.raises(InputError, match=r"considered: found camera_misalignment.*ekf considers"):
        run_estimator(kind, mounted(epochs=5))


def test_what_cannot_be_considered_is_refused() -> None:
    sets = ["time.epochs=5", "prior.gyro_bias.considered=true"]
    moving = open_pass(EXPERIMENTS / "zhang2015_close.toml", 0, assignments=sets).problem
    for kind in ("batch", "isam2"):
        with pytest.raises(InputError, match=r"gyro_bias.*static blocks for " + kind):
            run_estimator(kind, moving)
    with pytest.raises(InputError, match="expected none for a GTSAM graph"):
        to_gtsam(moving, np.tile(moving.prior.x, (5, 1)))
    with pytest.raises(InputError, match=r"considered: found 'wind', expected blocks of the state"):
        replace(moving, considered=("wind",))
    with pytest.raises(InputError, match="every block"):
        replace(moving, considered=tuple(b.name for b in moving.layout))


def test_online_as_after_the_pass() -> None:
    problem = mounted(epochs=12)
    after = run_estimator("ekf", problem)
    online = Online(problem, "ekf")
    for epoch in problem.epochs:
        online.step(epoch)
    assert (online.x == after.states[-1]).all()
    with pytest.raises(InputError, match="considered"):
        Online(problem, "isam2")
