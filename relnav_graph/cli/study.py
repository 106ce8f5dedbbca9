"""``relnav study``: many runs of one scenario, and what they show together."""

from __future__ import annotations

import json
import os
import shlex
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import click

from relnav_graph.cli.progress import study_progress
from relnav_graph.cli.shared import check_before_work, report, show_events, show_progress
from relnav_graph.errors import InputError
from relnav_graph.files import printable
from relnav_graph.scenario.build import load_scenario
from relnav_graph.study.conduct import Workers, do_runs, do_until, merge, study_summary
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.recorded import open_data
from relnav_graph.study.runs import StudySpec


class _Shard(click.ParamType[tuple[int, int]]):
    """``i/n``: the i-th of n shards, from 1."""

    name = "i/n"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[int, int]:
        first, _, second = str(value).partition("/")
        if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
            return int(first), int(second)
        raise click.BadParameter(f"found {value!r}, expected i/n with 1 <= i <= n", ctx, param)


class _Precision(click.ParamType[float]):
    """A part of the RMSE, ``5%`` or ``0.05``."""

    name = "percent"

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        text = str(value)
        try:
            number = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
        except ValueError:
            number = -1.0
        if not 0 < number < 1:
            raise click.BadParameter(f"found {text!r}, expected a part like 5%", ctx, param)
        return number


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):  # not on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _dask_workers(address: str, jobs: int) -> Iterator[Workers]:
    """The workers of a scheduler of dask.distributed; of one of our own for "local"."""
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise InputError('--dask needs the extra: pip install "relnav-graph[dask]"') from error
    with ExitStack() as stack:
        try:
            place: Any = address
            if address == "local":
                options = {"threads_per_worker": 1, "dashboard_address": None}
                place = stack.enter_context(LocalCluster(n_workers=jobs, **options))
            client = stack.enter_context(Client(place, timeout=20))
        except (OSError, ValueError) as error:
            raise InputError(f"--dask {address}: {error}") from error
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(f"--dask {address}: the scheduler has no workers")
        yield Workers(threads, client.get_executor())


@contextmanager
def _place(out: Path | None) -> Iterator[Path]:
    """The folder of the study; one that is gone afterwards where none is named."""
    if out is not None:
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="relnav-study-") as folder:
        yield Path(folder)


def _rerun(scenario: Path, spec: StudySpec, assignments: Sequence[str], data: Path | None) -> str:
    settings = [part for text in assignments for part in ("--set", text)]
    settings += [] if data is None else ["--data", str(data)]
    words = ["relnav", "compare", str(scenario), "--seed", str(spec.seed), *settings]
    return printable(shlex.join(words))


def _show(
    folder: StudyFolder, runs: Sequence[int], lost: dict[int, str], as_json: bool, keep: bool
) -> int:
    from relnav_graph.io.atomic import atomic
    from relnav_graph.scoring.text import study_table

    found, _ = study_summary(folder, runs, lost)
    if keep:
        with atomic(folder.path / "summary.json") as staged:
            staged.write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", "utf-8")
    return report(found, as_json, study_table)


@click.command("study")
@click.argument("paths", metavar="SCENARIO", nargs=-1, type=click.Path(path_type=Path))
@click.option("--runs", type=click.IntRange(1), default=100, show_default=True, help="Runs.")
@click.option("-e", "--estimator", "kinds", multiple=True, help="Estimator; may be repeated.")
@click.option("--seed", type=click.IntRange(0), help="Root of the random numbers.")
@click.option("--data", type=click.Path(path_type=Path), help="Recorded orbits: see above.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("-j", "--jobs", type=click.IntRange(1), help="Local processes; default: all cores.")
@click.option("--dask", metavar="ADDRESS", help="Scheduler of dask.distributed, or 'local'.")
@click.option("--shard", type=_Shard(), help="Make only this part of the runs, for a queue.")
@click.option("--merge", "merging", is_flag=True, help="Join the folders of shards.")
@click.option("--trust", is_flag=True, help="Let the folders to merge name modules to import.")
@click.option("--until-ci", type=_Precision(), help="Stop when every RMSE is known that well.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder; resumed if there.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    paths: tuple[Path, ...],
    runs: int,
    kinds: tuple[str, ...],
    seed: int | None,
    data: Path | None,
    assignments: tuple[str, ...],
    jobs: int | None,
    dask: str | None,
    shard: tuple[int, int] | None,
    merging: bool,
    trust: bool,
    until_ci: float | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Make many runs of SCENARIO, each with its own noise, the same for all estimators.

    Gives RMSE with intervals, consistency with bands, the bound, and a verdict. A study
    that was interrupted goes on when the same command is given again. The numbers do not
    depend on who makes the runs.

    With --data, the folder of a reader that the scenario names, the truth is recorded, and
    the sensors of data.simulate are drawn anew on it in each run.

    \b
    relnav study SCENARIO --runs 200 -o OUT --shard 1/4     one of four jobs of a queue
    relnav study --merge OUT1 OUT2 OUT3 OUT4 -o OUT         all of them together
    """  # noqa: D301  click wants the character itself
    show_events()
    if merging:
        if out is None:
            raise click.UsageError("--merge needs -o OUT, the folder to join the shards in")
        folder = merge(out, paths, trust)
        count = max(folder.runs(), default=-1) + 1
        missing = sorted(set(range(count)) - set(folder.runs()))
        lost = dict.fromkeys(missing, "no shard has this run")
        return _show(folder, range(count), lost, as_json, True)
    if len(paths) != 1:
        raise click.UsageError(f"found {len(paths)} scenarios, expected one")
    if shard and (out is None or until_ci):
        raise click.UsageError("--shard needs -o OUT, and does not go with --until-ci")
    check_before_work(kinds, out)
    if data is None:
        spec = StudySpec.of(load_scenario(paths[0], assignments), seed, kinds)
    else:
        scenario, recorded = open_data(paths[0], data, assignments, seed)
        spec = StudySpec.of(scenario, seed, kinds, recorded)
    chosen = range(runs) if shard is None else range(shard[0] - 1, runs, shard[1])
    jobs = jobs or _cores()
    crew = nullcontext(Workers(jobs)) if dask is None else _dask_workers(dask, jobs)
    with _place(out) as place, crew as workers:
        folder = StudyFolder(place, spec, _rerun(paths[0], spec, assignments, data))
        kept = len(set(chosen) & set(folder.runs()))
        if kept:
            show_progress(f"{place}: {kept} of {len(chosen)} runs are there")
        with study_progress() as listener:
            if until_ci is None:
                lost = do_runs(folder, chosen, workers, listener)
            else:
                count, lost = do_until(folder, until_ci, runs, workers, listener)
                chosen = range(count)
        return _show(folder, chosen, lost, as_json, out is not None)
