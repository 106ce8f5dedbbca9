"""Figures as parts of the page: an image always, and a zoomable one with plotly."""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from relnav_graph.figures import STYLE

__all__ = ["encode", "image"]

_DPI = 200
#: In the palette: a third of the size of full colour, without a visible difference.
_COLOURS = 128


def image(figure: Figure) -> str:
    """A figure as a data URL of a PNG image, with a palette and a transparent background.

    Of these figures, with a thousand points and shaded bands, it has a fifth of the size of
    an SVG.
    """
    full, small = io.BytesIO(), io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # placed once: it takes longer than drawing
        figure.savefig(full, format="png", dpi=_DPI, transparent=True)
    with Image.open(full) as picture:
        palette = picture.quantize(
            _COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
        )
        palette.save(small, "PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(small.getvalue()).decode()}"


def _plain(value: Any) -> Any:
    """Arrays as plotly's typed arrays of single precision: finer than any screen."""
    if isinstance(value, np.ndarray):
        kind = "i4" if value.dtype.kind in "iu" else "f4"
        return {
            "dtype": kind,
            "bdata": base64.b64encode(value.astype(f"<{kind}").tobytes()).decode(),
        }
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot encode {type(value)}")


def encode(tree: Mapping[str, Any]) -> str:
    """A figure of plotly as JSON that can stand in a script element."""
    text = json.dumps(tree, default=_plain, separators=(",", ":"), allow_nan=False)
    return re.sub("<", "\\\\u003c", text)
