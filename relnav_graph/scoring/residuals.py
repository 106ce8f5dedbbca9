"""What a pass says of its own estimates, without truth: residuals and noises.

Of a smoothed trajectory, a whitened residual row e of the measurements has the variance 1 - h, with
h its row of A P A^T: what the estimate took of it (the redundancy; Baarda 1968). So e / sqrt(1 - h)
is to a smoother what a whitened innovation is to a filter, but correlated in time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Innovations, Track
from relnav_graph.errors import RelnavError
from relnav_graph.scoring.agreement import REFERENCES
from relnav_graph.scoring.metrics import with_smoothed
from relnav_graph.scoring.noise_likelihood import explained
from relnav_graph.scoring.noise_verdict import noise_verdict
from relnav_graph.scoring.variance_components import Smoothed, residuals_after

__all__ = ["judge_by_residuals", "standardised_residuals"]

#: Rows of which the estimate takes more than this say nothing of themselves.
_TAKEN = 1 - 1e-6
#: Epochs of a pass of which residuals are looked at, and for which one probe of the coupling of
#: noises is enough, since it averages over them.
_LONGEST, _LONG = 30_000, 5_000
_PROBES = 4


def standardised_residuals(problem: Problem, pass_: Smoothed) -> dict[str, Innovations]:
    """Residual rows of each sensor, divided by what is expected of them, as `Innovations`."""
    assembly, rows = pass_.assembly, pass_.rows
    r = residuals_after(rows, pass_.conditionals.solution())[2]
    h = explained(rows, pass_.conditionals)[2]
    usable = pass_.used & (h < _TAKEN)
    epoch = np.repeat(np.arange(len(problem.epochs)), np.diff(rows.offsets))
    sensor = np.repeat(assembly.sensor_of, assembly.heights)
    times = np.array([e.t for e in problem.epochs])
    found = {}
    for k, name in enumerate(assembly.sensor_names):
        own = usable & (sensor == k)
        if own.any():
            at, counts = np.unique(epoch[own], return_counts=True)
            offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
            found[name] = Innovations(times[at], r[own] / np.sqrt(1 - h[own]), offsets)
    return found


def _judged(tracks: tuple[Track, ...]) -> str | None:
    """The smoothed row whose residuals are taken: that which others are compared with."""
    rows = {n: t for n, t in with_smoothed(tracks).items() if t.status != "diverged"}
    smoothed = [n for n, t in rows.items() if t.kind == "smoothed"]
    return next((n for n in (*REFERENCES, *smoothed) if n in rows), None)


def _with_residuals(track: Track, row: str, found: Mapping[str, Innovations]) -> Track:
    if track.name == row:
        return replace(track, innovations=found)
    if track.smoothed is not None and f"{track.name}_smoothed" == row:
        return replace(track, smoothed=replace(track.smoothed, innovations=found))
    return track


def judge_by_residuals(
    problem: Problem, tracks: tuple[Track, ...]
) -> tuple[tuple[Track, ...], dict[str, Any]]:
    """The tracks, the smoothed one that tells most with its standardised residuals for innovations,
    and the verdict on the declared noises, see `noise_verdict`; {} without a smoothed track.

    Where the pass cannot be looked at, the verdict is ``{"missing": why}``.
    """
    row = _judged(tracks)
    if row is None:
        return tracks, {}
    if len(problem.epochs) > _LONGEST:
        long = f"{len(problem.epochs)} epochs; looked at are up to {_LONGEST}"
        return tracks, {"residuals_of": row, "missing": long}
    x: Array = with_smoothed(tracks)[row].states
    probes = _PROBES if len(problem.epochs) < _LONG else 1
    try:
        linear = Smoothed.of(problem, x)
        residuals = standardised_residuals(problem, linear)
        rng = np.random.default_rng(np.random.SeedSequence(0))
        verdict = noise_verdict(problem, row, linear.noises(problem, rng, probes), tracks)
    except RelnavError as error:
        return tracks, {"residuals_of": row, "missing": str(error)}
    return tuple(_with_residuals(t, row, residuals) for t in tracks), verdict
