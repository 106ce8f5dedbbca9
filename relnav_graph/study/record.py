"""The record of one run of a study: of a fixed size, however long the pass.

A record holds scalars, kept for each run because intervals over runs need them, and series
over the pass in at most `BINS` bins, which are summed over runs. So the memory of a study
does not grow with its runs, and its folder only by some hundred kilobytes a run.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.contracts import Derived
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.memory import check_room
from relnav_graph.runs.comparison import Estimated
from relnav_graph.scoring.agreement import distances, row_cautions
from relnav_graph.scoring.alignment import aligned
from relnav_graph.scoring.bounds import bounds, true_trajectory
from relnav_graph.scoring.deviations import (
    StateErrors,
    StateEstimates,
    deviations,
    estimates,
    joint,
    nees,
)
from relnav_graph.scoring.estimated import innovation_sums
from relnav_graph.scoring.metrics import (
    EXACT,
    Score,
    StateScore,
    score_of,
    step_ms,
    window_of,
    with_smoothed,
)
from relnav_graph.scoring.variance_components import noise_residuals
from relnav_graph.study.stored import check_record

__all__ = ["BINS", "RunRecord", "make_record"]

#: Most intervals of time into which the epochs of a pass are averaged.
BINS = 100
#: Runs in which the coupling of the noises is estimated: it hardly differs between runs.
COUPLED_RUNS = 8
#: Series of a state: mean squared error, mean NEES per freedom, mean trace of P; SI.
SERIES = ("squared_error", "nees", "trace")


@dataclass(frozen=True, eq=False)
class RunRecord:
    """What a study keeps of one run: scalars, a tree that JSON can hold, and series by name.

    Series: ``ROW`` (states + 1, 3, bins), see `SERIES`; ``nis ROW`` (sensors, bins); ``bound
    KIND`` (states + 1, 3, bins); ``coupling ROW`` (noises, noises). Scalars: ``rows``,
    ``bound``, ``noise``, ``timing``, ``cautions``, ``mcreynolds``, each by row or kind; or
    ``failed``.
    """

    scalars: Mapping[str, Any]
    series: Mapping[str, Array]

    def to_bytes(self) -> bytes:
        """A NumPy archive; each member bears a checksum."""
        image = io.BytesIO()
        text = np.frombuffer(json.dumps(self.scalars).encode(), dtype=np.uint8)
        np.savez(image, allow_pickle=False, scalars=text, **self.series)
        return image.getvalue()

    @staticmethod
    def from_bytes(content: bytes, where: str) -> RunRecord:
        """The inverse of :meth:`to_bytes`. Raises InputError on damaged content."""
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                size = sum(member.file_size for member in archive.infolist())
            check_room(f"a record, {where}, whose arrays", size / 8)
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                series = {name: arrays[name] for name in arrays.files}
            text = series.pop("scalars").tobytes()
        except InputError:
            raise
        except Exception as error:  # damaged bytes lead zipfile and numpy to all kinds of errors
            raise InputError(f"{where}: not a readable record of a run: {error}") from error
        return RunRecord(check_record(where, text, series), series)


def bin_edges(count: int) -> Indices:
    """First epoch of each bin, and the epoch after the last: (bins + 1,)."""
    return np.linspace(0, count, min(count, BINS) + 1).round().astype(np.int64)


def _binned(at: Indices, values: Array, count: int) -> Array:
    """Means (bins,) of values (m,) at the epochs `at` (m,) of `count`; NaN in an empty bin."""
    edges = bin_edges(count)
    where = np.searchsorted(edges, at, side="right") - 1
    n = len(edges) - 1
    seen = np.bincount(where, minlength=n)
    with np.errstate(invalid="ignore"):
        return np.array(np.bincount(where, values, n) / seen)


def _settled(s: StateErrors, bound: StateEstimates | None) -> float | None:
    """Time of convergence from the first epoch, s: from then on |e|^2 <= 9 max(trace P_bound),
    the maximum over the second half of the pass. None where the error never settles."""
    if bound is None:
        return None
    trace = np.trace(bound.P, axis1=1, axis2=2)
    if s.noise is not None:  # nor can an error be smaller than the truth's own
        trace = trace + float(np.trace(s.noise.T, axis1=1, axis2=2).max(initial=0.0))
    limit = 9 * trace[len(trace) // 2 :].max()
    beyond = np.flatnonzero(~((s.e**2).sum(axis=1) <= limit))
    if not len(beyond):
        return 0.0
    return float(s.t[beyond[-1] + 1] - s.t[0]) if beyond[-1] + 1 < len(s.t) else None


def _state_scalars(name: str, score: Score, settled: float | None) -> dict[str, Any]:
    s = score.states[name]
    known = ("rmse", "rmse_last", "anees", "freedoms", EXACT)
    inside = ("inside_1sigma", "inside_2sigma", "inside_3sigma")
    values = {key: getattr(s, key) for key in (*known, *inside)} if len(s.t) else {}
    return {"unit": s.unit, "sigma": s.sigma, **values, "settled_s": settled}


def _statics_scalars(score: Score, bound: Mapping[str, StateScore]) -> dict[str, Any]:
    """Of the static blocks at the last epoch, bound: their bounds there; {} without any."""
    if not score.statics:
        return {}
    keys = ("unit", "sigma", "rmse", "anees", "freedoms", "count")
    statics = {
        name: {key: getattr(s, key) for key in keys}
        | {"bound": bound[name].sigma if name in bound else None}
        for name, s in score.statics.items()
    }
    joint_of = {"anees": score.statics_anees, "freedoms": score.statics_freedoms}
    return {"statics": statics, "statics_joint": joint_of}


def _aligned_scalars(found: Mapping[str, Any]) -> dict[str, Any]:
    """What the alignment of a map leaves, see `relnav_graph.scoring.alignment.aligned`; {} without
    one. scale_error: of the alignment with a scale, scale - 1."""
    if not found:
        return {}
    keys = ("rotation_deg", "shift_m", "map_rmse_m", "map_max_m")
    numbers = {key: found[key] for key in keys} | {"scale_error": found["scale"] - 1}
    return {"aligned": numbers | {"states": found["states"]}}


def _mcreynolds(
    filtered: Mapping[str, StateEstimates], smoothed: Mapping[str, StateEstimates]
) -> dict[str, dict[str, float]]:
    """Filter-smoother consistency (McReynolds 1980; Gelb 1974, sec. 5.4; Jerath, Lichten).

    The difference d of both estimates has the covariance P_f - P_s where both are right: the
    mean of d_i^2 / (P_f - P_s)_ii over epochs and components, and the fraction below 3^2.
    """
    found = {}
    for name, f in filtered.items():
        s = smoothed.get(name)
        if s is None or f.block != s.block:
            continue
        d = f.to(s.value)
        variance = np.diagonal(f.P - s.P, axis1=1, axis2=2)
        # Where smoothing gains nothing the ratio is one of rounding errors.
        tested = variance > 1e-6 * np.diagonal(f.P, axis1=1, axis2=2)
        tested &= np.isfinite(d) & np.isfinite(variance)
        if tested.any():
            ratio = d[tested] ** 2 / variance[tested]
            found[name] = {
                "mean_square": float(ratio.mean()),
                "inside_3sigma": float((ratio <= 9).mean()),
            }
    return found


@dataclass(frozen=True, eq=False)
class _Row:
    """A track with its estimates, and its errors where truth knows them, by state."""

    track: Track
    states: Mapping[str, StateEstimates]
    found: Mapping[str, StateErrors]


def _series(row: _Row, order: Sequence[str]) -> Array:
    """Means (states + 1, 3, bins) of the three `SERIES`: of each state in `order`, then of all
    blocks jointly, for which there is NEES only."""
    t, count = row.track.t, len(row.track.t)
    out = np.full((len(order) + 1, len(SERIES), len(bin_edges(count)) - 1), np.nan)
    epochs = np.arange(count)
    for k, name in enumerate(order):
        state = row.states[name]
        out[k, 2] = _binned(epochs, np.trace(state.P, axis1=1, axis2=2), count)
        if name in row.found:
            s = row.found[name]
            at = np.searchsorted(t, s.t - 1e-9)
            value, rank = nees(s.e, s.S)
            out[k, 0] = _binned(at, (s.e**2).sum(axis=1), count)
            out[k, 1] = _binned(at, value / np.maximum(rank, 1), count)
    e, P = joint(row.found.values(), row.track, row.track.layout)
    if len(e) == count:
        value, rank = nees(e, P)
        out[-1, 1] = _binned(epochs, value / np.maximum(rank, 1), count)
    return out


def _nis_series(track: Track, order: Sequence[str]) -> Array:
    """Mean NIS per residual row (sensors, bins)."""
    count = len(track.t)
    out = np.full((len(order), len(bin_edges(count)) - 1), np.nan)
    for k, name in enumerate(order):
        i = track.innovations[name]
        out[k] = _binned(np.searchsorted(track.t, i.t - 1e-9), i.nis / i.rows, count)
    return out


def _row_scalars(
    row: _Row,
    score: Score,
    bound: Mapping[str, StateEstimates],
    constants: Mapping[str, StateScore],
    laid: Mapping[str, Any],
) -> dict[str, Any]:
    """bound: estimates whose covariances are the bounds; constants: scores of static blocks
    whose sigmas are; laid: after the alignment of the map."""
    track = row.track
    settled = {
        name: _settled(row.found[name], bound.get(name)) if name in row.found else None
        for name in row.states
    }
    return {
        "kind": track.kind,
        "status": track.status,
        "message": track.message,
        "rejected": {k: int(v) for k, v in track.rejected.items()},
        "anees": score.anees,
        "freedoms": score.freedoms,
        EXACT: score.anees_without_truth_noise,
        "anees_without": score.anees_without,
        "freedoms_without": score.freedoms_without,
        "states": {n: _state_scalars(n, score, settled[n]) for n in score.states},
        "innovations": {n: innovation_sums(i) for n, i in track.innovations.items()},
        **_statics_scalars(score, constants),
        **_aligned_scalars(laid),
    }


@dataclass(frozen=True, eq=False)
class _Limits:
    """Lower bounds of a pass: states (estimates whose covariance is the bound) and sigmas (over
    the scored part) by kind and state, statics (at the last epoch) likewise, series by kind."""

    states: Mapping[str, Mapping[str, StateEstimates]]
    sigmas: Mapping[str, Mapping[str, float | None]]
    statics: Mapping[str, Mapping[str, StateScore]]
    series: Mapping[str, Array]


def _limits(
    problem: Problem, x: Array, derived: Sequence[Derived], evaluate: tuple[float, float] | None
) -> _Limits:
    """The bounds along the true states x (N, size). Raises RelnavError when there are none."""
    limit = bounds(problem, x)
    states: dict[str, Mapping[str, StateEstimates]] = {}
    sigmas: dict[str, Mapping[str, float | None]] = {}
    statics: dict[str, Mapping[str, StateScore]] = {}
    series: dict[str, Array] = {}
    for track in (limit.filtered, limit.smoothed):
        states[track.kind] = estimates(track, derived)
        found = score_of(track, states[track.kind], {}, evaluate)
        sigmas[track.kind] = {n: s.sigma for n, s in found.states.items()}
        statics[track.kind] = found.statics
        row = _Row(track, states[track.kind], {})
        series[track.kind] = _series(row, list(row.states))
    return _Limits(states, sigmas, statics, series)


def make_record(
    run: int,
    passes: Sequence[Estimated],
    derived: Sequence[Derived],
    evaluate: tuple[float, float] | None,
    rng: np.random.Generator,
    without: Collection[str] = (),
) -> RunRecord:
    """The record of a run: of one pass, or of several where each estimator has flown its own.

    Bounds are taken along each truth; passes with the same true states, as of a target that
    no control moves, share them. rng: for what is estimated by random probes; without: see
    `relnav_graph.scoring.scores.Score`. Raises
    InputError where truth and tracks do not fit together.
    """
    parts = ("rows", "bound", "noise", "timing", "cautions")
    scalars: dict[str, Any] = {"run": run, **{part: {} for part in parts}}
    series: dict[str, Array] = {}
    rows: dict[str, _Row] = {}
    x_before, limits = np.zeros(0), None
    for one in passes:
        problem, truth = one.problem, one.truth
        try:
            x = true_trajectory(problem, truth)
            if limits is None or not np.array_equal(x, x_before):
                x_before, limits = x, _limits(problem, x, derived, evaluate)
        except RelnavError as error:
            scalars["bound_missing"], limits = str(error), None
        if limits is not None and not scalars["bound"]:  # figures show those of the first pass
            scalars["bound"] |= limits.sigmas
            series |= {f"bound {kind}": s for kind, s in limits.series.items()}
        tracks = with_smoothed(one.tracks)
        scalars["cautions"] |= _cautions(problem, tracks)
        for name, track in tracks.items():
            states = estimates(track, derived)
            errors = {} if truth is None else deviations(states, track.t, truth, derived)
            row = rows[name] = _Row(track, states, errors)
            score = score_of(track, states, errors, evaluate, truth, without)
            laid = aligned(track, truth, derived, window_of(track.t, evaluate))
            kind = "filtered" if track.kind == "filtered" else "smoothed"
            own = {} if limits is None else limits.states[kind]
            # A fixed-lag estimate lies between both bounds, and has none of its own.
            constants = {} if limits is None else limits.statics.get(track.kind, {})
            scalars["rows"][name] = _row_scalars(row, score, own, constants, laid)
            if limits is not None and len(passes) > 1:
                scalars["rows"][name]["bound"] = limits.sigmas.get(track.kind, {})
            scalars["timing"][name] = {"runtime_s": track.runtime_s, **step_ms(track.step_s)}
            series[name] = _series(row, list(states))
            series[f"nis {name}"] = _nis_series(track, list(track.innovations))
            if track.kind == "smoothed" and track.status != "diverged":
                probes = rng if run < COUPLED_RUNS else None
                _add_noise(scalars, series, name, problem, track, probes)
    scalars["mcreynolds"] = {
        f: {s: _mcreynolds(a.states, b.states) for s, b in rows.items() if _pair(a, b)}
        for f, a in rows.items()
        if a.track.kind == "filtered"
    }
    return RunRecord(scalars, series)


def _cautions(problem: Problem, tracks: Mapping[str, Track]) -> dict[str, list[str]]:
    """Names of the cautions of each row that has any, and, as "", of the pass."""
    rows = {"": problem.cautions} | row_cautions(tracks, *distances(tracks))
    named = {row: list(dict.fromkeys(c.name for c in found)) for row, found in rows.items()}
    return {row: names for row, names in named.items() if names}


def _pair(a: _Row, b: _Row) -> bool:
    """Whether b smooths, without divergence, the pass that a has filtered."""
    if a.track.truth is not b.track.truth:
        return False
    return b.track.kind == "smoothed" and "diverged" not in (a.track.status, b.track.status)


def _add_noise(
    scalars: dict[str, Any],
    series: dict[str, Array],
    name: str,
    problem: Problem,
    track: Track,
    rng: np.random.Generator | None,
) -> None:
    try:
        found = noise_residuals(problem, track.states, rng)
    except RelnavError as error:
        scalars["noise"][name] = {"missing": str(error)}
        return
    scalars["noise"][name] = {"squares": dict(found.squares), "cost": found.cost}
    if found.coupling is not None:
        series[f"coupling {name}"] = found.coupling
