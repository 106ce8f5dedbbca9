"""Conducting a study: from a spec and a folder to the summary, wherever the runs are made."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from relnav_graph.errors import InputError
from relnav_graph.scenario.build import make_scenario
from relnav_graph.study.collect import Collected, collect
from relnav_graph.study.execute import execute
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.record import RunRecord
from relnav_graph.study.runs import prepare, run_record
from relnav_graph.study.summary import rmse_precision, summarize
from relnav_graph.study.verdict import verdict

__all__ = ["Progress", "Workers", "do_runs", "do_until", "merge", "study_summary"]


@dataclass(frozen=True)
class Progress:
    """An event: `done` of `total` runs; note: what happened to `run`, if anything."""

    done: int
    total: int
    run: int
    note: str = ""


Listener = Callable[[Progress], None]


@dataclass(frozen=True)
class Workers:
    """Who makes the runs: `jobs` local processes (1: this one), or an executor of
    `concurrent.futures` that takes `jobs` runs at a time."""

    jobs: int = 1
    executor: Executor | None = None


def _silent(_: Progress) -> None:
    pass


def do_runs(
    folder: StudyFolder,
    runs: Sequence[int],
    workers: Workers | None = None,
    listener: Listener = _silent,
) -> dict[int, str]:
    """Make the runs that the folder lacks. Returns the runs that were lost with their workers,
    with the reason: they have no record, and are tried again next time.

    Raises InputError when a record cannot be written, EstimationError when an executor
    that was given breaks; what is done stays.
    """
    workers = workers or Workers()
    done = set(folder.runs())
    missing = [run for run in runs if run not in done]
    lost: dict[int, str] = {}
    finished = len(runs) - len(missing)
    if not missing:
        return lost
    spec_json = folder.spec.to_json()
    prepare(spec_json)
    task = partial(run_record, spec_json)
    results: Iterator[tuple[int, bytes | str]]
    if workers.executor is None and (workers.jobs == 1 or len(missing) == 1):
        results = ((run, task(run)) for run in missing)
    else:
        results = execute(task, missing, workers.jobs, workers.executor)
    for run, result in results:
        finished += 1
        if isinstance(result, str):
            lost[run] = result
        else:
            folder.write(run, result)
        listener(Progress(finished, len(runs), run, lost.get(run, "")))
    return lost


def do_until(
    folder: StudyFolder,
    precision: float,
    most: int,
    workers: Workers | None = None,
    listener: Listener = _silent,
) -> tuple[int, dict[int, str]]:
    """Make runs until every RMSE is known to `precision`, but not more than `most`.

    precision: half the width of the 95 % interval of an RMSE, divided by the RMSE. Returns the
    number of runs, and those that were lost, with the reason. The precision is checked after
    10, 15, 22, ... runs, half as many again each time, and not after each run, so that the
    number does not depend on which worker is quick.
    """
    count, lost = min(10, most), dict[int, str]()
    while True:
        lost |= do_runs(folder, range(count), workers, listener)
        there = [run for run in folder.runs() if run < count]
        found = collect(folder.records(there))
        if count == most or rmse_precision(found, folder.spec.seed) <= precision:
            return count, lost
        count = min(most, count + count // 2)


def merge(target: Path, sources: Sequence[Path], trust: bool = False) -> StudyFolder:
    """One study of the records of several folders, such as the shards of a batch queue.

    trust: see :meth:`StudyFolder.open`. Raises InputError when they are not of one study, or a
    record is damaged.
    """
    if not sources:
        raise InputError("nothing to merge: expected folders of one study")
    first = StudyFolder.open(sources[0], trust)
    merged = StudyFolder(target, first.spec, first.rerun)
    for source in sources:
        folder = StudyFolder(source, first.spec) if source != sources[0] else first
        there = set(merged.runs())
        for run in folder.runs():
            content = folder.read_bytes(run)
            RunRecord.from_bytes(content, str(source))
            if run not in there:
                merged.write(run, content)
    return merged


def study_summary(
    folder: StudyFolder, runs: Sequence[int], lost: dict[int, str]
) -> tuple[dict[str, Any], Collected]:
    """The summary, verdict included, of those of the runs that the folder has."""
    there = sorted(set(runs) & set(folder.runs()))
    found = collect(folder.records(there))
    found.failed += sorted(lost.items())
    scenario = make_scenario(folder.spec.raw, folder.spec.name)
    data = folder.spec.data
    epochs = len(scenario.times) if data is None else data.epochs
    summary = summarize(folder.spec, found, epochs, folder.rerun)
    summary["verdict"] = verdict(summary, found, scenario, data.same if data else ())
    return summary, found
