"""Odometry between epochs, on a pose that is cloned into the state."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from passes import differences, sigmas, stored
from passes_odometry import ODOMETRY, odometry_scenario
from scipy.special import chdtri

from relnav_graph.arrays import Array
from relnav_graph.core.track import Track
from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.scenario import Scenario


@cache
def plain(kind: str, number: int = 0, period: float | None = None) -> tuple[Track, Array]:
    """Of the pass as it stands."""
    return run(odometry_scenario(period=period), kind, number)


def run(scenario: Scenario, kind: str, number: int = 0) -> tuple[Track, Array]:
    """A track and its errors (N, dim)."""
    recording = scenario.simulate(3, number)
    assert recording.truth is not None
    track = run_estimator(kind, scenario.problem(recording, 3, number))
    return track, differences(track.layout, track.x, stored(track.layout, recording.truth))


COPIED = ("chaser_attitude", "target_attitude", "relative_position")


@pytest.mark.parametrize("name", COPIED)
def test_clone_is_the_smoothed_pose_of_the_epoch_before(name: str) -> None:
    track, _ = plain("batch")
    copies, originals = track.value(f"previous_{name}")[1:], track.value(name)[:-1]
    np.testing.assert_allclose(copies, originals, atol=1e-6)


@pytest.mark.parametrize("name", COPIED)
def test_slow_odometry_holds_its_clone_between(name: str) -> None:
    """Odometry every 4 s in a pass of 1 s: the clone is that of its last multiple."""
    track, _ = plain("batch", period=4.0)
    for k in range(1, 60):
        copy, original = track.value(f"previous_{name}")[k], track.value(name)[(k - 1) // 4 * 4]
        np.testing.assert_allclose(copy, original, atol=1e-5)


@pytest.mark.parametrize("kind", ["ekf", "iekf"])
def test_filter_ends_where_the_graph_does(kind: str) -> None:
    """The clone does not mislead a filter, however often it iterates an update."""
    (track, _), (batch, _) = plain(kind), plain("batch")
    own = slice(0, track.layout.tangent("previous_chaser_attitude").start)
    apart = differences(track.layout, batch.x, track.x)[-1] / sigmas(batch.P)[-1]
    assert np.abs(apart[own]).max() < 1  # 6.5 with a clone in other coordinates


@pytest.mark.parametrize("period", [None, 4.0])
@pytest.mark.parametrize("kind", ["iekf", "batch"])
def test_errors_are_as_large_as_the_covariance_says(kind: str, period: float | None) -> None:
    """With a star tracker beside it, at other times, and every run of its own."""
    total, n = 0.0, 0
    for number in range(8):
        track, e = plain(kind, number, period)
        own = np.arange(track.layout.tangent("previous_chaser_attitude").start)
        P = track.P[40][np.ix_(own, own)]
        total += e[40, own] @ np.linalg.solve(P, e[40, own])
        n += len(own)
    assert chdtri(n, 0.9995) < total < chdtri(n, 0.0005)


def test_odometry_gives_the_rate_of_the_tumble() -> None:
    """0.6 deg a second, eighty times: the smoothed rate is known to a few hundredths."""
    track, e = plain("batch")
    rows = track.layout.tangent("target_rate")
    assert np.degrees(np.sqrt((e[:, rows] ** 2).sum(axis=1).mean())) < 0.6
    assert np.degrees(sigmas(track.P)[0, rows]).max() < 0.3
    # Alone, without what the odometry tells, it would be the prior's.
    blind: dict[str, Any] = {"stars": ODOMETRY["sensors"]["stars"]}
    blind["odometry"] = {**ODOMETRY["sensors"]["odometry"], "attitude_sigma": 1e3}
    blind["odometry"]["position_sigma"] = 1e3
    other, _ = run(odometry_scenario(sensors=blind), "batch")
    assert np.degrees(sigmas(other.P)[0, rows]).min() > 0.5


def test_attitude_odometry_alone() -> None:
    """The turn without the displacement: what is known of the rate is nearly the same."""
    turn = {k: v for k, v in ODOMETRY["sensors"]["odometry"].items() if k == "sensor_attitude"}
    turn |= {"kind": "attitude_odometry", "sigma": "0.6 deg"}
    scenario = odometry_scenario(sensors={"odometry": turn, "stars": ODOMETRY["sensors"]["stars"]})
    track, e = run(scenario, "batch")
    rows = track.layout.tangent("target_rate")
    assert np.degrees(np.sqrt((e[:, rows] ** 2).sum(axis=1).mean())) < 0.6
