"""The summary of a study: accuracy with intervals, consistency with bands, bounds.

RMSE intervals and paired differences are 95 % percentile intervals of a bootstrap over
runs (Efron and Tibshirani 1993, ch. 13): runs are independent, epochs of a run are not.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.scoring.deviations import chi2_band
from relnav_graph.scoring.metrics import EXACT, versions
from relnav_graph.study.collect import Collected, RowRuns
from relnav_graph.study.runs import StudySpec

__all__ = ["rmse_precision", "summarize"]

#: Samples of each bootstrap.
RESAMPLES = 1000


def _number(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(_mean(values**2)))


def _bootstrap(columns: Array, seed: int) -> Array:
    """Bootstrap means (RESAMPLES, m) of columns (runs, m): each is over runs drawn with
    replacement, the same for all columns; NaN, a run without a number, does not count."""
    runs = len(columns)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0xB007,)))
    known = np.isfinite(columns)
    values, out = np.where(known, columns, 0.0), []
    for _ in range(0, RESAMPLES, 100):  # in parts: memory for many runs
        times = rng.multinomial(runs, np.full(runs, 1 / runs), size=100).astype(np.float64)
        with np.errstate(invalid="ignore"):
            out.append((times @ values) / (times @ known))
    return np.concatenate(out)


def _interval(samples: Array) -> list[float] | None:
    known = samples[np.isfinite(samples)]
    if not len(known):
        return None
    low, high = np.percentile(known, (2.5, 97.5))
    return [float(low), float(high)]


def _rmse_intervals(rows: dict[str, RowRuns], seed: int) -> dict[tuple[str, str], Any]:
    """95 % interval of the RMSE over runs, by row and state; none for fewer than two runs."""
    keys = [(name, state) for name, row in rows.items() for state in row.units]
    return _intervals({k: rows[k[0]].of(k[1], "rmse") ** 2 for k in keys}, seed)


def _intervals(squares: dict[tuple[str, str], Array], seed: int) -> dict[tuple[str, str], Any]:
    """95 % intervals of root mean squares over runs, from a column (runs,) for each."""
    columns = {k: v for k, v in squares.items() if np.isfinite(v).sum() > 1}
    if not columns:
        return {}
    means = _bootstrap(np.column_stack(list(columns.values())), seed)
    return {k: _interval(np.sqrt(m)) for k, m in zip(columns, means.T, strict=True)}


def rmse_precision(found: Collected, seed: int) -> float:
    """Half the width of an RMSE's 95 % interval divided by the RMSE, the largest of all rows
    and states; infinite without any interval."""
    widest = 0.0
    for (name, state), interval in _rmse_intervals(found.rows, seed).items():
        rmse = _root_mean_square(found.rows[name].of(state, "rmse"))
        if interval is not None and rmse > 0:
            widest = max(widest, (interval[1] - interval[0]) / (2 * rmse))
    return widest or math.inf


def _band(freedoms: int, runs: int) -> list[float] | None:
    return list(chi2_band(freedoms, runs)) if freedoms and runs else None


def _state(row: RowRuns, name: str, bound: Array, interval: Any) -> dict[str, Any]:
    rmse, runs = row.of(name, "rmse"), int(np.isfinite(row.of(name, "anees")).sum())
    out: dict[str, Any] = {"unit": row.units[name]}
    if len(rmse):
        total, limit = _root_mean_square(rmse), _root_mean_square(bound[np.isfinite(rmse)])
        out |= {
            "rmse": _number(total),
            "rmse_ci": interval,
            "rmse_last": _number(_root_mean_square(row.of(name, "rmse_last"))),
        }
    out["sigma"] = _number(_root_mean_square(row.of(name, "sigma")))
    if len(rmse):
        settled = row.of(name, "settled_s")[np.isfinite(rmse)]
        done = settled[np.isfinite(settled)]
        out |= {
            "bound": _number(limit),
            "efficiency": _number(total / limit) if limit > 0 else None,
            "anees": _number(_mean(row.of(name, "anees"))),
            "anees_band": _band(row.freedoms[name], runs),
            **_exact(row.of(name, EXACT)),
            **{k: _number(_mean(row.of(name, k))) for k in _INSIDE},
            "convergence_s": _number(np.median(done)) if len(done) else None,
            "converged": len(done) / len(settled) if len(settled) else None,
        }
    return out


def _statics(name: str, row: RowRuns, seed: int) -> dict[str, Any]:
    """Static blocks as at the last epoch of each run; {} without any."""
    if not row.statics:
        return {}
    squares = {(name, block): row.of_static(block, "rmse") ** 2 for block in row.statics}
    intervals, blocks = _intervals(squares, seed), {}
    for block in row.statics:
        rmse, bound = row.of_static(block, "rmse"), row.of_static(block, "bound")
        total, limit = _root_mean_square(rmse), _root_mean_square(bound[np.isfinite(rmse)])
        count = row.of_static(block, "count")
        blocks[block] = {
            "unit": row.static_units[block],
            **({"count": _number(_mean(count))} if np.isfinite(count).any() else {}),
            "rmse": _number(total),
            "rmse_ci": intervals.get((name, block)),
            "sigma": _number(_root_mean_square(row.of_static(block, "sigma"))),
            "bound": _number(limit),
            "efficiency": _number(total / limit) if limit > 0 else None,
            **_anees_of(row, block, ""),
        }
    return {"statics": blocks, **_anees_of(row, "", "statics_")}


def _aligned(row: RowRuns) -> dict[str, Any]:
    """What the alignment of each run's map leaves, root mean squares over runs (of the largest
    error: the largest); {} without a map."""
    if not row.aligned:
        return {}
    found: dict[str, Any] = {"states": {}}
    for (state, key), column in row.aligned.items():
        values = np.array(column)
        over = np.nanmax(values, initial=0) if key == "map_max_m" else _root_mean_square(values)
        if state:
            found["states"][state] = {"unit": row.static_units[state], key: _number(over)}
        else:
            found[key] = _number(over)
    return {"aligned": found}


def _anees_of(row: RowRuns, block: str, prefix: str) -> dict[str, Any]:
    """ANEES over runs of a static block ("": of all jointly), and its band."""
    anees, freedoms = row.of_static(block, "anees"), row.of_static(block, "freedoms")
    band = _band(int(np.nanmax(freedoms, initial=0)), int(np.isfinite(anees).sum()))
    return {f"{prefix}anees": _number(_mean(anees)), f"{prefix}anees_band": band}


_INSIDE = ("inside_1sigma", "inside_2sigma", "inside_3sigma")


def _sensor(row: RowRuns, name: str) -> dict[str, Any]:
    """NIS per residual row, and the lag-1 correlation of whitened innovations, with bands.

    Innovations of a consistent filter are white, so that every residual row of every run
    counts as independent and narrows the bands.
    """
    nis, rows, product, lag_rows = (
        np.nansum(row.of_sensor(name, k)) for k in ("nis", "rows", "lag_product", "lag_rows")
    )
    edge = 1.96 / math.sqrt(lag_rows) if lag_rows else None
    return {
        "nis": _number(nis / rows),
        "nis_band": _band(int(rows), 1),
        "lag_correlation": _number(product / lag_rows) if lag_rows else None,
        "lag_band": None if edge is None else [-edge, edge],
    }


def _exact(values: Array) -> dict[str, Any]:
    """ANEES as if the truth were exact, of values (runs,); {} where it is."""
    return {EXACT: _number(_mean(values))} if np.isfinite(values).any() else {}


def _without(row: RowRuns) -> dict[str, Any]:
    """Joint ANEES without the blocks that the scenario names; {} where it names none."""
    values = np.array(row.own.get("anees_without", []))
    runs, freedoms = int(np.isfinite(values).sum()), row.freedoms.get("without", 0)
    if not runs:
        return {}
    return {"anees_without": _number(_mean(values)), "anees_without_band": _band(freedoms, runs)}


def _timing(row: RowRuns) -> dict[str, Any]:
    medians = {k: _number(np.nanmedian(v)) for k, v in row.timing.items()}
    steps = {k: v for k, v in medians.items() if k != "runtime_s"}
    return {"runtime_s": medians.get("runtime_s"), **({"step_ms": steps} if steps else {})}


def _status(row: RowRuns, runs: int) -> tuple[str, str]:
    counts = {s: sum(1 for _, found, _ in row.bad if found == s) for s in ("diverged", "degraded")}
    if not row.bad:
        return "ok", ""
    words = " and ".join(f"{n} {status}" for status, n in counts.items() if n)
    return "degraded" if counts["diverged"] < runs else "diverged", f"of {runs} runs {words}"


def _row(
    name: str, found: Collected, intervals: dict[tuple[str, str], Any], seed: int
) -> dict[str, Any]:
    row = found.rows[name]
    status, message = _status(row, len(found.runs))
    anees = np.array(row.own.get("anees", []))
    counted = int(np.isfinite(anees).sum())
    # A fixed-lag estimate lies between both bounds, and has none of its own.
    none = [np.nan] * len(found.runs)
    bound = {
        s: np.array(found.own_bound.get((name, s), found.bound.get((row.kind, s), none)))
        for s in row.units
    }
    return {
        "kind": row.kind,
        "status": status,
        "message": message,
        **_timing(row),
        "runs": len(found.runs) - len(found.failed) - sum(s == "diverged" for _, s, _ in row.bad),
        "anees": _number(_mean(anees)),
        "anees_band": _band(row.freedoms.get("joint", 0), counted),
        **_exact(np.array(row.own.get(EXACT, []))),
        **_without(row),
        "rejected": row.rejected,
        "states": {s: _state(row, s, bound[s], intervals.get((name, s))) for s in row.units},
        **_statics(name, row, seed),
        **_aligned(row),
        "sensors": {s: _sensor(row, s) for s in dict.fromkeys(s for s, _ in row.sensor)},
    }


def _paired(rows: dict[str, RowRuns], seed: int) -> list[dict[str, Any]]:
    """Improvement 1 - RMSE_b / RMSE_a of each pair of rows, on the runs that both have."""
    keys, columns = [], []
    for a, b in combinations(rows, 2):
        for state in rows[a].units:
            first, second = rows[a].of(state, "rmse"), rows[b].of(state, "rmse")
            if len(first) and len(second):
                both = np.isfinite(first) & np.isfinite(second)
                if both.sum() > 1:
                    keys.append((a, b, state))
                    columns += [np.where(both, v**2, np.nan) for v in (first, second)]
    if not keys:
        return []
    table = np.column_stack(columns)
    means = _bootstrap(table, seed)
    out: dict[tuple[str, str], dict[str, Any]] = {}
    for k, (a, b, state) in enumerate(keys):
        first, second = table[:, 2 * k], table[:, 2 * k + 1]
        both = np.isfinite(first)
        one = {
            "improvement": _number(1 - math.sqrt(_mean(second) / _mean(first)))
            if _mean(first) > 0
            else None,
            "improvement_ci": _interval(1 - np.sqrt(means[:, 2 * k + 1] / means[:, 2 * k]))
            if _mean(first) > 0
            else None,
            "better_in": float((second < first)[both].mean()),
            "runs": int(both.sum()),
        }
        pair = {"a": a, "b": b, "kinds": [rows[a].kind, rows[b].kind], "states": {}}
        out.setdefault((a, b), pair)["states"][state] = one
    return list(out.values())


def _mcreynolds(found: Collected) -> list[dict[str, Any]]:
    pairs: dict[tuple[str, str], dict[str, Any]] = {}
    for (filtered, smoothed, state, key), values in found.mcreynolds.items():
        pair = {"filtered": filtered, "smoothed": smoothed, "states": {}}
        states = pairs.setdefault((filtered, smoothed), pair)["states"]
        states.setdefault(state, {})[key] = _number(_mean(np.array(values)))
    return list(pairs.values())


def _bad_runs(found: Collected, rerun: str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Runs without a result, and those with one not to be trusted, with the command that
    runs each of them alone."""
    failed: list[dict[str, Any]] = [
        {"run": run, "estimator": None, "status": "failed", "message": text,
         "command": f"{rerun} --run {run}"}
        for run, text in found.failed
    ]  # fmt: skip
    degraded: list[dict[str, Any]] = []
    for name, row in found.rows.items():
        kind = name.removesuffix("_smoothed")
        for run, status, text in row.bad:
            one = {
                "run": run,
                "estimator": name,
                "status": status,
                "message": text,
                "command": f"{rerun} --run {run} -e {kind}",
            }
            (failed if status == "diverged" else degraded).append(one)
    return failed, degraded


