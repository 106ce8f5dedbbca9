"""Scores of static blocks: what is known of a constant is what a pass ends with."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from static_tracks import (
    LAYOUT,
    LEVER_ARM,
    MOUNTING,
    filtered,
    joint_covariance,
    smoothed,
    truth_of_statics,
)

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track, Truth
from relnav_graph.scoring.agreement import distances, row_cautions
from relnav_graph.scoring.deviations import chi2_band, errors
from relnav_graph.scoring.metrics import estimates, score, summary, table


@dataclass(frozen=True)
class FromSensor:
    """The target's place relative to the sensor's foot, r - a: of a moving and a static block."""

    kind: ClassVar[str] = "toy_from_sensor"
    block: ClassVar[Block] = Block("from_sensor", "d", "vector", 3, "m", "c", "m")
    reads: ClassVar[tuple[Block, ...]] = (LEVER_ARM, RELATIVE_POSITION)

    def value(self, *x: Array) -> tuple[Array, Array]:
        return x[1] - x[0], np.hstack([-np.eye(3), np.eye(3)])


def test_a_derived_quantity_has_the_cross_covariance() -> None:
    track = filtered(5)
    P = joint_covariance()
    a, r = slice(6, 9), slice(0, 3)
    whole = P[a, a] + P[r, r] - P[a, r] - P[r, a]
    found = estimates(track, [FromSensor()])["from_sensor"]
    np.testing.assert_allclose(found.P[3], whole / 4, rtol=1e-12)
    assert np.abs(P[a, r]).max() > 0.03 * np.abs(whole).max()  # which leaving it out would show
    of_it = errors(track, truth_of_statics(5), [FromSensor()])["from_sensor"]
    moving, static = (errors(track, truth_of_statics(5), [])[n] for n in LAYOUT_NAMES)
    np.testing.assert_allclose(of_it.e, moving.e - static.e, atol=1e-12)


LAYOUT_NAMES = ("relative_position", "lever_arm")


@pytest.mark.parametrize("make", [filtered, smoothed])
def test_statics_are_scored_at_the_last_epoch(make: Callable[[int], Track]) -> None:
    track, truth = make(40), truth_of_statics()
    found = summary("s", 0, [track], truth, [], None, 40)["estimators"][track.name]
    e = np.hstack([errors(track, truth, [])[b.name].e[-1] for b in (MOUNTING, LEVER_ARM)])
    P = joint_covariance()[3:, 3:] / 40
    scale = 180 / np.pi, 100.0
    for k, (name, unit) in enumerate((("mounting", "deg"), ("lever_arm", "cm"))):
        own, part = found["statics"][name], slice(3 * k, 3 * k + 3)
        assert set(own) == {"unit", "rmse", "sigma", "anees", "anees_band"}
        assert own["unit"] == unit == found["states"][name]["unit"]
        assert own["rmse"] == pytest.approx(scale[k] * np.linalg.norm(e[part]))
        assert own["sigma"] == pytest.approx(scale[k] * np.sqrt(np.trace(P[part, part])))
        want = e[part] @ np.linalg.solve(P[part, part], e[part]) / 3
        assert own["anees"] == pytest.approx(want)
    assert found["statics_anees"] == pytest.approx(e @ np.linalg.solve(P, e) / 6)
    assert found["statics_anees_band"] == pytest.approx(chi2_band(6))
    json.dumps(found, allow_nan=False)
    # The estimator's own ANEES is that of the states that move.
    alone = replace(track, statics=None)
    assert score(alone, truth, []).anees == found["anees"]
    without = summary("s", 0, [alone], truth, [], None, 40)["estimators"][track.name]
    assert "statics" not in without
    assert "statics_anees" not in without


@dataclass(frozen=True)
class Half:
    """Half a lever arm: of a static block alone."""

    kind: ClassVar[str] = "toy_half"
    block: ClassVar[Block] = Block("half", "h", "vector", 3, "m", "c", "m")
    reads: ClassVar[tuple[Block, ...]] = (LEVER_ARM,)

    def value(self, *x: Array) -> tuple[Array, Array]:
        return 0.5 * x[0], 0.5 * np.eye(3)


def test_what_is_derived_of_constants_is_one() -> None:
    found = score(filtered(), truth_of_statics(), [Half(), FromSensor()])
    assert set(found.statics) == {"mounting", "lever_arm", "half"}
    half, arm = found.statics["half"], found.statics["lever_arm"]
    assert half.anees == pytest.approx(arm.anees)
    assert half.rmse == pytest.approx(0.5 * 0.01 * (arm.rmse or 0))
    assert found.statics_freedoms == 6  # of the blocks: the half says nothing new


def test_drawn_statics_have_an_anees_of_one() -> None:
    found = [score(filtered(3, seed), truth_of_statics(3), []) for seed in range(300)]
    low, high = chi2_band(6, runs=300, level=0.999)
    assert low < np.mean([s.statics_anees for s in found if s.statics_anees is not None]) < high


def test_a_static_block_that_truth_does_not_know() -> None:
    track, truth = filtered(), truth_of_statics()
    fewer = {n: v for n, v in truth.values.items() if n != "mounting"}
    found = summary("s", 0, [track], Truth(truth.t, fewer), [], None, 40)["estimators"]["ekf"]
    assert set(found["statics"]["mounting"]) == {"unit", "sigma", "estimate"}
    P = joint_covariance()[3:6, 3:6] / 40
    assert found["statics"]["mounting"]["sigma"] == pytest.approx(np.degrees(np.sqrt(np.trace(P))))
    assert found["statics_anees"] == pytest.approx(found["statics"]["lever_arm"]["anees"])
    # Known for a while only: there, and for all at one time.
    gone = {**truth.values, "lever_arm": truth.values["lever_arm"].copy()}
    gone["lever_arm"][30:] = np.nan
    early = score(track, Truth(truth.t, gone), [])
    assert early.statics["mounting"].t.tolist() == early.statics["lever_arm"].t.tolist() == [29.0]
    none = summary("s", 0, [track], None, [], None, 40)["estimators"]["ekf"]
    assert none["statics_anees"] is None
    assert "-" in table(summary("s", 0, [track], None, [], None, 40))


def test_of_a_window_it_is_the_last_epoch() -> None:
    found = score(filtered(41), truth_of_statics(41), [], (0.25, 0.75))
    assert found.statics["mounting"].t.tolist() == [30.0]
    whole = score(filtered(41), None, [], (0.25, 0.75))
    assert whole.statics["mounting"].sigma == pytest.approx(found.statics["mounting"].sigma)


def test_distance_and_caution_look_at_statics() -> None:
    reference, near = smoothed(), filtered()
    name, apart = distances({"ekf": near, "batch": reference})
    assert set(name.values()) == {"batch"}
    assert apart["ekf"] == pytest.approx(0, abs=1e-6)
    s = near.statics
    assert s is not None
    x = s.x.copy()
    x[:, -1] += 5 * np.sqrt(joint_covariance()[8, 8] / 40)  # one constant, 5 sigma off
    far = replace(near, statics=replace(s, x=x))
    rows = {"ekf": far, "batch": reference}
    name, apart = distances(rows)
    assert apart["ekf"] == pytest.approx(5, rel=1e-6)
    assert [c.name for c in row_cautions(rows, name, apart)["ekf"]] == ["distance"]
    # Where one of them has no statics, the rest is compared.
    assert distances({"ekf": replace(far, statics=None), "batch": reference})[1][
        "ekf"
    ] == pytest.approx(0, abs=1e-6)


def test_a_filter_that_is_sure_of_a_wrong_constant_is_overconfident() -> None:
    reference, own = smoothed(1200), filtered(1200)
    s = own.statics
    assert s is not None
    wrong = replace(own, statics=replace(s, P=1e-4 * s.P, cross=1e-2 * s.cross))
    rows = {"ekf": wrong, "batch": reference}
    name, apart = distances(rows)
    found = row_cautions(rows, name, apart)["ekf"]
    assert [c.name for c in found] == ["overconfident", "wandering constants"]


def test_the_table_has_constants_apart() -> None:
    text = table(summary("s", 0, [filtered(), smoothed()], truth_of_statics(), [], None, 40))
    moving, _, constants = text.partition("constants, as at the last epoch")
    assert "mounting" not in moving
    lines = [line.split() for line in constants.splitlines() if line]
    assert lines[1][:3] == ["mounting", "[deg]", "ekf"]
    assert lines[2][0] == "batch"
    assert lines[-2][:4] == ["all", "of", "them,", "jointly"]
    assert "constants" not in table(
        summary("s", 0, [replace(filtered(), statics=None)], truth_of_statics(), [], None, 40)
    )
    assert LAYOUT.statics.dim == 6
