"""Figures of a pass: errors with three-sigma bands, or estimates; the trajectory, the map, and what
tells whether the estimates know how good they are.

Figures are built as objects, without pyplot, so that no global state is touched.
"""

from relnav_graph.figures.consistency import consistency_figure, residual_figure
from relnav_graph.figures.maps import map_figure
from relnav_graph.figures.save import pass_figures, png, save_figures, save_pass
from relnav_graph.figures.states import error_figures
from relnav_graph.figures.style import (
    COLUMN,
    PAGE,
    STYLE,
    WIDTH,
    Look,
    chosen_rows,
    row_styles,
    symbol,
)
from relnav_graph.figures.trajectory import trajectory_figure

__all__ = [
    "COLUMN",
    "PAGE",
    "STYLE",
    "WIDTH",
    "Look",
    "chosen_rows",
    "consistency_figure",
    "error_figures",
    "map_figure",
    "pass_figures",
    "png",
    "residual_figure",
    "row_styles",
    "save_figures",
    "save_pass",
    "symbol",
    "trajectory_figure",
]
