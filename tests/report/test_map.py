"""A map of unknown points in figures, tables and the scene of a report."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from map_tracks import IDS, LAYOUT, POINTS, filtered, joint_covariance, smoothed, truth_of_map
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from relnav_graph.core.models import derived_quantities
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Truth
from relnav_graph.figures import error_figures, map_figure
from relnav_graph.report import cells
from relnav_graph.report.scene import make_scene
from relnav_graph.report.zoom import zoomable
from relnav_graph.scoring.metrics import summary
from relnav_graph.streaming.writing import estimate_object

SEEN = {f"point[{i}]": n for i, n in zip(IDS, (10, 50, 40, 30, 20), strict=True)}


def test_no_point_has_a_figure_of_its_own() -> None:
    figures = error_figures([filtered(), smoothed()], truth_of_map(), derived_quantities(LAYOUT))
    assert "principal_axes" in figures
    assert not [name for name in figures if "point" in name]


def heights_in(panel: Axes) -> list[float]:
    return [bar.get_height() for bar in panel.patches if isinstance(bar, Rectangle)]


def test_the_figure_of_the_map_has_points_by_times_seen() -> None:
    track = smoothed()
    figure = map_figure([track], truth_of_map(), SEEN)
    assert figure is not None
    panels = figure.axes
    assert len(panels) == 4
    assert [t.get_text() for t in panels[-1].get_xticklabels()] == ["0", "7", "1", "12", "3"]
    for axis in range(3):
        dots = next(line for line in panels[axis].lines if line.get_marker() == "o")
        shown = {round(x): y for x, y in np.asarray(dots.get_xydata()).tolist()}
        order = [1, 2, 3, 4, 0]  # of IDS, in the figure
        for place, k in enumerate(order):
            e = 1000 * (POINTS[k] - track.value(f"point[{IDS[k]}]")[-1])[axis]
            assert shown[place] == pytest.approx(e)
        heights = sorted(heights_in(panels[axis]))
        sigma = 1000 * np.sqrt(np.diag(joint_covariance())[11 + axis :: 3] / 40)
        np.testing.assert_allclose(heights, np.sort(6 * sigma))
    assert heights_in(panels[3]) == [50, 40, 30, 20, 10]
    tree = zoomable(figure)
    assert not tree["layout"]["shapes"] or all(
        s["type"] == "line" for s in tree["layout"]["shapes"]
    )
    assert sum(t.get("fill") == "toself" for t in tree["data"]) == 4


def test_a_map_without_truth_shows_its_sigmas_and_none_without_points() -> None:
    figure = map_figure([smoothed()], None)
    assert figure is not None
    assert len(figure.axes) == 3
    assert figure.axes[0].get_yscale() == "log"
    alone = replace(smoothed(), statics=None)
    assert map_figure([alone], truth_of_map()) is None


def test_a_broken_filter_does_not_crush_the_figure() -> None:
    good, bad = smoothed(), filtered(40, name="broken")
    assert bad.statics is not None
    bad.statics.P[:] *= 1e6
    figure = map_figure([good, bad], truth_of_map(), SEEN)
    assert figure is not None
    reach = 3000 * np.sqrt(np.diag(joint_covariance())[11:].max() / 40)
    assert figure.axes[0].get_ylim()[1] < 3 * reach
    assert not figure.axes[0].texts  # its bands are off scale, and no error


def content(truth: Truth | None) -> Any:
    """Of a report, as far as the scene reads it."""
    scenario = SimpleNamespace(derived=[], layout=Layout(LAYOUT.moving), sensors={})
    return SimpleNamespace(scenario=scenario, tracks=[filtered(), smoothed()], truth=truth)


def test_the_scene_has_an_ellipsoid_at_each_point() -> None:
    scene = make_scene(content(truth_of_map()))
    assert scene is not None
    assert scene.map_scale is not None
    grey, dots, *_ = scene.figure["frames"][0]["data"]
    cloud = scene.figure["frames"][0]["data"][5]  # after the three axes
    assert len(dots["x"]) == 6  # all that truth knows
    vertices = np.column_stack([cloud[a] for a in "xyz"]).reshape(5, -1, 3)
    track, scale = smoothed(), scene.map_scale
    for k, i in enumerate(IDS):
        e = POINTS[k] - track.value(f"point[{i}]")[-1]
        centre = scene.target_scale * POINTS[k] - scale * e
        P = track.covariance(f"point[{i}]")[-1]
        d = vertices[k] - centre
        size = np.einsum("ni,ij,nj->n", d, np.linalg.inv(P), d)
        np.testing.assert_allclose(np.sqrt(size), 3 * scale, rtol=1e-6)
    assert len(grey["x"]) == 8
    # It turns with the target.
    last = scene.figure["frames"][-1]["data"][5]
    R = truth_of_map().values["target_attitude"][-1]
    turned = np.column_stack([last[a] for a in "xyz"])
    np.testing.assert_allclose(turned, vertices.reshape(-1, 3) @ R.T, atol=1e-9)


def test_the_scene_of_a_map_without_truth() -> None:
    scene = make_scene(content(None))
    assert scene is not None
    assert len(scene.figure["frames"][0]["data"][1]["x"]) == 5


def test_tables_of_the_report_have_one_row_for_the_map_and_one_table_of_the_alignment() -> None:
    found = summary("s", 0, [filtered(), smoothed()], truth_of_map(), [], None, 40)
    table = cells.constants(found)
    assert table is not None
    first = [row[0].text for row in table.rows]
    assert "point, 5 of them [mm]" in first
    assert not [name for name in first if "[3]" in name]
    laid = cells.aligned(found)
    assert laid is not None
    assert list(laid.head) == ["error", "ekf", "batch"]
    rows = {row[0].text: row[2].text for row in laid.rows}
    value = found["estimators"]["batch"]["aligned"]["map_rmse_m"]
    assert rows["map, rmse [m]"] == cells.number(value, 6)
    assert cells.aligned(summary("s", 0, [smoothed()], None, [], None, 40)) is None


def test_a_line_of_a_stream_has_one_entry_for_the_map() -> None:
    x, P = smoothed().states[-1], joint_covariance()
    found = estimate_object(LAYOUT, [], x, P)
    assert set(found) == {
        *("target_attitude", "relative_position", "inertia_matrix_parameters", "point")
    }
    assert found["point"]["id"] == list(IDS)
    assert found["point"]["value"][2] == smoothed().value("point[7]")[-1].tolist()
    np.testing.assert_allclose(found["point"]["sigma"][2], np.sqrt(np.diag(P)[17:20]))
