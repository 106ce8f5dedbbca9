"""Tables as plain text."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["aligned_columns", "with_unit"]


def aligned_columns(header: str, rows: Sequence[Sequence[str]]) -> list[str]:
    """Columns named in `header` (split at "|"), words to the left, numbers to the right.

    A column is at least as wide as its name; one whose name ends in a space is of words.
    """
    names = header.split("|")
    table = [[name.strip() for name in names], *rows]
    widths = [max(map(len, column)) for column in zip(names, *table, strict=True)]
    return [
        "  ".join(
            text.ljust(width) if name.endswith(" ") else text.rjust(width)
            for name, width, text in zip(names, widths, row, strict=True)
        ).rstrip()
        for row in table
    ]


def with_unit(name: str, unit: str) -> str:
    """A name with its unit in brackets, where it has one."""
    return name if unit == "1" else f"{name} [{unit}]"
