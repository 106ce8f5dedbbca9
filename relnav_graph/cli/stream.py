"""``relnav stream``: online estimation, JSON lines in and out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import click
import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.cli.shared import check_before_work, show_events, show_progress
from relnav_graph.estimators.online.driver import online
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.streaming.beginning import prior_values
from relnav_graph.streaming.journal import Journal, Policy
from relnav_graph.streaming.lines import Header, header_of
from relnav_graph.streaming.output import Output
from relnav_graph.streaming.run import (
    Interrupted,
    Interrupts,
    JournaledSession,
    journaled_header,
    run,
)
from relnav_graph.streaming.session import Options, Session
from relnav_graph.streaming.sources import Source, open_source


@click.command("stream")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("-e", "--estimator", "kind", default="fixed_lag", show_default=True)
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("--from", "where", default="-", help="File, - (default), or tcp:PORT (loopback).")
@click.option("--follow", is_flag=True, help="Wait at the end of a file for more.")
@click.option("--for", "ends", type=float, help="With --follow: wait so many s at most.")
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="File instead of standard output."
)
@click.option("--journal", "folder", type=click.Path(path_type=Path), help="Folder of the journal.")
@click.option(
    *("--fsync", "policy"),
    type=click.Choice(["always", "interval", "never"]),
    default="interval",
    show_default=True,
    help="When the journal goes to the disk: at each line, each second, when the system likes.",
)
@click.option("--snapshot-every", type=click.IntRange(1), default=1000, show_default=True)
@click.option("--predict-to-now", is_flag=True, help="Add the state at the newest time heard of.")
@click.option("--max-gap", type=float, default=3600.0, show_default=True, help="Between times, s.")
@click.option("--patience", type=float, help="Wait for inputs, s; default: the window.")
@click.option("--settle", type=float, default=0.02, show_default=True, help="Pause, s.")
@click.option("--allow-rejects", is_flag=True, help="Exit with 0 even if lines were refused.")
def command(
    scenario: Path,
    kind: str,
    assignments: tuple[str, ...],
    where: str,
    follow: bool,
    ends: float | None,
    out: Path | None,
    folder: Path | None,
    policy: Policy,
    snapshot_every: int,
    predict_to_now: bool,
    max_gap: float,
    patience: float | None,
    settle: float,
    allow_rejects: bool,
) -> int:
    """Estimate SCENARIO online: JSON lines in, a JSON line out for each epoch.

    The format of both is described in `relnav_graph.streaming.lines`; `relnav simulate SCENARIO
    -o -` writes such lines. An epoch is estimated once its inputs are there and something
    has arrived after it, or nothing for --settle seconds. With --journal, a run that was
    killed goes on where it was.

    Exit codes: 0 all good; 2 the input is wrong; 3 something was refused, or the last
    estimate is not to be trusted; 130 and 143 ended by Ctrl-C and SIGTERM.
    """
    show_events()
    check_before_work((kind,), None)
    loaded = load_scenario(scenario, assignments)  # before anything waits: its errors
    for name, stamps in loaded.stamps.items():
        if stamps.lag > 0 and name in loaded.input_columns:
            show_progress(f"{name}: stamps lag by {stamps.lag:g} s: estimates come that much later")
    digest = hashlib.sha256(json.dumps(loaded.raw, sort_keys=True, default=str).encode())
    identity = {"scenario": scenario.stem, "sha256": digest.hexdigest(), "estimator": kind}
    options = Options(max_gap, patience, predict_to_now)
    interrupts = Interrupts()
    with interrupts.installed(), ExitStack() as stack:
        try:
            journal = None if folder is None else stack.enter_context(Journal(folder, policy))
            source = open_source(where, settle, follow, ends, interrupts)
            incoming = source.lines()
            header, first = _opening(journal, incoming, loaded.file.time.origin)
            session = new_session(
                load_scenario(scenario, assignments, header.settings), kind, header, options
            )
            if journal is not None:
                journal.belongs_to({**identity, "options": vars(options)})
            resumed = journal is not None and bool(journal.snapshot)
            journaled = JournaledSession(session, journal, snapshot_every)
            output = stack.enter_context(closing(Output(out, resumed, interrupts)))
            stack.enter_context(threadpool_limits(1, "blas"))
            stack.enter_context(np.errstate(over="ignore", invalid="ignore"))
            run(journaled, _lines(source, incoming, journaled, first), output, interrupts)
        except Interrupted as stop:
            show_progress(f"ended by {stop}" + ("" if folder is None else "; the journal is whole"))
            return 128 + stop.number
        except BrokenPipeError:
            show_progress("the reader of the output has left")
            return 3
    return _verdict(session, journaled, allow_rejects)


def _opening(
    journal: Journal | None, lines: Iterator[bytes | None], origin: float
) -> tuple[Header, list[bytes]]:
    """The header of the stream, and the first line where it had to be read for that."""
    if journal is not None and journal.snapshot:
        if journal.cut:
            show_progress(
                f"{journal.folder}: the last record was torn; {journal.cut} bytes cut off"
            )
        return journaled_header(journal), []
    first = next((line for line in lines if line is not None), None)
    return (Header(), []) if first is None else (header_of(first, origin), [first])


def _lines(
    source: Source, lines: Iterator[bytes | None], journaled: JournaledSession, first: list[bytes]
) -> Iterator[bytes | None]:
    """All lines, or those that the journal does not have."""
    if not first:
        source.skip(journaled.offset)
    yield from first
    yield from lines


def new_session(scenario: Scenario, kind: str, header: Header, options: Options) -> Session:
    """A session before its first line. Raises InputError when the prior lacks a mean."""
    means = prior_values(header, scenario.layout)
    problem = scenario.problem_at(scenario.prior_with(means, header.t or 0.0))
    measured = [name for name in scenario.measured if name not in means]
    origin = scenario.file.time.origin
    return Session(problem, online(kind, problem), header, options, measured, origin)


def _verdict(session: Session, journaled: JournaledSession, allow_rejects: bool) -> int:
    """Say on standard error what was not used; the exit code."""
    show_progress(f"{session.lines} lines in, {session.seq} out; at last {session.status}")
    if journaled.skipped:
        show_progress(f"{journaled.skipped} lines came again and were skipped")
    for caution in session.cautions:
        show_progress(f"caution: {caution}")
    for sensor, counts in session.rejected.items():
        show_progress(
            f"{sensor}: not used: " + ", ".join(f"{n} {why}" for why, n in counts.items())
        )
    refused = any(why != "downweighted" for counts in session.rejected.values() for why in counts)
    return 3 if session.status != "OK" or (refused and not allow_rejects) else 0
