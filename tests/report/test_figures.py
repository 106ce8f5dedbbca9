"""Figures of synthetic tracks: what is drawn, its limits and labels, and its files."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from static_tracks import filtered, smoothed, truth_of_statics

from relnav_graph.core.catalogue import GYRO_BIAS, INERTIA, RELATIVE_POSITION, TARGET_ATTITUDE
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Innovations, Track, Truth
from relnav_graph.errors import InputError
from relnav_graph.figures import (
    chosen_rows,
    consistency_figure,
    error_figures,
    residual_figure,
    save_figures,
    save_pass,
    trajectory_figure,
)
from relnav_graph.figures.states import quaternions
from relnav_graph.maths import so3
from relnav_graph.scoring.deviations import chi2_band

LAYOUT = Layout([RELATIVE_POSITION, TARGET_ATTITUDE])
N = 40


def tracks() -> tuple[list[Track], Truth]:
    """A filter with a transient a hundred times its later size, and a smoother."""
    t = np.linspace(0.0, 390.0, N)
    x = np.tile(LAYOUT.identity, (N, 1))
    x[:, :3] = np.column_stack([np.cos(t / 60), 5 + np.sin(t / 60), t / 400])
    truth = Truth(t, LAYOUT.values(x))
    sigma = 0.1 + 10 * (np.arange(N) < 3)
    P = sigma[:, None, None] ** 2 * np.eye(6)
    off = x.copy()
    off[:, :3] += sigma[:, None]
    smoother = Track("batch", "smoothed", LAYOUT, t, x, np.tile(1e-4 * np.eye(6), (N, 1, 1)))
    return [Track("ekf", "filtered", LAYOUT, t, off, P), smoother], truth


def texts(figure: Figure) -> list[str]:
    return [note.get_text() for ax in figure.axes for note in ax.texts]


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for box in figure.legends for text in box.get_texts()]


def test_a_panel_per_axis_with_units_and_frames() -> None:
    pair, truth = tracks()
    figures = error_figures(pair, truth, [])
    assert list(figures) == ["relative_position", "target_attitude"]
    labels = [ax.get_ylabel() for ax in figures["target_attitude"].axes]
    assert labels == ["$x_{t}$ [deg]", "$y_{t}$ [deg]", "$z_{t}$ [deg]"]
    assert "frame o" in figures["relative_position"].axes[0].get_title("left")
    assert legend(figures["relative_position"]) == [
        "ekf (filtered)",
        "batch (smoothed)",
        "±3 sigma",
    ]


def test_a_control_error_has_no_sigma() -> None:
    (track, _), truth = tracks()
    block = replace(TARGET_ATTITUDE, name="control_attitude")
    truth = replace(truth, values={**truth.values, block.name: truth.values["target_attitude"]})
    figures = error_figures([replace(track, controlled=(block,))], truth, [])
    assert legend(figures["control_attitude"]) == ["ekf (filtered)"]
    assert "truth − aim" in figures["control_attitude"].axes[0].get_title("left")


def test_drawn_are_errors_and_three_sigma_in_table_units() -> None:
    pair, truth = tracks()
    ax = error_figures(pair[:1], truth, [])["relative_position"].axes[0]
    edges, error = (np.asarray(line.get_ydata()) for line in ax.lines[:2])
    low, high = edges[:N], edges[N + 1 :]
    np.testing.assert_allclose(high, 3 * np.sqrt(pair[0].P[:, 0, 0]))
    np.testing.assert_allclose(low, -high)
    np.testing.assert_allclose(error, truth.values["relative_position"][:, 0] - pair[0].x[:, 0])
    attitude = error_figures(pair[:1], truth, [])["target_attitude"].axes[0]
    degrees = np.asarray(attitude.lines[0].get_ydata())[N + 1 :]
    np.testing.assert_allclose(degrees, np.degrees(high))


def test_a_transient_does_not_set_the_limits_and_is_named() -> None:
    pair, truth = tracks()
    figure = error_figures(pair, truth, [])["relative_position"]
    low, high = figure.axes[0].get_ylim()
    assert 0.3 < high < 0.6  # three sigma after the transient: 0.3 m
    assert low == -high
    assert texts(figure) == ["off scale: ekf to 10"] * 3
    calm = error_figures(pair[1:], truth, [])["relative_position"]
    assert texts(calm) == []


@pytest.mark.parametrize("value", [1e6, np.nan])
def test_a_diverged_track_does_not_crush_the_others(value: float) -> None:
    pair, truth = tracks()
    x = pair[0].x.copy()
    x[:, :3] = value
    lost = replace(pair[0], name="lost", x=x, status="diverged")
    figure = error_figures([lost, *pair], truth, [])["relative_position"]
    assert figure.axes[0].get_ylim()[1] < 0.6
    said = "off scale: lost to 1e+06" if value == 1e6 else "off scale: ekf to 10"  # no error: none
    assert texts(figure)[0].startswith(said)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_track_of_no_use_still_gives_a_figure(value: float) -> None:
    pair, truth = tracks()
    x, P = np.full_like(pair[0].x, value), np.full_like(pair[0].P, value)
    lost = replace(pair[0], x=x, P=P, status="diverged")
    figure = error_figures([lost], truth, [])["relative_position"]
    assert np.isfinite(figure.axes[0].get_ylim()).all()
    figure.draw_without_rendering()
    error_figures([lost], None, [])["relative_position"].draw_without_rendering()


def test_both_rows_of_an_online_estimator_are_drawn() -> None:
    pair, truth = tracks()
    online = replace(pair[0], name="incremental", smoothed=pair[1])
    figure = error_figures([online], truth, [])["relative_position"]
    assert legend(figure)[:2] == ["incremental (filtered)", "incremental_smoothed (smoothed)"]


def test_without_truth_estimates_and_how_far_they_are_apart() -> None:
    pair, _ = tracks()
    figures = error_figures(pair, None, [])
    figure, attitude = figures["relative_position"], figures["target_attitude"]
    assert "estimate" in figure.axes[0].get_title("left")
    assert [ax.get_ylabel() for ax in figure.axes[2:4]] == ["$z_{o}$ [m]", "Δ$x_{o}$ [m]"]
    edges, value = (np.asarray(line.get_ydata()) for line in figure.axes[0].lines[:2])
    np.testing.assert_allclose(value, pair[0].x[:, 0])
    np.testing.assert_allclose(edges[N + 1 :] - edges[:N], 6 * np.sqrt(pair[0].P[:, 0, 0]))
    away, same = (np.asarray(figure.axes[3].lines[k].get_ydata()) for k in (1, 3))
    np.testing.assert_allclose(away, pair[0].x[:, 0] - pair[1].x[:, 0], atol=1e-12)
    assert not same.any()  # the smoother, less itself
    assert texts(figure)[-1] == "off scale: ekf to 10"
    assert "less batch" in texts(figure)
    assert attitude.axes[0].get_ylabel() == "quaternion"
    assert len(attitude.axes) == 4


def test_a_quaternion_does_not_jump() -> None:
    angles = np.radians(np.arange(0, 1000, 5.0))
    R = np.array([so3.exp(np.array([0.0, 0.0, a])) for a in angles])
    q = quaternions(R)
    np.testing.assert_allclose(q[:, 0], np.cos(angles / 2), atol=1e-9)
    np.testing.assert_allclose(q[:, 3], np.sin(angles / 2), atol=1e-9)


def test_at_most_three_rows_are_drawn_or_those_that_are_named() -> None:
    ekf, batch = tracks()[0]
    online = replace(ekf, name="incremental", smoothed=replace(batch, name="x"))
    every = [ekf, replace(ekf, name="iekf"), replace(batch, name="rts"), batch, online]
    assert list(chosen_rows(every)) == ["iekf", "batch", "incremental"]
    assert list(chosen_rows(every, ["rts", "incremental_smoothed"])) == [
        "rts",
        "incremental_smoothed",
    ]
    with pytest.raises(InputError, match="draw: found 'ukf', expected of: ekf, iekf"):
        chosen_rows(every, ["ukf"])


def test_nees_and_nis_stand_in_strips_with_their_bands() -> None:
    (ekf, batch), truth = tracks()
    v = np.tile([1.0, -1.0], N)
    heard = replace(ekf, innovations={"camera": Innovations(ekf.t, v, 2 * np.arange(N + 1))})
    figure = consistency_figure([heard, batch], truth, [])
    assert figure is not None
    assert [ax.get_ylabel() for ax in figure.axes] == ["NEES", "NIS, camera"]
    drawn = np.asarray(figure.axes[0].lines[0].get_ydata())
    np.testing.assert_allclose(drawn, 0.5)  # three of six components are one sigma off
    np.testing.assert_allclose(np.asarray(figure.axes[1].lines[0].get_ydata()), 1)
    for ax, freedoms in zip(figure.axes, (6, 2), strict=True):
        inside = np.asarray(ax.collections[-1].get_paths()[0].vertices, dtype=np.float64)[:, 1]
        band = np.array([inside.min(), inside.max()])
        np.testing.assert_allclose(band, np.array(chi2_band(freedoms)))
    only = consistency_figure([heard, batch], None, [])
    assert only is not None
    (legend,) = only.legends
    said = [text.get_text() for text in legend.get_texts()]
    assert said == ["ekf (filtered)", "95 % band"]  # and no row of which nothing is drawn
    assert residual_figure([ekf]) is None
    (ax,) = residual_figure([heard]).axes  # type: ignore[union-attr]
    assert np.asarray(ax.lines[0].get_xdata()).size == 2 * N
    assert consistency_figure([ekf], None, []) is None


def test_a_pdf_is_as_wide_as_a_column_and_has_no_title(tmp_path: Path) -> None:
    pair, truth = tracks()
    paths = save_pass(pair[:1], truth, [], tmp_path, formats=("pdf",))
    assert {p.suffix for p in paths} == {".pdf"}
    (box,) = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+)", paths[0].read_bytes())
    assert float(box) == pytest.approx(85 / 25.4 * 72, abs=0.1)


def test_a_state_that_truth_does_not_know_is_still_drawn() -> None:
    layout = Layout([GYRO_BIAS, INERTIA])
    t = np.arange(5.0)
    track = Track("a", "smoothed", layout, t, np.zeros((5, 5)), np.tile(np.eye(5), (5, 1, 1)))
    figures = error_figures([track], Truth(t, {"gyro_bias": np.zeros((5, 3))}), [])
    labels = [ax.get_ylabel() for ax in figures["inertia_parameters"].axes]
    assert labels == ["$k_{1}$", "$k_{2}$", "Δ$k_{1}$", "Δ$k_{2}$"]
    assert "estimate" in figures["inertia_parameters"].axes[0].get_title("left")
    assert "error" in figures["gyro_bias"].axes[0].get_title("left")


def test_trajectory_shows_three_planes_at_one_scale() -> None:
    pair, truth = tracks()
    figure = trajectory_figure(pair, truth)
    assert figure is not None
    planes = [(ax.get_xlabel(), ax.get_ylabel()) for ax in figure.axes]
    assert planes[0] == ("$y_{o}$ [m]", "$x_{o}$ [m]")
    assert legend(figure)[:3] == ["truth", "ekf (filtered)", "batch (smoothed)"]
    spans = [np.ptp(limits) for ax in figure.axes for limits in (ax.get_xlim(), ax.get_ylim())]
    np.testing.assert_allclose(spans, spans[0])
    for ax in figure.axes:  # truth lies within, the transient need not
        path = np.asarray(ax.lines[0].get_xydata())
        assert (path.min(axis=0) > [ax.get_xlim()[0], ax.get_ylim()[0]]).all()
        assert (path.max(axis=0) < [ax.get_xlim()[1], ax.get_ylim()[1]]).all()


def test_trajectory_without_truth_or_without_position() -> None:
    pair, _ = tracks()
    figure = trajectory_figure(pair, None)
    assert figure is not None
    assert "truth" not in legend(figure)
    attitude = Layout([TARGET_ATTITUDE])
    blind = replace(pair[1], layout=attitude, x=pair[1].x[:, 3:], P=pair[1].P[:, 3:, 3:])
    assert trajectory_figure([blind], None) is None


def _width(svg: str) -> tuple[float, float]:
    """Of an SVG in points, and in its own units."""
    head = re.search(r'width="([\d.]+)pt".*viewBox="0 0 ([\d.]+)', svg)
    assert head is not None
    return float(head[1]), float(head[2])


def test_files_are_the_same_byte_for_byte(tmp_path: Path) -> None:
    layout, t = Layout([INERTIA]), np.arange(5.0)
    track = Track("a", "smoothed", layout, t, np.ones((5, 2)), np.tile(np.eye(2), (5, 1, 1)))
    truth = Truth(t, {"inertia_parameters": np.zeros((5, 2))})

    def write(folder: Path) -> dict[str, bytes]:
        paths = save_figures(error_figures([track], truth, []), folder)
        return {path.name: path.read_bytes() for path in paths}

    first = write(tmp_path / "deep" / "first")
    svg = first["inertia_parameters.svg"].decode()
    (points, dots), found = _width(svg), re.findall(r"stroke-width: ([\d.]+)", svg)
    assert points == 504
    assert {0.5, 1.2} <= {round(float(width) * points / dots, 2) for width in found}
    assert set(first) == {"inertia_parameters.svg", "inertia_parameters.png"}
    assert first == write(tmp_path / "second")
    assert b"<dc:date>" not in first["inertia_parameters.svg"]


def test_no_global_state_of_matplotlib_is_touched() -> None:
    pair, truth = tracks()
    before = dict(mpl.rcParams)
    error_figures(pair, truth, [])
    assert dict(mpl.rcParams) == before
    code = "import sys, relnav_graph.figures; sys.exit('matplotlib.pyplot' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_constant_converges_to_the_smoothers_line() -> None:
    figures = error_figures([filtered(), smoothed()], truth_of_statics(), [])
    assert set(figures) == {"relative_position", "mounting", "lever_arm"}
    titles = {n: f.axes[0].get_title(loc="left") for n, f in figures.items()}
    assert "a constant" not in titles["relative_position"]
    assert titles["mounting"].startswith("Mounting $R_{cs}$, a constant: error")
    for ax in figures["lever_arm"].axes:
        drawn = {line.get_color(): line for line in ax.lines if line.get_linewidth() in (0.8, 1.2)}
        learning, known = (np.asarray(line.get_ydata()) for line in drawn.values())
        assert np.ptp(known) == 0
        assert abs(learning[0]) > 5 * abs(learning[-1]) > 0
        assert learning[-1] == pytest.approx(known[-1])
