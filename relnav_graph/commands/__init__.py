"""One module per command of the command line, and what they share."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from relnav_graph.core.models import derived_quantities
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import GROUP, try_estimator
from relnav_graph.io.dataset import read_dataset, read_scenario_of, read_settings_of
from relnav_graph.io.readers import read_raw
from relnav_graph.loop import fly_all, warm_up
from relnav_graph.registry import find_class
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.toml import override, read_toml
from relnav_graph.scoring.metrics import summary
from relnav_graph.scoring.text import table as comparison_table

__all__ = ["Pass", "estimate", "is_dataset", "open_pass", "show_progress", "write_outputs"]


@dataclass(frozen=True, eq=False)
class Pass:
    """A scenario with the recording it is run on.

    seed: root of what is drawn, the prior's mean at least; simulated: whether the recording
    was drawn from it too; run: which of the runs of a study it is; flown: whether estimators
    are to fly it themselves, in loops: the recording then holds the times alone.
    """

    scenario: Scenario
    recording: Recording
    seed: int
    simulated: bool
    run: int = 0
    flown: bool = False


def is_dataset(folder: Path) -> bool:
    """Whether a folder is a data set (it has a scenario.toml)."""
    return (folder / "scenario.toml").is_file()


def _recorded(scenario: Scenario, folder: Path) -> Recording:
    """The recording in a data set; a sensor's table is read by the scenario's model."""
    blocks = {b.name: b for b in scenario.layout}
    return read_dataset(folder, scenario.sensors, scenario.input_columns, blocks)


def _need_folder(folder: Path) -> None:
    if not folder.is_dir():
        what = "is a file, expected a folder" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: {what}")


def open_dataset(folder: Path, assignments: Sequence[str] = ()) -> Pass:
    """A data set with its own scenario. Raises InputError on whatever is wrong."""
    show_events()
    _need_folder(folder)
    raw = override(read_scenario_of(folder), assignments)
    scenario = make_scenario(raw, folder.name, read_settings_of(folder))
    return Pass(scenario, _recorded(scenario, folder), scenario.file.seed, False)


def open_pass(
    path: Path,
    seed: int | None,
    data: Path | None,
    assignments: Sequence[str],
    run: int = 0,
    loops: bool = False,
) -> Pass:
    """A scenario with simulated data, a data set, or a folder that its reader knows.

    loops: a scenario with a controller is not simulated, but left to be flown.

    Raises InputError on whatever is wrong with any of them.
    """
    show_events()
    if data is None:
        scenario = load_scenario(path, assignments)
        seed = scenario.file.seed if seed is None else seed
        if loops and scenario.control is not None:
            return Pass(scenario, Recording(scenario.times, ()), seed, True, run, True)
        return Pass(scenario, scenario.simulate(seed, run), seed, True, run)
    _need_folder(data)
    if is_dataset(data):
        scenario = load_scenario(path, assignments, read_settings_of(data))
        recording = _recorded(scenario, data)
    else:
        recording = read_folder(path, data, assignments)
        scenario = load_scenario(path, assignments, recording.settings)
    seed = scenario.file.seed if seed is None else seed
    if not is_dataset(data):
        recording = scenario.completed(recording, seed, run)
    return Pass(scenario, recording, seed, False, run)


def read_folder(path: Path, folder: Path, assignments: Sequence[str]) -> Recording:
    """What the reader that a scenario names makes of a raw folder."""
    settings = override(read_toml(path), assignments).get("data")
    if not isinstance(settings, dict) or "reader" not in settings:
        raise InputError(
            f"{folder}: no scenario.toml in it, and {path} names no [data] reader for raw folders"
        )
    return read_raw(str(settings["reader"]), folder, settings.get("options", {}))


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


def check_before_work(kinds: Sequence[str], out: Path | None) -> None:
    """Refuse, before any work, estimators that do not exist and folders that cannot be.

    Raises ModelError or InputError.
    """
    for kind in kinds:
        find_class(GROUP, kind)
    if out is not None and out.exists() and not out.is_dir():
        raise InputError(f"-o {out}: is a file, expected a folder")


def estimate(run: Pass, kinds: Sequence[str]) -> tuple[list[Track], dict[str, Any]]:
    """Run estimators on one problem, or in loops; their tracks, and the summary of section
    `--json`."""
    chosen = list(dict.fromkeys(kinds or run.scenario.file.estimators))
    if run.flown:
        tracks = _flown(run, chosen)
        times = run.recording.times
    else:
        problem = run.scenario.problem(run.recording, run.seed, run.run)
        times = problem.times
        for kind in chosen:  # what is not compiled yet must not count as run time
            try_estimator(kind, replace(problem, epochs=problem.epochs[:3]))
        tracks = []
        for kind in chosen:
            show_progress(f"{kind}: {len(times)} epochs ...")
            tracks.append(try_estimator(kind, problem))
    found = summary(
        run.scenario.name,
        run.seed if run.simulated else None,
        tracks,
        run.recording.truth,
        derived_quantities(run.scenario.layout),
        run.scenario.window(times),
        len(times),
    )
    return tracks, found


def _flown(run: Pass, kinds: Sequence[str]) -> list[Track]:
    """The tracks of estimators in loops, each on a pass of its own."""
    show_progress(f"{run.scenario.name}: each of {', '.join(kinds)} flies a pass of its own ...")
    warm_up(run.scenario, kinds, run.seed)
    tracks = []
    for done in fly_all(run.scenario, kinds, run.seed, run.run):
        show_progress(f"{done.track.name}: {len(done.problem.epochs)} epochs")
        tracks.append(done.track)
    return tracks


def write_outputs(out: Path, run: Pass, tracks: Sequence[Track], found: dict[str, Any]) -> None:
    """Results, summary, manifest and figures in the folder `out`. Raises InputError."""
    from relnav_graph.figures import error_figures, save_figures, trajectory_figure
    from relnav_graph.io.atomic import atomic
    from relnav_graph.io.manifest import PassManifest
    from relnav_graph.io.results import write_results

    show_progress(f"writing {out} ...")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o {out}: {error.strerror}") from error
    attributes = {"scenario": run.scenario.name, "title": run.scenario.file.title}
    write_results(out / "results.nc", tracks, run.recording.truth, attributes)
    with atomic(out / "summary.json") as staged:
        staged.write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", "utf-8")
    PassManifest(
        run.scenario.name,
        run.scenario.raw,
        run.seed,
        run.run,
        run.simulated,
        found["versions"],
        click.get_current_context().obj or "",
    ).write(out)
    derived = derived_quantities(run.scenario.layout)
    figures = error_figures(tracks, run.recording.truth, derived)
    path = trajectory_figure(tracks, run.recording.truth, derived)
    if path is not None:
        figures["trajectory"] = path
    save_figures(figures, out / "figures")


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
