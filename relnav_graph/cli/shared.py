"""What the commands share: messages, checks before work, exit codes."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from relnav_graph.errors import InputError
from relnav_graph.estimators import find_estimator
from relnav_graph.files import printable
from relnav_graph.runs.outputs import Drawing
from relnav_graph.scoring.text import table as comparison_table

__all__ = [
    "check_before_work",
    "check_fragment",
    "command_line",
    "drawing",
    "drawing_options",
    "report",
    "show_events",
    "show_progress",
]


class _Events(logging.Handler):
    """What the library says of its progress, as lines on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        click.echo(record.getMessage(), err=True)


def show_progress(text: str) -> None:
    """One line on standard error, for work that takes seconds."""
    click.echo(text, err=True)


def show_events() -> None:
    """Show what the library says from now on."""
    logger = logging.getLogger("relnav_graph")
    if not any(isinstance(h, _Events) for h in logger.handlers):
        logger.addHandler(_Events())
        logger.setLevel(logging.INFO)


def drawing_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options `draw` and `formats` of a command that draws figures."""
    draw = click.option(
        "--draw",
        multiple=True,
        metavar="NAME",
        help="Row to draw, may be repeated; by default at most three that tell most.",
    )
    figures = click.option(
        "--figures",
        "formats",
        multiple=True,
        type=click.Choice(["png", "svg", "pdf", "none"]),
        help="Format of figures, may be repeated: pdf is as wide as a column, 85 mm.",
    )
    return draw(figures(command))


def drawing(
    draw: Sequence[str], formats: Sequence[str], kinds: Sequence[str], usual: Sequence[str]
) -> Drawing:
    """What the options say: rows to draw, of estimators `kinds`, in formats, `usual` without any.

    Raises InputError, before any work, on a row that no estimator has.
    """
    known = [name for kind in kinds for name in (kind, f"{kind}_smoothed")]
    missing = [name for name in draw if name not in known]
    if missing:
        raise InputError(
            f"--draw: found {missing[0]!r}, expected an estimator of this pass: {', '.join(kinds)},"
            " or its row NAME_smoothed"
        )
    chosen = dict.fromkeys(formats or usual)
    return Drawing(tuple(draw), tuple(f for f in chosen if f != "none"))


def command_line() -> str:
    """What the user typed, for manifests."""
    return printable(str(click.get_current_context().obj or ""))


def check_before_work(kinds: Sequence[str], out: Path | None) -> None:
    """Refuse, before any work, estimators that do not exist and folders that cannot be.

    Raises ModelError or InputError.
    """
    for kind in kinds:
        find_estimator(kind)
    if out is not None and out.exists() and not out.is_dir():
        raise InputError(f"-o {out}: is a file, expected a folder")


def check_fragment(out: Path | None, mark: str) -> None:
    """Refuse, before any work, to write a fragment of a scenario over a file that does not begin
    with `mark`, as the fragments of its kind do. Raises InputError."""
    if out is None or not out.exists():
        return
    if out.is_dir():
        raise InputError(f"-o {out}: is a folder, expected a file")
    if not out.read_bytes().startswith(mark.encode()):
        raise InputError(
            f"-o {out}: found a file that this command did not write, expected one that begins with"
            f" {mark!r}; it stays as it is"
        )


def report(
    found: dict[str, Any], as_json: bool, table: Callable[[dict[str, Any]], str] = comparison_table
) -> int:
    """Print the summary; the exit code, 3 when an estimate is not to be trusted."""
    click.echo(json.dumps(found, allow_nan=False) if as_json else table(found))
    bad = [n for n, row in found["estimators"].items() if row["status"] != "ok"]
    for name in bad:
        row = found["estimators"][name]
        click.echo(f"{name}: {row['status']}: {row['message']}", err=True)
    return 3 if bad or found.get("failed") else 0
