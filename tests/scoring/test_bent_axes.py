"""The caution of vectors in axes that are badly known: without truth, and of attitudes alone."""

from __future__ import annotations

import numpy as np
import pytest
from passes import ZHANG, recorded

from relnav_graph.core.catalogue import BODY_RATE, RELATIVE_POSITION, TARGET_ATTITUDE
from relnav_graph.core.scored import InAxes
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.estimators import try_estimator
from relnav_graph.runs.passes import open_pass
from relnav_graph.scoring.agreement import distances, row_cautions
from relnav_graph.scoring.bent_axes import BENT_AXES, axes_cautions, bend
from relnav_graph.scoring.metrics import with_smoothed

DEGREE = np.pi / 180
LAYOUT = Layout([TARGET_ATTITUDE, BODY_RATE, RELATIVE_POSITION])
RATE = np.array([0.0, 5.0, 0.0]) * DEGREE


def track(attitude: float, rate: float, epochs: int = 50) -> Track:
    """A rate that is known in o, 1-sigma of it and of the attitude in deg/s and deg."""
    x = LAYOUT.identity.copy()
    x[LAYOUT.stored("body_rate")] = RATE
    seen = InAxes.of(BODY_RATE, "o", LAYOUT)
    J = np.eye(9)
    J[3:6, :6] = seen.value(np.eye(3), RATE)[1]
    own = np.diag(np.repeat([attitude * DEGREE, rate * DEGREE, 0.1], 3) ** 2)
    K = np.linalg.inv(J)
    P = np.tile(K @ own @ K.T, (epochs, 1, 1))
    return Track("a", "smoothed", LAYOUT, np.arange(float(epochs)), np.tile(x, (epochs, 1)), P)


def test_the_change_is_half_the_square_of_the_angle() -> None:
    """About an axis across the rate, w_o is kept to first order, and off by |w| s^2 / 2 in units of
    its sigma: the same as a rate whose axes are turned by s."""
    found = bend(track(10, 0.1), TARGET_ATTITUDE, InAxes.of(BODY_RATE, "o", LAYOUT))
    np.testing.assert_allclose(found, 5 * (10 * DEGREE) ** 2 / 2 / 0.1, rtol=0.02)


@pytest.mark.parametrize(
    ("attitude", "rate", "fires"), [(10, 0.1, True), (10, 5, False), (0.5, 0.1, False)]
)
def test_it_fires_where_axes_are_worse_known_than_the_rate(
    attitude: float, rate: float, fires: bool
) -> None:
    found = axes_cautions(track(attitude, rate))
    assert [c.name for c in found] == [BENT_AXES] * fires
    for c in found:
        assert "over one sigma of target_attitude, body_rate changes" in c.text
        assert "[score] axes" in c.text


def test_a_track_without_covariances_says_nothing() -> None:
    from dataclasses import replace

    one = track(10, 0.1)
    assert not axes_cautions(replace(one, P=np.full_like(one.P, np.nan)))
    assert not axes_cautions(one.at(slice(0, 0)))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_none_on_zhang2015(seed: int) -> None:
    kinds = ("batch", "incremental", "fixed_lag", "isam2")
    problem = open_pass(ZHANG, seed, assignments=["time.epochs=120"]).problem
    rows = with_smoothed([try_estimator(kind, problem) for kind in kinds])
    found = row_cautions(rows, *distances(rows))
    for name in ("batch", "incremental_smoothed", "fixed_lag_smoothed", "isam2_smoothed"):
        assert not found[name], name


def test_one_on_astrobee_tumble() -> None:
    path = ZHANG.with_name("astrobee_tumble.toml")
    from relnav_graph.runs.comparison import compare

    row = compare(path, ["batch"], data=recorded("astrobee_tumble")).summary
    assert BENT_AXES in [c["name"] for c in row["estimators"]["batch"]["cautions"]]
    assert row["estimators"]["batch"]["status"] == "ok"
    assert row["estimators"]["batch"]["anees_without"] <= 1.5
    assert row["estimators"]["batch"]["states"]["target_rate"]["rmse"] <= 0.24
