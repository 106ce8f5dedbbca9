"""The command line: ``relnav COMMAND``. Commands load at their first use."""

from __future__ import annotations

import importlib
import os
import shlex
import signal
import sys
from typing import Any

import click

from relnav_graph.constants import VERSION

__all__ = ["main"]

#: Command, and what ``relnav --help`` says of it: its module is loaded only when it runs.
COMMANDS = {
    "compare": "Run several estimators on the same pass and score them.",
    "simulate": "Simulate a scenario into a data set.",
    "stream": "Estimate online: JSON lines in, JSON lines out.",
    "smooth": "Smooth the recorded pass of a data set.",
    "explain": "Say, before any data, what the sensors of a scenario can tell.",
    "study": "Make many runs of a scenario and say what they show together.",
    "tune": "Find noise parameters from the residuals of a pass.",
    "report": "Write one HTML file on a study or a comparison.",
    "calibrate": "Find how sensors are mounted, and how late inputs are.",
    "validate": "Check a scenario or a data set: every error, with its path.",
    "check": "Check that a model, yours or one of ours, keeps its contract.",
    "list": "List models, estimators, truths, readers and scenarios.",
    "convert": "Convert between data folders, data sets and results.",
}


class _ReaderLeft(Exception):
    """Standard output is read no more. Not an OSError: click has an answer to that of its own."""


class _Lazy(click.Group):
    def invoke(self, ctx: click.Context) -> Any:
        try:
            code = super().invoke(ctx)
            sys.stdout.flush()
            return code
        except BrokenPipeError as error:
            raise _ReaderLeft from error

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        # Modules of these names would hide a builtin and a function from their own package.
        name = {"list": "listing", "report": "reporting"}.get(cmd_name, cmd_name)
        module = importlib.import_module(f"relnav_graph.cli.{name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="relnav")
def _relnav() -> None:
    """Relative navigation: factor-graph smoothing compared with Kalman filters.

    Exit codes: 0 all good; 2 the input is wrong; 3 an estimate is degraded or diverged
    (results are still written, and marked); 141 the reader of the output has left.
    """


def _complete_descriptors() -> None:
    """Put something in the place of a standard stream that the caller has closed.

    Otherwise the next file to be opened, a journal say, would be taken for it. Where output
    would go, what takes none: so it fails when something is written, and is not lost unsaid.
    """
    for descriptor, flags in (0, os.O_WRONLY), (1, os.O_RDONLY), (2, os.O_WRONLY):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, flags)  # takes the lowest number that is free
            if descriptor == 1:
                sys.stdout = os.fdopen(1, "w", encoding="utf-8")


def _give_up_output() -> None:
    """The last flush of standard output is not to complain of what was said already."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(argv: list[str] | None = None) -> Any:
    """Run the command line; errors of the input end with exit code 2."""
    from relnav_graph.errors import RelnavError

    _complete_descriptors()
    # Commands draw into files alone. A backend that a notebook has named for its processes, and
    # whose package is not here, would end matplotlib's import.
    os.environ["MPLBACKEND"] = "agg"
    given = sys.argv[1:] if argv is None else argv
    for argument in given:  # names and the command itself stand in what a run leaves
        try:
            argument.encode()
        except UnicodeEncodeError:
            click.echo(f"error: found {os.fsencode(argument)!r}, expected UTF-8", err=True)
            sys.exit(2)
    try:
        code = _relnav.main(
            argv, prog_name="relnav", standalone_mode=False, obj=shlex.join(["relnav", *given])
        )
    except click.Abort as stop:
        if isinstance(stop.__cause__, EOFError):  # click takes it for a person's Ctrl-D
            raise stop.__cause__ from None
        click.echo("interrupted", err=True)
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except RelnavError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(2)
    except _ReaderLeft:
        _give_up_output()  # quietly, as a filter does whom SIGPIPE ends
        sys.exit(128 + signal.SIGPIPE)
    except OSError as error:
        click.echo(f"error: {error}", err=True)
        _give_up_output()
        sys.exit(2)
    except MemoryError as error:
        click.echo(f"error: not enough memory: {error or 'none left'}", err=True)
        sys.exit(2)
    except ImportError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # while a library was loading
            raise
        click.echo("interrupted", err=True)
        sys.exit(130)
    sys.exit(code if isinstance(code, int) else 0)