#: Runs with a caution that are listed.
LISTED = 10


def _cautions(found: Collected) -> list[dict[str, Any]]:
    """How many runs have each caution, by row and name, and which; estimator None: of the pass."""
    return [
        {
            "estimator": row or None,
            "name": name,
            "runs": len(runs),
            "text": f"in {len(runs)} of {len(found.runs)} runs: "
            + ", ".join(map(str, runs[:LISTED]))
            + (", ..." if len(runs) > LISTED else ""),
        }
        for (row, name), runs in sorted(found.cautions.items())
    ]


def summarize(spec: StudySpec, found: Collected, epochs: int, rerun: str) -> dict[str, Any]:
    """The object of ``relnav study --json``, without its verdict: strict JSON, schema 1.

    rerun: the command that runs one run of the study alone, but for its number.
    """
    intervals = _rmse_intervals(found.rows, spec.seed)
    failed, degraded = _bad_runs(found, rerun)
    return {
        "schema": 1,
        "scenario": spec.name,
        "seed": spec.seed,
        "epochs": epochs,
        "runs": len(found.runs),
        "failed": failed,
        "degraded": degraded,
        "cautions": _cautions(found),
        "versions": versions(),
        "estimators": {name: _row(name, found, intervals, spec.seed) for name in found.rows},
        "paired": _paired(found.rows, spec.seed),
        "mcreynolds": _mcreynolds(found),
    }
