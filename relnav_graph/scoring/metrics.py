"""Accuracy and consistency of tracks against truth, and the summary of a comparison.

RMSE is a norm over the axes; NEES is judged by chi-square bands (Bar-Shalom, Li,
Kirubarajan 2001, section 5.4). Errors and their signs: `relnav_graph.scoring.deviations`.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Collection, Iterable, Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.contracts import Derived
from relnav_graph.core.scored import AS_USUAL, Scored
from relnav_graph.core.state import Block
from relnav_graph.core.track import Kind, Track, Truth
from relnav_graph.errors import InputError
from relnav_graph.scoring.agreement import distances, row_cautions
from relnav_graph.scoring.alignment import aligned
from relnav_graph.scoring.deviations import (
    StateErrors,
    StateEstimates,
    at_the_end,
    deviations,
    errors,
    estimates,
    finite,
    joint,
    mean_nees,
)
from relnav_graph.scoring.estimated import estimate_row, sensor_rows
from relnav_graph.scoring.maps import family_scores
from relnav_graph.scoring.scores import Score, StateScore
from relnav_graph.scoring.text import table

__all__ = [
    "Score",
    "StateErrors",
    "StateScore",
    "errors",
    "estimates",
    "improvement",
    "require_same_kind",
    "score",
    "score_of",
    "step_ms",
    "summary",
    "table",
    "window_of",
    "with_smoothed",
]

#: The key of an ANEES as if the truth were exact, where it is not.
EXACT = "anees_without_truth_noise"


def _number(value: Any) -> float | None:
    """A float for strict JSON: None instead of NaN and infinity."""
    return float(value) if math.isfinite(value) else None


def _sigma(block: Block, P: Array, count: int) -> float | None:
    return _number(block.table_scale * np.sqrt(np.trace(P, axis1=1, axis2=2).mean() / count))


def _state_score(s: StateErrors) -> StateScore:
    scale = s.block.table_scale
    squared = (s.e**2).sum(axis=1) / len(s.blocks)
    S = s.S
    known = finite(s.e, S).all()
    size, sigma = np.abs(s.e), np.sqrt(np.diagonal(S, axis1=1, axis2=2))
    inside = [_number((size <= m * sigma).mean()) if known else None for m in (1, 2, 3)]
    anees, freedoms = mean_nees(s.e, S)
    return StateScore(
        unit=s.block.table_unit,
        sigma=_sigma(s.block, s.P, len(s.blocks)),
        t=s.t,
        rmse=_number(scale * np.sqrt(squared.mean())),
        rmse_last=_number(scale * np.sqrt(squared[-1])),
        anees=anees,
        freedoms=freedoms,
        inside_1sigma=inside[0],
        inside_2sigma=inside[1],
        inside_3sigma=inside[2],
        count=len(s.members) or None,
        anees_without_truth_noise=None if s.noise is None else mean_nees(s.e, s.P)[0],
    )


def window_of(t: Array, evaluate: tuple[float, float] | None) -> NDArray[np.bool_]:
    """Mask (N,) of the epochs t (N,) in the part `evaluate` of the pass, as two fractions of its
    length; None: all. Raises InputError when there are none."""
    a, b = evaluate or (0.0, 1.0)
    if not 0 <= a < b <= 1:
        raise InputError(f"evaluate: found {evaluate}, expected 0 <= start < end <= 1")
    fraction = (t - t[:1]) / max(np.ptp(t), 1e-9) if len(t) else t
    inside: NDArray[np.bool_] = (fraction > a - 1e-9) & (fraction < b + 1e-9)
    if not inside.any():
        raise InputError(f"evaluate: none of {len(t)} epochs lies within {a} to {b} of the pass")
    return inside


def score(
    track: Track,
    truth: Truth | None,
    derived: Sequence[Derived],
    evaluate: tuple[float, float] | None = None,
    without: Collection[str] = (),
) -> Score:
    """Scores of a track over the part `evaluate` (fractions) of its pass.

    Without truth, sigma alone. Raises InputError as :func:`errors` does, and on a window
    without epochs.
    """
    states = estimates(track, derived)
    found = {} if truth is None else deviations(states, track.t, truth, derived)
    return score_of(track, states, found, evaluate, truth, without)


@np.errstate(over="ignore", invalid="ignore")  # diverged tracks: None in the end
def score_of(
    track: Track,
    states: Mapping[str, StateEstimates],
    found: Mapping[str, StateErrors],
    evaluate: tuple[float, float] | None = None,
    truth: Truth | None = None,
    without: Collection[str] = (),
) -> Score:
    """:func:`score`, of a track's estimates and errors that are at hand already; truth: of the
    numbered blocks; without: names of blocks, see `Score.anees_without`."""
    inside = window_of(track.t, evaluate)
    found = {name: s.where(np.isin(s.t, track.t[inside])) for name, s in found.items()}
    found = {name: s for name, s in found.items() if len(s.t)}
    scores = _scores(states, found, inside)
    anees = mean_nees(*joint(found.values(), track, track.layout))
    also = _other_anees(found, track, without)
    if track.statics is None:
        return Score(track.name, track.kind, scores, *anees, **also)
    constants = {name: state for name, state in states.items() if state.constant}
    ends = at_the_end({name: s for name, s in found.items() if name in constants})
    last = np.arange(len(track.t)) == np.flatnonzero(inside)[-1]
    static = _scores(constants, ends, last)
    # Families at that epoch only: their joint covariances are large.
    end = track.at(np.isin(track.t, [s.t for s in ends.values()]) if ends else last)
    families, off = family_scores(end, truth)
    static |= _scores(families, off, np.ones(1, dtype=np.bool_))
    of_statics = mean_nees(*joint([*ends.values(), *off.values()], end, track.statics.layout))
    return Score(track.name, track.kind, scores, *anees, static, *of_statics, **also)


def _other_anees(
    found: Mapping[str, StateErrors], track: Track, without: Collection[str]
) -> dict[str, Any]:
    """Joint ANEES beside the one that counts all blocks and the truth's covariance."""
    out: dict[str, Any] = {}
    if any(s.noise is not None for s in found.values()):
        exact = mean_nees(*joint(found.values(), track, track.layout, truth_noise=False))
        out["anees_without_truth_noise"] = exact[0]
    if without:
        kept = [s for name, s in found.items() if name not in without]
        both = mean_nees(*joint(kept, track, track.layout))
        out |= dict(zip(("anees_without", "freedoms_without"), both, strict=True))
    return out


