"""The verdict of a study in plain words: which estimates tell the truth about themselves,
and which declared noise is the likely cause where they do not.

An ANEES or NIS is called inconsistent where it lies outside its chi-square band of
probability `LEVEL` (high, since many are judged at once) and means an error of sigma of more
than `TOLERANCE` (since with enough runs every small nonlinearity leaves the band).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scoring.deviations import chi2_band
from relnav_graph.scoring.metrics import EXACT
from relnav_graph.scoring.noise_verdict import NOTABLE, cause_text, noise_factors, noise_owners
from relnav_graph.study.collect import Collected, RowRuns

__all__ = ["verdict"]

LEVEL = 0.999
#: Relative error of sigma that is let pass.
TOLERANCE = 0.05


def _judge(ratio: float | None, freedoms: int) -> dict[str, Any] | None:
    """Judge sigma by a mean normalised square (ANEES, NIS), which is 1 where sigma is right.

    freedoms: degrees of freedom in the mean; factor = sqrt(ratio): true over estimated sigma.
    """
    if ratio is None or not freedoms:
        return None
    factor, (low, high) = math.sqrt(max(ratio, 0.0)), chi2_band(freedoms, 1, LEVEL)
    word = "consistent"
    if not low <= ratio <= high and abs(factor - 1) > TOLERANCE:
        word = "optimistic" if factor > 1 else "pessimistic"
    return {"verdict": word, "factor": factor}


def _judge_state(row: RowRuns, name: str, state: Mapping[str, Any]) -> dict[str, Any] | None:
    """Only runs are counted as independent: the epochs of one run are not."""
    runs = int(np.isfinite(row.of(name, "anees")).sum())
    return _judge(state.get("anees"), row.freedoms[name] * runs)


def _judge_sensor(row: RowRuns, name: str, sensor: Mapping[str, Any]) -> dict[str, Any] | None:
    """Innovations of a consistent filter are white: every residual row counts."""
    found = _judge(sensor["nis"], int(np.nansum(row.of_sensor(name, "rows"))))
    if found is None:
        return None
    lag, band = sensor["lag_correlation"], sensor["lag_band"]
    # 3.3 sigma: the same level as above.
    coloured = lag is not None and abs(lag) > max(3.3 / 1.96 * band[1], TOLERANCE)
    return {**found, "coloured": coloured, "lag_correlation": lag}


def _noises(row: RowRuns) -> list[dict[str, Any]]:
    """The factor of each declared sigma, with its 95 % interval."""
    squares = np.array(list(row.squares.values()))  # (groups, runs)
    runs = int(np.isfinite(squares).all(axis=0).sum())
    total = np.where(np.isfinite(squares), squares, 0.0).sum(axis=1)
    return noise_factors(list(row.squares), total, runs * np.array(row.coupling))


def _state_text(name: str, row: Mapping[str, Any], states: Mapping[str, Any]) -> str:
    wrong = {s: v for s, v in states.items() if v["verdict"] != "consistent"}
    if not wrong:
        return f"{name} ({row['kind']}): consistent in all {len(states)} states."
    words = [f"{s} {v['verdict']} ({v['factor']:.2f})" for s, v in wrong.items()]
    return (
        f"{name} ({row['kind']}): errors in units of the estimated sigma, where not 1: "
        + ", ".join(words)
        + "."
    )


def _sensor_text(name: str, sensor: str, v: Mapping[str, Any]) -> str | None:
    parts = []
    if v["verdict"] != "consistent":
        parts.append(f"its innovations are {v['factor']:.2f} times as large as expected")
    if v["coloured"]:
        parts.append(f"they are correlated in time ({v['lag_correlation']:+.2f} with the last)")
    return f"{name}: sensor {sensor}: {'; '.join(parts)}." if parts else None


def _best_smoothed(found: Collected) -> str | None:
    """The smoothed row of least mean cost: its residuals are nearest to the optimum's."""
    costs = {
        name: float(np.nanmean(row.own["cost"]))
        for name, row in found.rows.items()
        if "cost" in row.own and row.coupling
    }
    return min(costs, key=costs.__getitem__) if costs else None


