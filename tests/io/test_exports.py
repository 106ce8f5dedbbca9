"""Tracks as data frames, xarray's data sets and figures; and what the nouns say of themselves."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from online_passes import zhang
from passes import ZHANG

import relnav_graph as rg
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError, ModelError
from relnav_graph.io.tabular import to_components
from relnav_graph.maths import so3
from relnav_graph.runs.plotting import _angles
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.deviations import estimates


@pytest.fixture(scope="module")
def track() -> Track:
    return rg.run_estimator("ekf", zhang()[0])


def test_a_data_frame_has_a_row_for_each_epoch_and_all_sigmas(track: Track) -> None:
    frame = track.to_dataframe()
    np.testing.assert_array_equal(frame.index, track.t)
    np.testing.assert_array_equal(
        frame[[f"relative_position_{a}_m" for a in "xyz"]], track.value("relative_position")
    )
    sigma = np.sqrt(np.diagonal(track.covariance("chaser_attitude"), axis1=1, axis2=2))
    found = frame[[f"sigma_chaser_attitude_{a}_rad" for a in "xyz"]]
    np.testing.assert_array_equal(found, sigma)
    quaternions = frame[[f"chaser_attitude_q_{a}" for a in "wxyz"]].to_numpy()
    block = track.layout.block("chaser_attitude")
    np.testing.assert_array_equal(quaternions, to_components(block, track.value(block.name)))


def test_what_is_derived_is_in_both(track: Track) -> None:
    """The numbers and sigmas that are scored, under the same names."""
    frame, dataset = track.to_dataframe(), track.to_xarray()
    states = estimates(track, derived_quantities(track.layout))
    for name in ("relative_attitude", "position_in_target", "inertia_ratios"):
        sigma = np.sqrt(np.diagonal(states[name].P, axis1=1, axis2=2))
        columns = [c for c in frame.columns if c.startswith(f"sigma_{name}_")]
        np.testing.assert_array_equal(frame[columns], sigma)
        np.testing.assert_array_equal(dataset[f"{name}_sigma"], sigma)
        np.testing.assert_array_equal(dataset[f"{name}_covariance"], states[name].P)
    np.testing.assert_array_equal(
        dataset["position_in_target"].sel(position_in_target_component="y"),
        states["position_in_target"].value[:, 1],
    )
    assert dataset["position_in_target"].attrs["units"] == "m"
    assert dataset["relative_attitude"].attrs["frame"] == "tc"


def test_what_is_derived_has_value_and_covariance_by_name(track: Track) -> None:
    """Jointly with what it derives from, constants among them: J P J^T of all of them."""
    states = estimates(track, derived_quantities(Layout(track.blocks)))
    for name in ("relative_attitude", "inertia_ratios"):
        np.testing.assert_array_equal(track.value(name), states[name].value)
        np.testing.assert_allclose(track.covariance(name), states[name].P, rtol=1e-9)
    names = ("chaser_attitude", "relative_attitude", "target_attitude")
    P = track.covariance(*names)
    assert P.shape == (len(track.t), 9, 9)
    R = track.value("relative_attitude")
    # R_tc (I + e) = (R_ot (I + e_t))^T R_oc (I + e_c), so that e = e_c - R_tc^T e_t.
    J = np.concatenate([np.tile(np.eye(3), (len(R), 1, 1)), -R.transpose(0, 2, 1)], axis=2)
    own = track.covariance("chaser_attitude", "target_attitude")
    np.testing.assert_allclose(P[:, :3, 3:6], own[:, :3] @ J.transpose(0, 2, 1), atol=1e-12)
    np.testing.assert_allclose(P[:, 6:, 3:6], own[:, 3:] @ J.transpose(0, 2, 1), atol=1e-12)
    np.testing.assert_allclose(P, P.transpose(0, 2, 1), atol=1e-18)


def test_an_unknown_name_is_answered_with_all_there_are(track: Track) -> None:
    for call in (track.value, track.covariance):
        with pytest.raises(ModelError, match=r"no block 'no_such'; 'ekf' has ") as caught:
            call("no_such")
        assert "inertia_parameters" in str(caught.value)  # a constant
        assert "relative_attitude" in str(caught.value)  # derived


def test_points_of_a_map_are_an_array_by_id() -> None:
    scenario = load_scenario(ZHANG.parent / "inspection.toml", ["time.epochs=3"])
    problem = scenario.problem(scenario.simulate(0), 0)
    track = rg.run_estimator("ekf", problem)
    dataset = track.to_xarray()
    some = [b for b in track.blocks if b.number is not None][3]
    own = dataset["point"].sel(point_id=some.number)
    np.testing.assert_array_equal(own, track.value(some.name))
    assert dataset["point_sigma"].shape == dataset["point"].shape


def test_a_figure_has_a_panel_for_each_state(track: Track) -> None:
    _, recording = zhang()
    figure = track.plot(["relative_position", "relative_attitude"])
    assert isinstance(figure, Figure)
    titles = [ax.get_title("left") for ax in figure.axes]
    assert titles == [
        "relative position r_tc_o, m",
        "relative attitude R_tc, rotation vector, deg",
    ]
    np.testing.assert_array_equal(
        figure.axes[0].lines[1].get_ydata(), track.value("relative_position")[:, 1]
    )
    against: Any = track.plot(["relative_position"], truth=recording.truth)
    assert recording.truth is not None
    error = recording.truth.values["relative_position"] - track.value("relative_position")
    np.testing.assert_allclose(against.axes[0].lines[2].get_ydata(), error[:, 2])
    with pytest.raises(InputError, match="found 'position', expected some of: relative_position"):
        track.plot(["position"])


def test_attitudes_are_drawn_without_jumps() -> None:
    """A chaser that turns by more than half a turn: its rotation vector goes on."""
    axis = np.array([0.6, 0.0, 0.8])
    turned = np.array([so3.exp(angle * axis) for angle in np.arange(0.0, 20.0, 0.5)])
    np.testing.assert_allclose(
        _angles(turned), np.outer(np.arange(0.0, 20.0, 0.5), axis), atol=1e-12
    )


def test_without_the_libraries_the_extra_is_named(
    track: Track, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pandas", "xarray"):
        monkeypatch.setitem(sys.modules, name, None)
    for export in (track.to_dataframe, track.to_xarray):
        with pytest.raises(InputError, match=r"pip install 'relnav-graph\[data\]'"):
            export()


def test_nouns_say_of_themselves_a_few_lines(track: Track) -> None:
    problem, recording = zhang()
    scenario = load_scenario(ZHANG, ["time.epochs=5"])
    found = rg.compare(scenario, ["ekf"])
    for noun, words in (
        (track, ["Track 'ekf' (filtered): 20 epochs", "ok", "relative_position"]),
        (problem, ["Problem: 20 epochs, 0 s to 190 s", "beacons (beacon_los, "]),
        (recording, ["Recording: 20 epochs", "beacons: ", "gyro: "]),
        (recording.truth, ["Truth: 20 epochs", "target_attitude"]),
        (scenario, ["Scenario 'zhang2015'", "beacons (beacon_los)", "truth"]),
        (found, ["Comparison of 'zhang2015': 5 epochs", "ekf", "filtered, ok, ANEES "]),
    ):
        text = repr(noun)
        assert len(text.splitlines()) <= 12
        assert max(map(len, text.splitlines())) <= 96
        html = noun._repr_html_()  # type: ignore[union-attr]
        assert html.startswith("<b>")
        assert html.count("<tr>") == len(text.splitlines()) - 1
        for word in words:
            assert word in text, text
