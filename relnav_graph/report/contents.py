"""What a folder holds that a report can be written on: a study, or one pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.core.track import Track, Truth
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.files import read_file
from relnav_graph.io.manifest import PASS_FILE, PassManifest
from relnav_graph.io.results import cautions_in, read_results
from relnav_graph.io.stored import Count, check_json
from relnav_graph.registry import look_beside
from relnav_graph.runs.comparison import compare_pass
from relnav_graph.runs.outputs import sights
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.schema import ScenarioError
from relnav_graph.scenario.toml import modules_of, refuse_modules
from relnav_graph.scoring.metrics import summary, versions
from relnav_graph.study.collect import Collected
from relnav_graph.study.conduct import study_summary
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.runs import StudySpec

__all__ = ["PassContents", "StudyContents", "WorstRun", "read_contents"]

#: Worst runs that the report lists.
LISTED = 5


@dataclass(frozen=True, eq=False)
class WorstRun:
    """A run that is among the worst.

    anees: joint ANEES of the judged row; state, ratio: the state whose RMSE is largest relative
    to that over all runs, and that ratio; command: makes the run alone.
    """

    run: int
    anees: float
    state: str
    ratio: float
    command: str


@dataclass(frozen=True, eq=False)
class PassContents:
    """One pass: tracks, truth where known, and their summary; seen: how many observations there
    are of each point of a map, by the name of its block; simulated: whether its recording was drawn
    from the scenario's truth."""

    scenario: Scenario
    summary: Mapping[str, Any]
    tracks: Sequence[Track]
    truth: Truth | None
    command: str
    versions: Mapping[str, str]
    seen: Mapping[str, int]
    simulated: bool


@dataclass(frozen=True, eq=False)
class StudyContents:
    """A study: its summary, and found, the sums over its runs.

    judged: the row by which runs are called bad; worst: the worst of them, worst first.
    """

    scenario: Scenario
    summary: Mapping[str, Any]
    found: Collected
    command: str
    versions: Mapping[str, str]
    spec: StudySpec
    judged: str
    worst: Sequence[WorstRun]

    def remake(self, run: int) -> PassContents | None:
        """A run made again, which gives the same numbers; None when it fails."""
        try:
            run_again = self.spec.drawn(*self.spec.read(), run)
            found = compare_pass(run_again, self.spec.estimators)
        except (RelnavError, ArithmeticError, np.linalg.LinAlgError):
            return None
        command = next((w.command for w in self.worst if w.run == run), "")
        tracks, truth = list(found.tracks), found.truths[0]
        return PassContents(
            self.scenario,
            found.summary,
            tracks,
            truth,
            command,
            versions(),
            sights(found),
            self.simulated,
        )

    @property
    def simulated(self) -> bool:
        """Whether all of each run was drawn from the scenario's truth."""
        return self.spec.data is None


@dataclass(frozen=True)
class _Failed:
    """A run without a result, as a summary has it."""

    run: Count
    estimator: str | None
    message: str


@dataclass(frozen=True)
class _Summary:
    """Of ``summary.json``, what is read back."""

    failed: list[_Failed]


def _stored_scenario(file: Path, raw: Mapping[str, Any], name: str) -> Scenario:
    """The scenario in a manifest. Raises ScenarioError that names its file."""
    try:
        return make_scenario(raw, name)
    except ScenarioError as error:
        raise ScenarioError(f"{file}, raw", error.problems) from error


def _lost(path: Path, there: set[int]) -> dict[int, str]:
    """Runs that the study gave up, so that they have no record: its summary names them."""
    file = path / "summary.json"
    if not file.is_file():  # of a study that is not at its end
        return {}
    failed = check_json(str(file), read_file(file), _Summary).failed
    return {
        one.run: one.message for one in failed if one.estimator is None and one.run not in there
    }


def _judged(found: Collected) -> str:
    """The row by which runs are ranked: batch, else the first smoothed row, else the first, of
    those that did not diverge in every run."""
    rows = {name: row for name, row in found.rows.items() if row.own} or found.rows
    if "batch" in rows:
        return "batch"
    smoothed = [name for name, row in rows.items() if row.kind == "smoothed"]
    return next(iter([*smoothed, *rows]))


