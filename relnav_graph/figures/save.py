"""Figures as files, and all figures of a pass."""

from __future__ import annotations

import io
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure
from PIL import Image

from relnav_graph.core.contracts import Derived
from relnav_graph.core.track import Track, Truth
from relnav_graph.figures.consistency import consistency_figure, residual_figure
from relnav_graph.figures.maps import map_figure
from relnav_graph.figures.states import error_figures
from relnav_graph.figures.style import COLUMN, PAGE, STYLE, Look
from relnav_graph.figures.trajectory import trajectory_figure
from relnav_graph.figures.twice import Drawn

__all__ = ["pass_figures", "png", "save_figures", "save_pass"]

#: Dots per inch of an image: 1050 for a page's width.
_DPI = 150
#: Colours of an image: without a visible difference, a third of the size, in half the time.
_COLOURS = 128
#: Of zlib: 6 takes half as long again, for a tenth of the size.
_COMPRESSION = 4


@contextmanager
def _drawn(figure: Figure, dpi: int = _DPI) -> Iterator[Drawn]:
    """The figure as it is drawn at so many dots per inch, which hold as long as it is used."""
    before = figure.dpi
    figure.set_dpi(dpi)
    try:
        yield Drawn(figure)
    finally:
        figure.set_dpi(before)


def png(figure: Figure, transparent: bool = False, dpi: int = _DPI) -> bytes:
    """A figure as a PNG image with a palette."""
    patch = figure.patch.get_alpha()
    if transparent:
        figure.patch.set_alpha(0.0)
    try:
        with _drawn(figure, dpi) as drawn:
            return _packed(drawn, transparent)
    finally:
        figure.patch.set_alpha(patch)


def _packed(drawn: Drawn, transparent: bool = False) -> bytes:
    picture, out = drawn.image(), io.BytesIO()
    few = (picture if transparent else picture.convert("RGB")).quantize(
        _COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
    )
    few.save(out, "PNG", compress_level=_COMPRESSION, dpi=(drawn.dpi, drawn.dpi))
    return out.getvalue()


def _vector(figure: Figure, suffix: str) -> bytes:
    out = io.BytesIO()
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}[suffix]
    figure.savefig(out, format=suffix, dpi=_DPI, metadata=metadata)
    return out.getvalue()


def _files(figure: Figure, formats: Collection[str]) -> dict[str, bytes]:
    """The files of a figure by their formats; image and SVG are drawn at once."""
    if not {"png", "svg"} & set(formats):
        return {suffix: _vector(figure, suffix) for suffix in formats}
    with _drawn(figure) as drawn:
        made: dict[str, Callable[[Drawn], bytes]] = {"png": _packed}
        made |= {"svg": Drawn.svg} if drawn.whole else {}
        found = {suffix: made[suffix](drawn) for suffix in formats if suffix in made}
    return found | {f: _vector(figure, f) for f in formats if f not in found}


def save_figures(
    figures: Mapping[str, Figure], folder: Path | str, formats: Collection[str] = ("svg", "png")
) -> list[Path]:
    """Write NAME.FORMAT of each figure, of svg, png and pdf; gives the paths.

    The files hold no date and no random identifiers: the same figure gives the same file.
    """
    paths = []
    Path(folder).mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        for name, figure in figures.items():
            for suffix, content in _files(figure, formats).items():
                path = Path(folder) / f"{name}.{suffix}"
                path.write_bytes(content)
                paths.append(path)
    return paths


def pass_figures(
    tracks: Iterable[Track],
    truth: Truth | None,
    derived: Sequence[Derived],
    seen: Mapping[str, int] | None = None,
    draw: Sequence[str] = (),
    look: Look = PAGE,
) -> dict[str, Figure]:
    """All figures of a pass, by name: each state, trajectory, map, consistency, and, where no truth
    is known, residuals. seen, draw: see `map_figure`, `chosen_rows`. Raises InputError."""
    tracks = list(tracks)
    figures = error_figures(tracks, truth, derived, draw, look)
    others = {
        "trajectory": trajectory_figure(tracks, truth, derived, draw, look),
        "map": map_figure(tracks, truth, seen, draw, look),
        "consistency": consistency_figure(tracks, truth, derived, draw, look),
    }
    if truth is None and not any(track.truth for track in tracks):
        others["residuals"] = residual_figure(tracks, draw, look)
    return figures | {name: figure for name, figure in others.items() if figure is not None}


def save_pass(
    tracks: Iterable[Track],
    truth: Truth | None,
    derived: Sequence[Derived],
    folder: Path | str,
    seen: Mapping[str, int] | None = None,
    draw: Sequence[str] = (),
    formats: Collection[str] = ("svg", "png"),
) -> list[Path]:
    """Draw and write all figures of a pass; a PDF is as wide as a column of a paper, 85 mm, and has
    no title, since a caption stands below it there. Raises InputError."""
    tracks, paths = list(tracks), list[Path]()
    for look, own in ((PAGE, [f for f in formats if f != "pdf"]), (COLUMN, ["pdf"])):
        if set(own) & set(formats):
            figures = pass_figures(tracks, truth, derived, seen, draw, look)
            paths += save_figures(figures, folder, own)
    return paths
