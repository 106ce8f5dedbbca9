"""One estimator on one problem: its track says what is doubtful about the pass, too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from relnav_graph import estimators
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.runs.conventions import pass_cautions

__all__ = ["run_estimator"]


def run_estimator(kind: str, problem: Problem, extra: Any = None) -> Track:
    """Run an estimator of a kind, or of ``"module:Class"``, on one thread.

    extra: native factors and variables of a graph (`relnav_graph.estimators.isam2.Extra`), for an
    estimator that has a graph to put them in. The cautions of the problem are among those of the
    track; where it does not fit, and would in another convention or unit, so is that. Raises
    ModelError on an unknown kind, InputError on a problem without epochs, and on `extra` where it
    does not fit or the estimator cannot take it, EstimationError when no estimate is possible.
    """
    track = estimators.run_estimator(kind, problem, extra)
    doubts = pass_cautions(problem, [track])
    ahead = track.smoothed and replace(track.smoothed, cautions=doubts + track.smoothed.cautions)
    return replace(track, cautions=doubts + track.cautions, smoothed=ahead)
