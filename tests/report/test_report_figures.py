"""Figures and numbers of the report, by themselves."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from relnav_graph.maths import so3
from relnav_graph.report import bodies, cells
from relnav_graph.report.embed import encode
from relnav_graph.report.page import Gallery
from relnav_graph.report.zoom import zoomable


def test_figures_that_do_not_fit_stay_images() -> None:
    gallery, figures = Gallery(), [Figure(), Figure(), Figure()]
    for figure, count in zip(figures, (10, 1000, 100), strict=True):
        figure.subplots().plot(np.arange(count))
        gallery.add("title", "caption", figure)
    assert list(gallery.zoomed(10**6)) == ["figure-1", "figure-2", "figure-3"]
    room = gallery.taken + len(encode(zoomable(figures[1])))
    found = gallery.zoomed(room)
    assert list(found) == ["figure-1", "figure-3"]
    assert gallery.taken + sum(map(len, found.values())) < room


def test_a_zoomable_figure_holds_what_was_drawn() -> None:
    figure = Figure(figsize=(7, 3), layout="constrained")
    first, second = figure.subplots(1, 2, sharey=True)
    t, y = np.arange(5.0), np.array([1.0, 10.0, np.nan, 1000.0, 2.0])
    first.semilogy(t, y, color="#D55E00", label="iekf", linestyle="--")
    first.axhline(1, color="0.4")
    second.axhspan(0.5, 2, color="0.5")
    second.set(xlim=(4, 0), title="x")
    second.set_title("smoothed", loc="left")
    second.set_xlabel("$x_{t}$ [m]")
    figure.legend(handles=first.lines[:1])
    found = zoomable(figure)
    entry, line = found["data"]
    assert (entry["name"], entry["showlegend"]) == ("iekf", True)
    assert (line["legendgroup"], line["x0"], line["dx"]) == ("iekf", 0.0, 1.0)
    np.testing.assert_array_equal(line["y"], y)
    assert line["line"]["color"] == "rgba(213,94,0,1.00)"
    assert line["line"]["dash"] == "dash"
    layout = found["layout"]
    assert layout["yaxis"]["type"] == "log"
    np.testing.assert_allclose(layout["yaxis"]["range"], np.log10(first.get_ylim()))
    assert layout["xaxis2"]["range"] == [4.0, 0.0]
    assert layout["yaxis2"]["matches"] == "y"
    assert layout["xaxis2"]["title"]["text"] == "<i>x<sub>t</sub></i> [m]"
    assert [s["type"] for s in layout["shapes"]] == ["line", "rect"]
    assert [s["yref"] for s in layout["shapes"]] == ["y", "y2"]
    assert [a["text"] for a in layout["annotations"]] == ["smoothed"]


def test_a_long_pass_is_thinned_for_zooming() -> None:
    figure = Figure()
    ax = figure.subplots()
    t = np.linspace(0, 1e5, 100_001)
    ax.plot(t, np.sin(t))
    ax.fill_between(t, -1, np.cos(t))
    (line,) = zoomable(figure)["data"]
    assert 500 < len(line["y"]) <= 1000
    assert line["dx"] == pytest.approx(t[-1] / (len(line["y"]) - 1), rel=0.01)


def test_ellipsoids_are_three_sigma_about_their_centres() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(2, 3, 3))
    P, centres = A @ A.transpose(0, 2, 1), rng.normal(size=(2, 3))
    mesh = bodies.ellipsoids(centres, P, 10.0)
    vertices = np.column_stack([mesh[a] for a in "xyz"]).reshape(2, -1, 3)
    d = (vertices - centres[:, None]) / 10
    square = np.einsum("kmi,kij,kmj->km", d, np.linalg.inv(P), d)
    np.testing.assert_allclose(square, 9)
    faces = np.column_stack([mesh[a] for a in "ijk"])
    assert faces.max() == vertices.shape[0] * vertices.shape[1] - 1


def test_cones_hold_the_axes_within_three_sigma() -> None:
    rng = np.random.default_rng(1)
    A, R, sigma = rng.normal(size=(3, 3)), so3.exp(rng.normal(size=3)), 1e-4
    P = sigma**2 * (A @ A.T)
    mesh = bodies.cones(R, P, 10.0, 2.0)
    vertices = np.column_stack([mesh[a] for a in "xyz"]) @ R / 2.0
    for axis, rim in enumerate(np.split(vertices[1:], 3)):
        e, L = np.eye(3)[axis], np.linalg.cholesky(P)
        # Turned by errors of up to three sigmas, the axis comes as far as the rim, and no farther.
        turns = rng.normal(size=(4000, 3))
        turns = 30 * turns / np.linalg.norm(turns, axis=1)[:, None] @ L.T
        turned = np.array([np.cross(turn, e) for turn in turns])
        for direction in np.delete(np.eye(3), axis, axis=0):
            farthest = (turned @ direction).max()
            assert ((rim - e) @ direction).max() == pytest.approx(farthest, rel=0.04)
    faces = np.column_stack([mesh[a] for a in "ijk"])
    assert (faces.min(), faces.max()) == (0, len(vertices) - 1)


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (0.0, "0"), (1234.5678, "1235"), (-0.012345, "−0.01235"), (3.2e-9, "3.2·10⁻⁹"),
     (1.5e7, "1.5·10⁷")],
)  # fmt: skip
def test_numbers_have_few_digits(value: float | None, text: str) -> None:
    assert cells.number(value) == text