def _scores(
    states: Mapping[str, StateEstimates],
    found: Mapping[str, StateErrors],
    chosen: NDArray[np.bool_],
) -> dict[str, StateScore]:
    """Scores of states from their errors, of those without from sigma at epochs `chosen` (N,)."""
    return {
        name: _state_score(found[name]) if name in found else _sigma_alone(state, chosen)
        for name, state in states.items()
    }


def _sigma_alone(state: StateEstimates, chosen: NDArray[np.bool_]) -> StateScore:
    count = len(state.members)
    sigma = _sigma(state.block, state.P[chosen], max(count, 1))
    return StateScore(state.block.table_unit, sigma, count=count or None)


def improvement(a: Score, b: Score, state: str) -> float | None:
    """Part of the RMSE of `a` that `b` removes, ``1 - rmse_b / rmse_a``.

    None when one has no RMSE. Raises InputError when they were not scored on the same
    epochs, or do not know the state.
    """
    for one in (a, b):
        if state not in one.states:
            raise InputError(f"{one.name} has no state {state!r}; it has {list(one.states)}")
    first, second = a.states[state], b.states[state]
    if not np.array_equal(first.t, second.t):
        raise InputError(f"{state}: {a.name} and {b.name} were scored on different epochs")
    if not first.rmse or second.rmse is None:
        return None
    return 1 - second.rmse / first.rmse


def require_same_kind(tracks: Iterable[Track]) -> Kind:
    """The kind that all tracks share: call it before averaging tracks.

    Raises InputError when filtered, fixed-lag and smoothed estimates are mixed.
    """
    kinds = {track.name: track.kind for track in tracks}
    if len(set(kinds.values())) != 1:
        found = ", ".join(f"{name} is {kind}" for name, kind in kinds.items())
        raise InputError(f"expected tracks of one kind, found: {found or 'none'}")
    return next(iter(kinds.values()))


def with_smoothed(tracks: Iterable[Track]) -> dict[str, Track]:
    """Tracks by the name of their row. An online estimator has two rows: the second,
    ``NAME_smoothed``, is its smoothed estimate of the whole pass at the end."""
    found = {}
    for track in tracks:
        found[track.name] = track
        if track.smoothed is not None:
            found[f"{track.name}_smoothed"] = track.smoothed
    return found


