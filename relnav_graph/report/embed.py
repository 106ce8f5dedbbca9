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

from relnav_graph.plots import STYLE

__all__ = ["encode", "image"]

_DPI = 160


def _svg(figure: Figure) -> bytes:
    stream = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(stream, format="svg", metadata=nothing, transparent=True)
    text = stream.getvalue()
    # Without the prologue, which names a document type elsewhere.
    return text[text.index("<svg") :].encode()


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})
    return stream.getvalue()


def image(figure: Figure) -> str:
    """A figure as the address of an image that is its own content: SVG, or PNG where that
    is smaller."""
    with mpl.rc_context(STYLE):
        choices = {"image/svg+xml": _svg(figure), "image/png": _png(figure)}
    kind = min(choices, key=lambda k: len(choices[k]))
    return f"data:{kind};base64,{base64.b64encode(choices[kind]).decode()}"


def _plain(value: Any) -> Any:
    """Arrays as plotly's typed arrays of single precision: finer than any screen."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "iu":
            return {"dtype": "i4", "bdata": base64.b64encode(value.astype("<i4")).decode()}
        return {"dtype": "f4", "bdata": base64.b64encode(value.astype("<f4")).decode()}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot encode {type(value)}")


def encode(tree: Mapping[str, Any]) -> str:
    """A figure of plotly as JSON that can stand in a script element."""
    return re.sub("<", "\\\\u003c", json.dumps(tree, default=_plain, separators=(",", ":")))