def _worst(found: Collected, judged: str, rerun: str) -> list[WorstRun]:
    row = found.rows[judged]
    states = [s for s in row.units if np.isfinite(row.of(s, "rmse")).any()]
    if not states:
        return []
    rmse = np.column_stack([row.of(s, "rmse") for s in states])  # (runs, states)
    ratio = np.nan_to_num(rmse / np.sqrt(np.nanmean(rmse**2, axis=0)))
    anees = np.array(row.own["anees"])
    # Where truth does not know the whole state there is no joint NEES.
    measure = anees if np.isfinite(anees).any() else ratio.max(axis=1)
    order = np.argsort(-np.where(np.isfinite(rmse).any(axis=1), measure, -1.0), kind="stable")
    out = []
    for k in order[:LISTED].tolist():
        if np.isfinite(rmse[k]).any():
            at, run = int(ratio[k].argmax()), found.runs[k]
            command = f"{rerun} --run {run}"
            out.append(WorstRun(run, anees[k], states[at], float(ratio[k, at]), command))
    return out


def _read_study(path: Path, trust: bool) -> StudyContents:
    folder = StudyFolder.open(path, trust)
    scenario = _stored_scenario(path / "study.json", folder.spec.raw, folder.spec.name)
    there = folder.runs()
    if not there:
        raise InputError(f"{path}: no run of the study is done yet")
    lost = _lost(path, set(there))
    found_summary, found = study_summary(folder, there, lost)
    if not found.rows:
        raise InputError(f"{path}: every run failed: {found.failed[0][1]}")
    spec, judged = folder.spec, _judged(found)
    estimators = "".join(f" -e {kind}" for kind in spec.estimators)
    command = folder.rerun.replace("relnav compare", "relnav study", 1)
    return StudyContents(
        scenario,
        found_summary,
        found,
        f"{command} --runs {max([*there, *lost]) + 1}{estimators}" if command else "",
        found_summary["versions"],
        spec,
        judged,
        _worst(found, judged, folder.rerun + estimators),
    )


def _read_pass(path: Path, trust: bool) -> PassContents:
    manifest, file = PassManifest.read(path), path / PASS_FILE
    if not trust:
        refuse_modules(str(file), {"raw": manifest.raw})
    else:
        look_beside(Path(), modules_of(manifest.raw))
    scenario = _stored_scenario(file, manifest.raw, manifest.name)
    tracks, truth, attributes = read_results(path / "results.nc")
    if not tracks:
        raise InputError(f"{path / 'results.nc'}: holds no track")
    found = summary(
        manifest.name,
        manifest.seed if manifest.simulated else None,
        tracks,
        truth,
        scenario.derived,
        scenario.window(tracks[0].t),
        len(tracks[0].t),
        cautions_in(f"{path / 'results.nc'}, cautions", attributes.get("cautions", "[]")),
        scenario.scored,
        check_json(f"{path / 'results.nc'}, noise", attributes.get("noise", "{}").encode(), dict),
    )
    where, text = f"{path / 'results.nc'}, times_seen", attributes.get("times_seen", "{}")
    seen = check_json(where, text.encode(), dict[str, Count])
    about = (manifest.command, manifest.versions, seen, manifest.simulated)
    return PassContents(scenario, found, tracks, truth, *about)


def read_contents(path: Path, trust: bool = False) -> StudyContents | PassContents:
    """What the folder of ``relnav study``, ``compare`` or ``smooth`` holds.

    trust: its scenario may name modules ("module:Class"), which are then imported, from where it is
    run too. Raises InputError on a folder of something else, and on damaged files.
    """
    if not path.is_dir():
        raise InputError(f"{path}: {'is a file, expected' if path.exists() else 'no such'} folder")
    if (path / "study.json").is_file():
        return _read_study(path, trust)
    if (path / PASS_FILE).is_file():
        return _read_pass(path, trust)
    raise InputError(
        f"{path}: found no study.json and no {PASS_FILE}, expected the folder that relnav"
        " study, compare or smooth wrote with -o"
    )
