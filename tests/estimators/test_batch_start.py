"""Filters that are begun from a batch: what they start from, and what they know when."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from passes import EXPERIMENTS, ZHANG, linear_problem, sigmas, spoilt_toy, toy_problem
from static_tracks import drifting_pass

from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.batch_start import EkfBatchStart
from relnav_graph.estimators.online.driver import online
from relnav_graph.runs.passes import open_pass

SPAN = 30
SETTINGS = ["time.epochs=51", "truth.map.count=12", f'online.window="{SPAN} s"']


@pytest.fixture(scope="module")
def problem() -> Problem:
    """An unknown map, of which some points are first seen after the batch."""
    return open_pass(EXPERIMENTS / "inspection.toml", 0, assignments=SETTINGS).problem


@pytest.fixture(scope="module")
def track(problem: Problem) -> Track:
    return run_estimator("ekf_batch_start", problem)


def first(problem: Problem, count: int) -> Problem:
    """Its first epochs, with all its blocks."""
    known = tuple(b for b in problem.layout if b.number is not None)
    return replace(problem, epochs=problem.epochs[:count], known=known)


def same(a: Track, b: Track, rows: slice, of_b: slice, tolerance: float = 1e-6) -> None:
    """The same states and covariances, static ones and those of both included."""
    assert a.layout == b.layout
    assert a.statics is not None
    assert b.statics is not None
    assert a.statics.layout == b.statics.layout
    for p, q in ((a.P, b.P), (a.statics.P, b.statics.P), (a.statics.cross, b.statics.cross)):
        scale = np.abs(q[of_b]).max(axis=(1, 2), keepdims=True)
        assert (np.abs(p[rows] - q[of_b]) < tolerance * scale).all()
    d = np.abs(a.layout.local(b.x[of_b], a.x[rows])) / sigmas(b.P[of_b])
    assert d.max() < 10 * tolerance


def test_at_the_end_of_the_span_stands_the_batch(problem: Problem, track: Track) -> None:
    batch = run_estimator("batch", first(problem, SPAN + 1))
    # The batch takes a last step more, of less than a thousandth of a sigma.
    same(track, batch, slice(SPAN, SPAN + 1), slice(-1, None), 1e-3)
    assert track.status == "ok"
    assert len(track.step_s if track.step_s is not None else ()) == len(problem.epochs)
    assert {float(v.t.min()) for v in track.innovations.values()} >= {SPAN + 1.0}
    assert min(v.t.min() for v in track.innovations.values()) > SPAN


def test_no_row_knows_of_later_epochs(problem: Problem, track: Track) -> None:
    for count in (SPAN + 1, 40):
        part = run_estimator("ekf_batch_start", first(problem, count))
        same(track, part, slice(count), slice(count))


def test_before_the_end_of_the_span_it_is_incremental(problem: Problem, track: Track) -> None:
    incremental = run_estimator("incremental", problem)
    same(track, incremental, slice(0, SPAN), slice(0, SPAN))


def test_a_linear_pass_is_filtered_as_by_the_filter_whatever_the_span() -> None:
    problem = linear_problem(0.02)
    ekf = run_estimator("ekf", problem)
    for span in (0.0, 10.0, 1e6):
        track = EkfBatchStart(span=span).run(problem)
        np.testing.assert_allclose(track.x, ekf.x, rtol=0, atol=1e-6 * sigmas(ekf.P).min())
        np.testing.assert_allclose(track.P, ekf.P, rtol=1e-6, atol=1e-12)


def test_what_a_gate_left_out_is_counted_in_batch_and_filter() -> None:
    """A fix in six is far out, before the end of the span and after it."""
    problem = replace(spoilt_toy(), gates={"fix": 0.999}, window=15.0)
    track = run_estimator("iekf_batch_start", problem)
    assert track.status == "ok"
    assert track.rejected["fix"] == 5
    assert track.rejected["ranger"] == 0


def test_a_pass_without_measurements_is_degraded() -> None:
    problem = toy_problem([])
    track = run_estimator("ekf_batch_start", problem)
    assert track.status == "degraded"
    assert track.message == "not one observation was used"


def test_within_the_span_it_is_smoothed_as_by_the_batch(problem: Problem) -> None:
    """Constants and points included."""
    short = first(problem, SPAN - 5)
    track, batch = run_estimator("ekf_batch_start", short), run_estimator("batch", short)
    assert track.smoothed is not None
    assert (track.smoothed.status, track.smoothed.kind) == ("ok", "smoothed")
    same(track.smoothed, batch, slice(None), slice(None), 1e-3)


def test_constants_are_smoothed_with_the_rest() -> None:
    """Ranges are nearly linear: the filter, begun well, is hardly off."""
    problem, _ = drifting_pass()
    track, batch = EkfBatchStart(span=10.0).run(problem), run_estimator("batch", problem)
    assert track.smoothed is not None
    assert track.smoothed.statics is not None
    assert not track.smoothed.innovations
    same(track.smoothed, batch, slice(None), slice(None), 0.01)
    constant = track.smoothed.statics
    np.testing.assert_allclose(constant.x, constant.x[-1:].repeat(len(constant.x), 0), atol=1e-8)


def test_smoothed_it_is_the_batch_on_the_close_pass_within_a_twentieth_of_a_sigma() -> None:
    scenario = ZHANG.with_name("zhang2015_close.toml")
    problem = open_pass(scenario, 0, assignments=["time.epochs=150"]).problem
    track, batch = run_estimator("iekf_batch_start", problem), run_estimator("batch", problem)
    assert track.smoothed is not None
    d = np.abs(track.layout.local(batch.x, track.smoothed.x)) / sigmas(batch.P)
    assert d.max() < 0.05
    ratio = sigmas(track.smoothed.P) / sigmas(batch.P)
    assert np.abs(ratio - 1).max() < 0.01


@pytest.mark.parametrize("span", [0.0, 10.0, 1e6])
def test_a_linear_pass_is_smoothed_as_by_the_batch_whatever_the_span(span: float) -> None:
    problem = linear_problem(0.02)
    batch, track = run_estimator("batch", problem), EkfBatchStart(span=span).run(problem)
    assert track.smoothed is not None
    np.testing.assert_allclose(track.smoothed.x, batch.x, rtol=0, atol=1e-8)
    np.testing.assert_allclose(track.smoothed.P, batch.P, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("window", [7.0, 7.4, 50.0])
@pytest.mark.parametrize("saved", [4, 15])
def test_online_is_offline_bit_for_bit_and_goes_on_from_what_was_saved(
    window: float, saved: int
) -> None:
    """With an epoch at the end of the span, with none there, and in a pass that is shorter; saved
    within the span, and after it."""
    problem = replace(spoilt_toy(), gates={"fix": 0.999}, window=window)
    track, one = run_estimator("iekf_batch_start", problem), online("iekf_batch_start", problem)
    for k, epoch in enumerate(problem.epochs):
        if k == saved:
            after = online("iekf_batch_start", problem)
            after.restore(one.state())
            one = after
        one.step(epoch)
        np.testing.assert_array_equal(one.x, track.x[k])
        np.testing.assert_array_equal(one.P, track.P[k])
