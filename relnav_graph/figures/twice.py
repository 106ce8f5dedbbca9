"""A figure drawn once, as an image and as an SVG.

Half of the time that matplotlib takes goes into where things are: ticks, limits, the sizes of
texts. So the renderer of the image notes what it is told to draw, and an SVG is written from that.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.textpath import text_to_path
from matplotlib.transforms import Affine2D
from PIL import Image

__all__ = ["Drawn"]

#: Sizes of texts by what they say, how, and at which dots per inch; many figures share them.
_SIZES: dict[Any, tuple[float, float, float]] = {}
_POINTS_PER_INCH = 72.0
#: Which argument of `draw_path_collection` the widths of its lines are.
_WIDTHS = 8


def _plain(prop: FontProperties) -> FontProperties:
    """Of the size of outlines."""
    own = prop.copy()
    own.set_size(text_to_path.FONT_SCALE)
    return own


@lru_cache(1000)
def _outline(s: str, prop: FontProperties) -> tuple[Path, tuple[float, float, float]]:
    """A text with mathematics, of a font as `_plain` gives it, and its width, height, descent.

    Piece by piece: to take a sentence apart as mathematics takes longer than all the rest.
    """
    paths, x, above, below = list[Path](), 0.0, 0.0, 0.0
    for k, part in enumerate(s.split("$")):
        if part:
            math, text = bool(k % 2), f"${part}$" if k % 2 else part
            vertices, codes = text_to_path.get_text_path(prop, text, math)
            paths.append(Path(np.add(np.reshape(vertices, (-1, 2)), (x, 0.0)), codes))
            # Spaces at an end are no part of the size of a text.
            measured = text if math else f"|{text}|"
            width, height, down = text_to_path.get_text_width_height_descent(measured, prop, math)
            if not math:
                width -= text_to_path.get_text_width_height_descent("||", prop, False)[0]
            x, above, below = x + width, max(above, height - down), max(below, down)
    return Path.make_compound_path(*paths), (x, above + below, below)


def _scaled(gc: Any, larger: float) -> Any:
    """How to draw, with lines of so many times the width, in points."""
    own = type(gc)()
    own.copy_properties(gc)
    own.set_linewidth(larger * gc.get_linewidth())
    begin, dashes = gc.get_dashes()
    if dashes is not None:
        own.set_dashes(larger * begin, [larger * dash for dash in dashes])
    return own


class Drawn(RendererAgg):
    """An image of a figure, at its own dots per inch, and what was drawn of it.

    whole: whether an SVG can be written from that; a part that is to be an image in it cannot.
    """

    def __init__(self, figure: Figure) -> None:
        size = figure.bbox.size
        super().__init__(int(size[0]), int(size[1]), figure.dpi)  # type: ignore[no-untyped-call]
        self.whole = True
        self._inches = figure.get_size_inches()
        self._notes: list[tuple[str, tuple[Any, ...]]] = []
        # The base has made methods of C of these.
        for name in ("draw_markers", "draw_path_collection"):
            setattr(self, name, self._noting(name, getattr(self, name)))
        figure.draw(self)

    def _noting(self, name: str, draw: Callable[..., None]) -> Callable[..., None]:
        def method(*args: Any, **kwargs: Any) -> None:
            self._notes.append((name, args))
            if name == "draw_path_collection" and any(args[_WIDTHS]):
                self.whole = False  # its lines have widths of their own, in points
            draw(*args, **kwargs)

        return method

    def start_rasterizing(self) -> None:
        self.whole = False

    def draw_image(self, *args: Any, **kwargs: Any) -> None:
        self.whole = False
        self._renderer.draw_image(*args, **kwargs)

    def draw_path(self, gc: Any, path: Any, transform: Any, rgbFace: Any = None) -> None:
        self._notes.append(("draw_path", (gc, path, transform, rgbFace)))
        super().draw_path(gc, path, transform, rgbFace)  # type: ignore[no-untyped-call]

    def get_text_width_height_descent(self, s: str, prop: Any, ismath: Any) -> Any:
        key = (s, prop, ismath, self.dpi)
        if key not in _SIZES:
            base: Any = super()
            if ismath:
                width, height, below = _outline(s, _plain(prop))[1]
                scale = self._scale(prop)
                _SIZES[key] = scale * width, scale * height, scale * below
            else:
                _SIZES[key] = base.get_text_width_height_descent(s, prop, ismath)
        return _SIZES[key]

    def _scale(self, prop: Any) -> float:
        """Dots per unit of an outline."""
        points = float(prop.get_size_in_points())
        return float(points * self.dpi / _POINTS_PER_INCH / text_to_path.FONT_SCALE)

    def draw_text(
        self,
        gc: Any,
        x: float,
        y: float,
        s: str,
        prop: Any,
        angle: float,
        ismath: Any = False,
        mtext: Any = None,
    ) -> None:
        """Draw a text, with mathematics as an outline, which is the same in every size."""
        if not ismath:
            self._notes.append(("draw_text", (gc, x, y, s, prop, angle)))
            base: Any = super()
            base.draw_text(gc, x, y, s, prop, angle, False, mtext)
            return
        place = Affine2D().scale(self._scale(prop)).rotate_deg(angle)
        gc.set_linewidth(0.0)
        outline = _outline(s, _plain(prop))[0]
        self.draw_path(gc, outline, place.translate(x, self.height - y), gc.get_rgb())

    def image(self) -> Image.Image:
        """What was drawn, in red, green, blue and opacity."""
        size = int(self.width), int(self.height)
        buffer = self.buffer_rgba()  # type: ignore[no-untyped-call]
        return Image.frombuffer("RGBA", size, buffer, "raw", "RGBA", 0, 1)

    def svg(self) -> bytes:
        """What was drawn as an SVG, in units of the image's dots."""
        out = io.StringIO()
        width, height = self._inches * self.dpi
        writer: Any = RendererSVG
        renderer = writer(width, height, out, metadata={"Date": None})
        larger = self.dpi / _POINTS_PER_INCH
        for name, (gc, *args) in self._notes:
            if name == "draw_text":
                args[3] = args[3].copy()
                args[3].set_size(larger * args[3].get_size_in_points())
            getattr(renderer, name)(_scaled(gc, larger), *args)
        renderer.finalize()
        head, rest = out.getvalue().split("viewBox", 1)
        for name, inches in zip(("width", "height"), self._inches, strict=True):
            before, _, after = head.partition(f'{name}="')
            points = f"{_POINTS_PER_INCH * inches:.6g}pt"
            head = f'{before}{name}="{points}"{after.partition(chr(34))[2]}'
        return f"{head}viewBox{rest}".encode()
