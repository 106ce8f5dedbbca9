"""How nouns show themselves: a few lines, as text and, in notebooks, as a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from textwrap import wrap

from relnav_graph.arrays import Array

__all__ = ["Shown", "listed", "span"]

#: Characters of a line of what is shown.
WIDTH = 96


def listed(names: Iterable[str], most: int = 6) -> str:
    """Names, and how many more there are than a line holds."""
    given = list(names)
    rest = f", ... ({len(given)})" if len(given) > most else ""
    return (", ".join(given[:most]) + rest) or "none"


def span(t: Array) -> str:
    """How many epochs at times t (N,), s, and from when to when."""
    return f"{len(t)} epochs, {t[0]:.9g} s to {t[-1]:.9g} s" if len(t) else "no epochs"


class Shown:
    """Mixin: `__repr__` and, for notebooks, `_repr_html_` made of a title and a few rows."""

    def _shown(self) -> tuple[str, Mapping[str, str]]:
        """A title, and rows of a name and what there is to say."""
        raise NotImplementedError

    def _doubts(self) -> Iterable[object]:
        """Cautions, which are shown in full."""
        return ()

    def __repr__(self) -> str:
        title, rows = self._shown()
        width = max(map(len, rows), default=0)
        lines = [title, *(f"  {name:{width}}  {text}" for name, text in rows.items())]
        lines = [x if len(x) <= WIDTH else x[: WIDTH - 3] + "..." for x in lines]
        for doubt in self._doubts():
            lines += wrap(f"caution: {doubt}", WIDTH, initial_indent="  ", subsequent_indent="    ")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        title, rows = self._shown()
        cells = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th>"
            f"<td style='text-align:left'>{escape(text)}</td></tr>"
            for name, text in (*rows.items(), *(("caution", str(c)) for c in self._doubts()))
        )
        return f"<b>{escape(title)}</b><table>{cells}</table>"
