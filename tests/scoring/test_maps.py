"""Scores of a map of unknown points: one state, with what is derived of it, raw and aligned."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from map_tracks import (
    IDS,
    LAYOUT,
    POINTS,
    filtered,
    joint_covariance,
    moved,
    smoothed,
    truth_of_map,
)

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import POINT
from relnav_graph.core.conformance.numeric import differences
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.numbered import number_in, unnumbered
from relnav_graph.core.track import Track, Truth
from relnav_graph.maths import so3
from relnav_graph.scoring.alignment import align
from relnav_graph.scoring.deviations import chi2_band, estimates
from relnav_graph.scoring.maps import family_scores
from relnav_graph.scoring.metrics import score, summary, table

DERIVED = derived_quantities(LAYOUT)
MAP = slice(11, 26)


def row(track: Track, truth: Truth | None) -> Any:
    found = summary("s", 0, [track], truth, DERIVED, None, 40)["estimators"]
    json.dumps(found, allow_nan=False)
    return next(iter(found.values()))


def points_of(track: Track) -> Array:
    return np.array([track.value(f"point[{i}]")[-1] for i in IDS])


@pytest.mark.parametrize("make", [filtered, smoothed])
def test_a_map_is_one_row(make: Callable[[int], Track]) -> None:
    track = make(40)
    found = row(track, truth_of_map())
    states, statics = found["states"], found["statics"]
    assert not [n for n in (*states, *statics) if "[" in n]
    e, P = (POINTS - points_of(track)).ravel(), joint_covariance()[MAP, MAP] / 40
    own = statics["point"]
    assert own["unit"] == "mm"
    assert own["count"] == 5
    assert own["rmse"] == pytest.approx(1000 * np.sqrt(e @ e / 5))
    assert own["sigma"] == pytest.approx(1000 * np.sqrt(np.trace(P) / 5))
    assert own["anees"] == pytest.approx(e @ np.linalg.solve(P, e) / 15)
    assert own["anees_band"] == pytest.approx(chi2_band(15))
    # Jointly with the rest of what is static.
    assert track.statics is not None
    k = LAYOUT.statics.value(track.statics.x[-1], "inertia_matrix_parameters")
    both = np.concatenate([truth_of_map().values["inertia_matrix_parameters"][0] - k, e])
    whole = joint_covariance()[6:, 6:] / 40
    assert found["statics_anees"] == pytest.approx(both @ np.linalg.solve(whole, both) / 20)


def test_the_centre_of_mass_is_the_common_shift_of_the_points() -> None:
    track = smoothed()
    found = row(track, truth_of_map())["statics"]
    e = (POINTS - points_of(track)).mean(axis=0)
    mean = np.tile(np.eye(3) / 5, (1, 5))
    P = mean @ joint_covariance()[MAP, MAP] @ mean.T / 40
    own = found["centre_of_mass"]
    assert own["rmse"] == pytest.approx(1000 * np.linalg.norm(e))
    assert own["sigma"] == pytest.approx(1000 * np.sqrt(np.trace(P)))
    assert own["anees"] == pytest.approx(e @ np.linalg.solve(P, e) / 3)
    # A common shift of the truth is all its error.
    values = dict(truth_of_map().values)
    for i, X in zip(IDS, points_of(track), strict=True):
        values[f"point[{i}]"] = np.tile(X + np.array([0.003, 0.004, 0.0]), (40, 1))
    shifted = row(track, Truth(np.arange(40.0), values))["statics"]
    assert shifted["centre_of_mass"]["rmse"] == pytest.approx(5.0)
    assert shifted["map_scale"]["rmse"] == pytest.approx(0.0, abs=1e-12)


def test_the_scale_is_that_of_the_points_about_their_middle() -> None:
    track = smoothed()
    values = dict(truth_of_map().values)
    for i, X in zip(IDS, points_of(track), strict=True):
        values[f"point[{i}]"] = np.tile(1.02 * X + [3.0, 4.0, 5.0], (40, 1))
    found = row(track, Truth(np.arange(40.0), values))["statics"]
    assert found["map_scale"]["rmse"] == pytest.approx(np.log(1.02))


def test_jacobians_of_what_is_derived_are_right() -> None:
    track = smoothed(2)
    states, _ = family_scores(track.at(slice(-1, None)), None)
    X, P = states["point"].value[0], states["point"].P[0]

    def size(x: Array) -> Array:
        c = x.reshape(-1, 3) - x.reshape(-1, 3).mean(axis=0)
        return np.array([0.5 * np.log((c**2).sum() / 5)])

    J = differences(lambda d: size(X + d), np.full(15, 1e-4))
    assert states["map_scale"].P[0, 0, 0] == pytest.approx((J @ P @ J.T).item(), rel=1e-6)


def test_drawn_maps_have_an_anees_of_one() -> None:
    found = [score(filtered(3, seed), truth_of_map(3), DERIVED) for seed in range(300)]
    for name, n in (("point", 15), ("centre_of_mass", 3), ("map_scale", 1), ("principal_axes", 3)):
        low, high = chi2_band(n, runs=300, level=0.999)
        assert low < np.mean([s.statics[name].anees or 0.0 for s in found]) < high, name
    low, high = chi2_band(20, runs=300, level=0.999)
    assert low < np.mean([s.statics_anees or 0.0 for s in found]) < high


def test_without_truth_there_are_sigmas() -> None:
    found = row(smoothed(), None)
    statics = found["statics"]
    for name in ("point", "centre_of_mass", "map_scale", "principal_axes", "principal_ratios"):
        assert statics[name]["sigma"] > 0
        assert "rmse" not in statics[name]
    assert "aligned" not in found


def test_points_that_truth_does_not_know_do_not_count() -> None:
    values = {n: v for n, v in truth_of_map().values.items() if n not in ("point[3]", "point[12]")}
    track = smoothed()
    found = row(track, Truth(np.arange(40.0), values))
    statics = found["statics"]
    e = (POINTS - points_of(track))[1:4]
    assert statics["point"]["count"] == 3
    assert statics["point"]["rmse"] == pytest.approx(1000 * np.sqrt((e**2).sum() / 3))
    assert statics["centre_of_mass"]["rmse"] == pytest.approx(1000 * np.linalg.norm(e.mean(axis=0)))
    assert found["aligned"]["points"] == 3


A = so3.exp(np.array([0.02, -0.01, 0.05]))


def test_a_perfect_estimate_in_another_frame_is_perfect_after_alignment() -> None:
    b = np.array([0.1, 0.0, -0.2])
    found = row(moved(A, b), truth_of_map())["aligned"]
    assert found["points"] == 5
    assert found["rotation_deg"] == pytest.approx(np.degrees(np.linalg.norm([0.02, 0.01, 0.05])))
    assert found["shift_m"] == pytest.approx(np.linalg.norm(b))
    assert found["map_rmse_m"] == pytest.approx(0.0, abs=1e-12)
    assert found["scale"] == pytest.approx(1.0)
    assert set(found["states"]) == {"target_attitude", "relative_position", "position_in_target"}
    assert all(s["rmse"] == pytest.approx(0.0, abs=1e-9) for s in found["states"].values())
    raw = row(moved(A, b), truth_of_map())["states"]
    assert raw["target_attitude"]["rmse"] == pytest.approx(found["rotation_deg"])
    assert raw["relative_position"]["rmse"] == pytest.approx(np.linalg.norm(b))


def test_a_wrong_scale_is_left_by_a_rigid_alignment_and_told() -> None:
    found = row(moved(A, np.array([0.1, 0.0, -0.2]), 1.02), truth_of_map())["aligned"]
    centred = POINTS - POINTS.mean(axis=0)
    assert found["map_rmse_m"] == pytest.approx(0.02 * np.sqrt((centred**2).sum() / 5))
    assert found["map_max_m"] == pytest.approx(0.02 * np.linalg.norm(centred, axis=1).max())
    assert found["scale"] == pytest.approx(1.02)
    assert found["scaled"]["map_rmse_m"] == pytest.approx(0.0, abs=1e-12)
    assert found["scaled"]["states"]["relative_position"]["rmse"] == pytest.approx(0.0, abs=1e-9)


def test_the_alignment_is_of_the_scored_window() -> None:
    track = moved(A, np.array([0.1, 0.0, -0.2]))
    x = track.x.copy()
    x[:20, -3:] += 1.0  # what is not scored
    broken = replace(track, x=x)
    found = summary("s", 0, [broken], truth_of_map(), DERIVED, (0.6, 1.0), 40)["estimators"][
        "batch"
    ]
    assert found["aligned"]["states"]["relative_position"]["rmse"] == pytest.approx(0.0, abs=1e-9)


def test_points_on_a_line_or_too_few_tell_no_rotation() -> None:
    line = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    assert align(line, line + 0.1) is None
    assert align(POINTS[:2], POINTS[:2]) is None
    # Points in a plane do, and a mirror image is no rotation.
    flat = POINTS * [1.0, 1.0, 0.0]
    motion = align(flat, flat @ A.T)
    assert motion is not None
    np.testing.assert_allclose(motion.A, A, atol=1e-12)
    mirrored = align(POINTS, POINTS * [1.0, 1.0, -1.0])
    assert mirrored is not None
    assert np.linalg.det(mirrored.A) == pytest.approx(1.0)


def test_a_diverged_map_has_no_numbers_and_no_alignment() -> None:
    track = smoothed()
    assert track.statics is not None
    broken = replace(
        track,
        status="diverged",
        statics=replace(track.statics, x=np.full_like(track.statics.x, np.nan)),
    )
    found = row(broken, truth_of_map())
    statics = found["statics"]
    assert statics["point"]["rmse"] is None
    assert "aligned" not in found


def test_the_table_has_one_line_for_the_map() -> None:
    text = table(summary("s", 0, [filtered(), smoothed()], truth_of_map(), DERIVED, None, 40))
    assert "point, 5 of them [mm]" in text
    assert "point[" not in text
    assert "centre_of_mass [mm]" in text
    assert "after one rigid alignment" in text
    assert "map, rmse [m]" in text


def test_names_of_families() -> None:
    assert number_in("point[17]") == ("point", 17)
    assert number_in("point") == ("point", None)
    assert unnumbered(POINT.numbered(17)) == POINT
    assert "point[3]" not in estimates(smoothed(), DERIVED)
