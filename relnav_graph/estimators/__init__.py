"""Estimators, found by `kind`: each is ``run(problem) -> Track``."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.core.cautions import Caution
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import EstimationError, GeometryError, InputError, ModelError
from relnav_graph.estimators.first_sights import few_sides, has_map, turned
from relnav_graph.estimators.online.engine import Engine
from relnav_graph.estimators.online.monitor import caution
from relnav_graph.estimators.source import Source
from relnav_graph.registry import find_class

__all__ = ["GROUP", "Estimator", "diverged", "find_estimator", "run_estimator", "try_estimator"]

GROUP = "relnav_graph.estimators"


@runtime_checkable
class Estimator(Protocol):
    """What every estimator offers."""

    kind: ClassVar[str]

    def run(self, problem: Problem) -> Track:
        """Estimate the whole pass. Raises EstimationError when that is impossible."""


@runtime_checkable
class TakesEpochs(Protocol):
    """An estimator that takes epochs as they come: of a recording, or of a pass that its own
    estimates fly."""

    def drive(self, source: Source) -> Track:
        """Estimate at each epoch of a source, before the next one comes."""


@runtime_checkable
class ServesOnline(Protocol):
    """An estimator that can be driven online, see `relnav_graph.estimators.online.driver`."""

    def engine(self, problem: Problem) -> Engine:
        """What makes a state of the state before and an epoch."""


def find_estimator(kind: str) -> type[Estimator]:
    """The class of a kind, or of ``"module:Class"``. Raises ModelError when it is none."""
    cls: type[Estimator] = find_class(GROUP, kind)
    if not callable(getattr(cls, "run", None)):
        raise ModelError(f"found kind {kind!r}, expected an estimator, with run(problem)")
    return cls


def run_estimator(kind: str, problem: Problem, extra: Any = None) -> Track:
    """Run an estimator of a kind, or of ``"module:Class"``, on one thread.

    extra: native factors and variables of a graph (`relnav_graph.estimators.isam2.Extra`), for an
    estimator that has a graph to put them in. Threads only slow the small matrices of an epoch
    down. Raises ModelError on an unknown kind, InputError on a problem without epochs, and on
    `extra` where it does not fit or the estimator cannot take it, EstimationError when no estimate
    is possible.
    """
    if not problem.epochs:
        raise InputError("epochs: found none, expected one or more")
    estimator: Any = find_estimator(kind)()
    more = {} if extra is None else {"extra": extra}
    if more and "extra" not in inspect.signature(estimator.run).parameters:
        raise InputError(f"estimator {kind!r} takes no extra factors; isam2 does")
    # A filter that diverges overflows before its status says so.
    with threadpool_limits(1, "blas"), np.errstate(over="ignore", invalid="ignore"):
        track: Track = estimator.run(problem, **more)
    return track if track.status != "ok" else _initialising(_cautious(track, problem), problem)


def _initialising(track: Track, problem: Problem) -> Track:
    """The track, with a caution where a map was not seen from enough sides to be one."""
    layout = problem.layout
    text = few_sides(float(turned(layout, track.states)[-1])) if has_map(layout) else ""
    if not text:
        return track
    doubt = (Caution("initialising", f"{text}: the prior counts for much"),)
    ahead = track.smoothed and replace(track.smoothed, cautions=track.smoothed.cautions + doubt)
    return replace(track, cautions=track.cautions + doubt, smoothed=ahead)


def _cautious(track: Track, problem: Problem) -> Track:
    """The track, degraded where a process says that its state cannot be told from another."""
    for epoch, x in zip(problem.epochs, track.states, strict=True):
        doubt = caution(problem, epoch, x)
        if doubt:
            message = f"t = {epoch.t} s: {doubt}"
            ahead = track.smoothed and replace(track.smoothed, status="degraded", message=message)
            return replace(track, status="degraded", message=message, smoothed=ahead)
    return track


def try_estimator(kind: str, problem: Problem) -> Track:
    """:func:`run_estimator`; what cannot be estimated is a diverged track that says why."""
    try:
        return run_estimator(kind, problem)
    except (EstimationError, GeometryError, ModelError, np.linalg.LinAlgError) as error:
        return diverged(kind, problem, error)


def diverged(kind: str, problem: Problem, error: Exception) -> Track:
    """The track of an estimator that could not go on."""
    count, layout = len(problem.epochs), problem.layout
    return Track(
        name=kind,
        kind="filtered",
        t=problem.times,
        **estimates(
            layout,
            np.full((count, layout.size), np.nan),
            np.full((count, layout.dim, layout.dim), np.nan),
        ),
        status="diverged",
        message=f"{type(error).__name__}: {error}",
    )