def step_ms(step_s: Array | None) -> dict[str, dict[str, float | None]]:
    """Medians and 99th percentile, ms, of the computing times step_s (N,), s, of online steps, as
    ``{"step_ms": ...}``; {} without steps."""
    if step_s is None or not len(step_s):
        return {}
    ms, tenth = 1e3 * step_s, max(1, len(step_s) // 10)
    times = {
        "median": np.median(ms),
        "p99": np.percentile(ms, 99),
        "first_tenth_median": np.median(ms[:tenth]),
        "last_tenth_median": np.median(ms[-tenth:]),
    }
    return {"step_ms": {name: _number(value) for name, value in times.items()}}


def _state_row(s: StateScore) -> dict[str, Any]:
    names = ("rmse", "rmse_last", "sigma", "anees", "anees_band", "inside_3sigma")
    known = names if len(s.t) else ("sigma",)
    count = {} if s.count is None else {"count": s.count}
    exact = {EXACT: s.anees_without_truth_noise}
    noisy = {} if s.anees_without_truth_noise is None else exact
    return {"unit": s.unit} | count | {name: getattr(s, name) for name in known} | noisy


def _statics(s: Score) -> dict[str, Any]:
    """Of the static blocks, at the last epoch; {} without any."""
    if not s.statics:
        return {}
    left = ("rmse_last", "inside_3sigma")  # of one value: its error again, and hardly a fraction
    rows = {n: _state_row(one) for n, one in s.statics.items()}
    return {
        "statics": {n: {k: v for k, v in r.items() if k not in left} for n, r in rows.items()},
        "statics_anees": s.statics_anees,
        "statics_anees_band": s.statics_anees_band,
    }


def _told(row: dict[str, Any], track: Track, derived: Sequence[Derived], residuals: bool) -> Any:
    """A row with what can be told without truth: estimates of the states that it does not know,
    and residuals by sensor, where they are asked for."""
    found = estimates(track, derived)
    for part in ("states", "statics"):
        for name, one in row.get(part, {}).items():
            if "rmse" not in one and name in found:
                one |= estimate_row(found[name], track.t)
    return row | sensor_rows(track) if residuals else row


def _row(
    track: Track,
    s: Score,
    laid: Mapping[str, Any],
    distance: float | None,
    cautions: Iterable[Caution],
    without: Collection[str],
) -> dict[str, Any]:
    return {
        "kind": track.kind,
        "status": track.status,
        "message": track.message,
        "runtime_s": _number(track.runtime_s),
        **step_ms(track.step_s),
        "anees": s.anees,
        "anees_band": s.anees_band,
        **({} if s.anees_without_truth_noise is None else {EXACT: s.anees_without_truth_noise}),
        **_without(s, without),
        "distance": distance,
        "cautions": [vars(c) for c in cautions],
        "rejected": {sensor: int(n) for sensor, n in track.rejected.items()},
        "downweighted": {sensor: int(n) for sensor, n in track.downweighted.items()},
        **({"retired": list(track.retired)} if track.retired else {}),
        "states": {name: _state_row(state) for name, state in s.states.items()},
        **_statics(s),
        **({"aligned": laid} if laid else {}),
    }


def _without(s: Score, without: Collection[str]) -> dict[str, Any]:
    """Joint ANEES without some blocks; {} where none are named."""
    names = ("anees_without", "anees_without_band")
    return {name: getattr(s, name) for name in names} if without else {}


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the numbers."""
    packages = ("relnav-graph", "gtsam", "numpy", "numba")
    return {p: version(p) for p in packages} | {"python": platform.python_version()}


def summary(
    scenario_name: str,
    seed: int | None,
    tracks: Iterable[Track],
    truth: Truth | None,
    derived: Sequence[Derived],
    evaluate: tuple[float, float] | None,
    epochs: int,
    cautions: Sequence[Caution] = (),
    scored: Scored = AS_USUAL,
    noise: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The object that ``relnav compare --json`` prints: strict JSON, schema 1.

    truth: of tracks that have none of their own; cautions: of the pass; scored: what the scenario
    says of scores; noise: the verdict on the declared noises of a pass, see
    `relnav_graph.scoring.residuals.judge_by_residuals`. States that truth does not know have unit,
    sigma and the last estimate; of a recorded pass, which has no seed, and without any truth, rows
    have residuals by sensor. Raises InputError as :func:`score` does.
    """
    rows = with_smoothed(tracks)
    references, apart = distances(rows)
    own = row_cautions(rows, references, apart)
    of_pass = [{**vars(c), "estimator": None} for c in cautions]
    of_rows = [{**vars(c), "estimator": name} for name, found in own.items() for c in found]
    return {
        "schema": 1,
        "scenario": scenario_name,
        "seed": seed,
        "epochs": epochs,
        "versions": versions(),
        "cautions": of_pass + of_rows,
        **({"score": scored.describe()} if scored.describe() else {}),
        **({"noise": dict(noise)} if noise else {}),
        "estimators": {
            name: _told(
                _row(
                    track,
                    score(track, track.truth or truth, derived, evaluate, scored.without),
                    aligned(track, track.truth or truth, derived, window_of(track.t, evaluate)),
                    apart[name],
                    own[name],
                    scored.without,
                ),
                track,
                derived,
                seed is None or (track.truth or truth) is None,
            )
            for name, track in rows.items()
        },
    }