def verdict(
    summary: Mapping[str, Any], found: Collected, scenario: Scenario, same: Sequence[str] = ()
) -> dict[str, Any]:
    """What the summary and the residuals say, with sentences for people in `text`.

    same: sensors and inputs that are recorded, and so the same in every run.
    """
    states, sensors, text = dict[str, Any](), dict[str, dict[str, Any]](), list[str]()
    for name, row in summary["estimators"].items():
        runs = found.rows[name]
        judged = {s: _judge_state(runs, s, v) for s, v in row["states"].items()}
        states[name] = {s: v for s, v in judged.items() if v is not None}
        if states[name]:
            text.append(_state_text(name, row, states[name]))
        heard = {s: _judge_sensor(runs, s, v) for s, v in row["sensors"].items()}
        sensors[name] = {s: v for s, v in heard.items() if v is not None}
        text += [_sensor_text(name, s, v) or "" for s, v in sensors[name].items()]
    if any(row.get(EXACT) is not None for row in summary["estimators"].values()):
        text.append("The truth's own covariance is counted: its noise is no error of an estimate.")
    best = _best_smoothed(found)
    noises = _noises(found.rows[best]) if best else []
    causes = [n for n in noises if n["named"]]
    owners = noise_owners(scenario.sensors, scenario.processes)
    text += ["Likely cause: " + cause_text(n, owners) + "." for n in causes]
    if best and causes:
        text.append(_unexplained(best, found.rows[best], summary["estimators"][best], noises))
    text += _cautioned(summary)
    if same:
        text.append(
            f"Recorded, and so the same in every run: {', '.join(same)}. What they err by does not"
            " average out over runs, as intervals and bands take it to."
        )
    text.append(_closing(summary, states, sensors, best, causes))
    return {
        "states": states,
        "sensors": sensors,
        "residuals_of": best,
        "noises": noises,
        "causes": [n["noise"] for n in causes],
        "text": [t for t in text if t],
    }


def _cautioned(summary: Mapping[str, Any]) -> list[str]:
    """A sentence for each row that has a caution in some runs."""
    found: dict[str, list[str]] = {}
    for c in summary["cautions"]:
        found.setdefault(c["estimator"] or "The pass", []).append(f"{c['name']} {c['runs']}")
    return [
        f"{name}: runs with a caution, of {summary['runs']}: {', '.join(counts)}."
        for name, counts in found.items()
    ]


def _unexplained(
    best: str, runs: RowRuns, row: Mapping[str, Any], noises: list[dict[str, Any]]
) -> str:
    """A sentence where errors of the smoothed row are larger than wrong noises could make them.

    Its errors are a linear function of all noises: where none is more than f times as large as
    declared, no error is more than f times as large as its sigma says. The rest is in what is not
    noise: a constant that is taken as known bends a whole pass, and residuals show only a part.
    """
    most = max([NOTABLE, *(n["factor_ci"][1] for n in noises if n["tested"])])
    beyond = {}
    for name, state in row["states"].items():
        if state.get("anees") is not None:
            counted = runs.freedoms[name] * int(np.isfinite(runs.of(name, "anees")).sum())
            rest = _judge(state["anees"] / most**2, counted)
            if rest is not None and rest["verdict"] == "optimistic":
                beyond[name] = rest["factor"] * most
    if not beyond:
        return ""
    worst = max(beyond, key=beyond.__getitem__)
    up_to, found = (f"{float(f'{value:.3g}'):g}" for value in (most, beyond[worst]))
    return (
        f"As far as residuals show, noises explain errors of {best} up to {up_to} of its sigmas;"
        f" {worst} has {found}. The rest lies where no residual shows it: priors, or a constant"
        " that is not estimated."
    )


def _closing(
    summary: Mapping[str, Any],
    states: Mapping[str, Any],
    sensors: Mapping[str, Any],
    best: str | None,
    causes: list[dict[str, Any]],
) -> str:
    """The last sentence, where something is inconsistent and no noise is a likely cause."""
    wrong = [
        name
        for name in states
        if any(
            v["verdict"] != "consistent" for v in [*states[name].values(), *sensors[name].values()]
        )
    ]
    if causes or not wrong:
        return ""
    if best is None:
        return "A smoother in the study (rts, batch) would tell which noise is the likely cause."
    if best in wrong:
        # A constant that is taken as known bends the whole pass alike: residuals hardly tell.
        optimistic = any(v["verdict"] == "optimistic" for v in states[best].values())
        constant = ", or a constant that is not estimated" if optimistic else ""
        return (
            f"No declared noise explains it: the residuals of {best} are as declared. What is"
            " wrong lies where no residual shows it: priors, or directions that no sensor sees"
            f"{constant}."
        )
    return (
        f"No declared noise explains it: the residuals of {best} are as declared, and its"
        f" covariances true. What is wrong is the linearisation of {', '.join(wrong)}, or"
        " what it leaves out of the model."
    )
