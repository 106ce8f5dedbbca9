"""Drawings of the conventions: ``python docs/drawings.py`` writes docs/_static/*.svg."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, Polygon, Rectangle

STATIC = Path(__file__).parent / "_static"
INK, PALE = "#333333", "#8a8f98"
COLOURS = {"i": "#5b6472", "o": "#1b6ca8", "t": "#c4572a", "c": "#2f8f5b", "s": "#8e44ad"}


Point = tuple[float, float]


def _arrow(ax: Axes, a: Point, b: Point, colour: str, width: float = 1.6) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", xy=b, xytext=a, arrowprops=style)


def _axes(ax: Axes, at: Point, turn: float, size: float, name: str) -> None:
    """The x and y axis of a frame, turned by `turn`, deg; z is out of the page."""
    for k, letter in enumerate("xy"):
        a = np.radians(turn + 90 * k)
        tip, label = (
            (at[0] + r * float(np.cos(a)), at[1] + r * float(np.sin(a))) for r in (size, size + 0.2)
        )
        _arrow(ax, at, tip, COLOURS[name])
        ax.text(*label, f"${letter}_{name}$", color=COLOURS[name], ha="center", va="center")


def _blank(width: float, height: float) -> tuple[Figure, Axes]:
    fig, ax = plt.subplots(figsize=(width, height))
    ax.set_aspect("equal")
    ax.axis("off")
    return fig, ax


def frames() -> Figure:
    """Earth, target, chaser, their frames, and the vectors between them."""
    fig, ax = _blank(8.0, 4.8)
    earth, target, chaser = (0.0, 0.0), (4.2, 2.6), (8.3, 2.9)
    ax.add_patch(Circle(earth, 0.8, color="#dce9f4", ec=COLOURS["i"], lw=1))
    ax.text(-0.42, -0.4, "Earth", color=PALE, ha="center", fontsize=9)
    _axes(ax, earth, 0, 1.5, "i")
    radius, out = np.hypot(*target), np.degrees(np.arctan2(target[1], target[0]))
    arc = np.radians(np.linspace(out - 34, out + 26, 60))
    ax.plot(radius * np.cos(arc), radius * np.sin(arc), color=PALE, lw=1, ls=(0, (4, 3)))
    ax.text(5.2, 0.2, "orbit of the target", color=PALE, fontsize=9)
    box = Rectangle((-0.42, -0.27), 0.84, 0.54, fc="#f7e3da", ec=COLOURS["t"], lw=1.2)
    box.set_transform(mpl.transforms.Affine2D().rotate_deg(78).translate(*target) + ax.transData)
    ax.add_patch(box)
    _axes(ax, target, out, 1.45, "o")
    _axes(ax, target, 78, 1.1, "t")
    body = Polygon([(-0.35, -0.25), (0.35, -0.25), (0.35, 0.25), (-0.35, 0.25)], closed=True)
    body.set(fc="#dff1e6", ec=COLOURS["c"], lw=1.2)
    body.set_transform(mpl.transforms.Affine2D().rotate_deg(20).translate(*chaser) + ax.transData)
    ax.add_patch(body)
    _axes(ax, chaser, 20, 1.1, "c")
    sensor = (8.1, 2.6)
    ax.add_patch(Circle(sensor, 0.07, color=COLOURS["s"]))
    _axes(ax, sensor, 200, 0.85, "s")
    _arrow(ax, earth, target, INK, 1.1)
    ax.text(2.3, 1.0, "$r_t$, in $i$", color=INK, fontsize=10)
    _arrow(ax, target, chaser, INK, 2.0)
    ax.text(6.0, 3.0, "$r_{tc}$, in $o$", color=INK, fontsize=11)
    ax.text(4.55, 2.05, "target", color=COLOURS["t"], fontsize=9)
    ax.text(8.75, 2.3, "chaser", color=COLOURS["c"], fontsize=9)
    ax.text(0.0, -1.5, "$z$ axes point out of the page: of $o$ the orbit normal.", color=PALE)
    ax.set_xlim(-1.2, 9.8)
    ax.set_ylim(-1.8, 4.8)
    return fig


def perturbation() -> Figure:
    """An attitude, its estimate, and the small rotation between."""
    fig, ax = _blank(8.0, 2.4)
    for at, turn, name, text in (
        ((0.0, 0.0), 0, "o", "reference"),
        ((3.0, 0.0), 35, "c", r"estimate, $\hat R_{oc}$"),
        ((6.4, 0.0), 35, "c", r"truth, $R_{oc} = \hat R_{oc}\,\mathrm{Exp}(d)$"),
    ):
        ax.text(at[0] + 0.3, -0.6, text, ha="center", color=INK, fontsize=10)
        if at[0] > 6:
            _axes(ax, at, 50, 1.4, name)
            for a in np.radians([35, 125]):
                tip = (at[0] + 1.3 * np.cos(a), at[1] + 1.3 * np.sin(a))
                ax.plot([at[0], tip[0]], [at[1], tip[1]], color=PALE, ls=(0, (3, 3)), lw=1)
            ax.add_patch(
                mpl.patches.Arc(at, 2.0, 2.0, theta1=35, theta2=50, color=COLOURS["t"], lw=2)
            )
            ax.text(at[0] + 0.92, 0.82, "$d$", color=COLOURS["t"], fontsize=12)
        else:
            _axes(ax, at, turn, 1.4, name)
    ellipse = Ellipse((10.4, 0.6), 1.4, 0.6, angle=20, fc="#f7e3da", ec=COLOURS["t"])
    ax.add_patch(ellipse)
    ax.text(10.4, -0.6, "covariance of $d$:\nin axes of $c$", ha="center", va="center", fontsize=10)
    ax.set_xlim(-1.2, 11.8)
    ax.set_ylim(-1.0, 2.0)
    return fig


def main() -> None:
    """Write both, without dates, so that the same code gives the same file."""
    mpl.rcParams.update({"svg.hashsalt": "relnav", "font.size": 11, "svg.fonttype": "path"})
    for draw in (frames, perturbation):
        fig = draw()
        path = STATIC / f"{draw.__name__}.svg"
        fig.savefig(path, metadata={"Date": None}, bbox_inches="tight", facecolor="white")
        plt.close(fig)
        print(path)


if __name__ == "__main__":
    main()
