"""One run of a scenario: a pass, and what estimators make of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from relnav_graph.core.problem import Problem
from relnav_graph.core.shown import Shown
from relnav_graph.core.track import Recording, Track, Truth
from relnav_graph.estimators import find_estimator, try_estimator
from relnav_graph.runs.closed_loop import fly_all
from relnav_graph.runs.conventions import pass_cautions
from relnav_graph.runs.passes import Pass, open_pass
from relnav_graph.runs.warm_up import warm_up
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scoring.metrics import summary
from relnav_graph.scoring.noise_verdict import beside_truth
from relnav_graph.scoring.residuals import judge_by_residuals
from relnav_graph.scoring.text import caution_lines

__all__ = ["Comparison", "Estimated", "compare", "compare_pass", "estimate_pass"]

#: Called with a line of text before each step that takes seconds.
Listener = Callable[[str], None]


def _silent(text: str) -> None:
    """Nobody listens."""


@dataclass(frozen=True, eq=False)
class Estimated:
    """One pass with what estimators made of it: problem, truth where known, tracks."""

    problem: Problem
    truth: Truth | None
    tracks: Sequence[Track]


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Shown):
    """Several estimators on one pass, scored.

    tracks: one for each estimator, in order, of a recorded pass the smoothed one that tells
    most with its standardised residuals for innovations; problems and truths: of each track, the
    same ones for all but in a closed loop, where each estimator flies a pass of its own; summary:
    the object that `relnav compare --json` prints.
    """

    tracks: tuple[Track, ...]
    problems: tuple[Problem, ...]
    truths: tuple[Truth | None, ...]
    summary: dict[str, Any]

    def _shown(self) -> tuple[str, Mapping[str, str]]:
        rows = {}
        for name, row in self.summary["estimators"].items():
            anees, status = row.get("anees"), row["status"]
            said = "" if anees is None else f", ANEES {anees:.3g}"
            rows[name] = f"{row['kind']}, {status}{said}"
        return f"Comparison of {self.summary['scenario']!r}: {self.summary['epochs']} epochs", rows

    def _doubts(self) -> list[str]:
        return caution_lines(self.summary)

    def track(self, name: str) -> Track:
        """The track of an estimator. Raises KeyError when there is none of that name."""
        return {track.name: track for track in self.tracks}[name]


def estimate_pass(
    opened: Pass,
    kinds: Sequence[str],
    estimate: Callable[[str, Problem], Track] = try_estimator,
    tell: Listener = _silent,
) -> list[Estimated]:
    """Run estimators on one problem, or have each fly its own where there is a controller.

    kinds: of estimators, in order; estimate: what runs one on a pass that is not flown; tell:
    hears of each step. Raises InputError when the pass gives no problem, or cannot be flown.
    """
    if opened.flown:
        tell(f"{opened.scenario.name}: each of {', '.join(kinds)} flies a pass of its own ...")
        out = []
        for flown in fly_all(opened.scenario, kinds, opened.seed, opened.run):
            tell(f"{flown.track.name}: {len(flown.problem.epochs)} epochs")
            out.append(Estimated(flown.problem, flown.track.truth, [flown.track]))
        return out
    problem, tracks = opened.problem, []
    for kind in kinds:
        tell(f"{kind}: {len(problem.epochs)} epochs ...")
        tracks.append(estimate(kind, problem))
    return [Estimated(problem, opened.recording.truth, tracks)]


def compare_pass(
    opened: Pass, kinds: Sequence[str] | None = None, tell: Listener = _silent
) -> Comparison:
    """Run estimators on a pass that is open, and score them; see :func:`compare`."""
    chosen = list(dict.fromkeys(kinds or opened.scenario.file.estimators))
    for kind in chosen:
        find_estimator(kind)
    warm_up(opened, chosen)
    made = estimate_pass(opened, chosen, tell=tell)
    each = [(one, track) for one in made for track in one.tracks]
    tracks = tuple(track for _, track in each)
    times = opened.recording.times if opened.flown else opened.problem.times
    noise: dict[str, Any] = {}
    # What is simulated has the noises that are declared, and truth to say so.
    if (opened.recording.truth is None or not opened.simulated) and not opened.flown:
        tell("residuals and declared noises ...")
        tracks, noise = judge_by_residuals(opened.problem, tracks)
    # What is simulated is written as it is read.
    cautions = pass_cautions(each[0][0].problem, () if opened.simulated else tracks)
    found = summary(
        opened.scenario.name,
        opened.seed if opened.simulated else None,
        tracks,
        opened.recording.truth,
        opened.scenario.derived,
        opened.scenario.window(times),
        len(times),
        cautions,
        opened.scenario.scored,
        noise,
    )
    if noise:
        found["noise"] = beside_truth(noise, found["estimators"])
    problems, truths = tuple(o.problem for o, _ in each), tuple(o.truth for o, _ in each)
    return Comparison(tracks, problems, truths, found)


def compare(
    scenario: Scenario | str | Path,
    kinds: Sequence[str] | None = None,
    *,
    seed: int | None = None,
    run: int = 0,
    data: Recording | str | Path | None = None,
) -> Comparison:
    """Run estimators on a simulated or recorded pass and score them against its truth.

    scenario: one that is loaded, its file, or the name of one that comes with the package; kinds:
    of estimators, by default those that the scenario names; seed: root of what is drawn, by
    default the scenario's; run: number of the draw, as in a study; data: a recording, a data-set
    folder, or a raw folder for the reader that the scenario names; without, the pass is
    simulated, or, where the scenario has a controller, flown by each estimator.

    Raises InputError (ScenarioError for the file) or ModelError on whatever is wrong with any
    of them. An estimator that diverges raises nothing: its track says so.
    """
    opened = open_pass(scenario, seed, data, run=run, loops=True)
    return compare_pass(opened, kinds)
