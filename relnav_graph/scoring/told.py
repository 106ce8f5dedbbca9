"""What a pass tells without truth, as text: estimates with their sigmas, and what residuals say."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from relnav_graph.scoring.columns import aligned_columns
from relnav_graph.scoring.noise_verdict import noise_said

__all__ = ["estimate_lines", "told_lines", "value_text"]


def value_text(value: float, sigma: float) -> str:
    """A value with its 1-sigma, to two digits of the sigma: ``12.345 ± 0.016``."""
    if not sigma > 0:
        return f"{value:.6g} ± {sigma:.2g}"
    digits = 1 - math.floor(math.log10(sigma))
    if digits > 9 or abs(value) >= 1e9:
        return f"{value:.10g} ± {sigma:.2g}"
    places = max(0, digits)
    return (
        f"{value:.{places}f} ± {sigma:.{places}f}" if digits < 7 else f"{value:.9g} ± {sigma:.2g}"
    )


def _cells(estimate: Mapping[str, Any]) -> list[str]:
    """The components of an estimate; of an attitude the quaternion, then the sigmas of its axes."""
    value, sigma = estimate["value"], estimate["sigma"]
    if len(value) == len(sigma):
        return [value_text(v, s) for v, s in zip(value, sigma, strict=True)]
    return [*(f"{v:.6f}" for v in value), *(f"{s:.2g}" for s in sigma)]


def _names(estimate: Mapping[str, Any], unit: str) -> list[str]:
    components = list(estimate["components"])
    if len(components) == len(estimate["sigma"]):
        return components
    # Of a quaternion: sigmas are of rotations about its axes.
    return [*(f"q_{c}" for c in components), *(f"±{c} {unit}" for c in components[1:])]


def estimate_lines(rows: Mapping[str, Any], part: str, state: str, unit: str) -> list[str]:
    """Lines of a state that truth does not know: the estimate of each row at its last epoch with
    1-sigma by component, and 1-sigma, a norm over the axes, over the pass; [] where none has any.

    part: of a row, "states" or "statics".
    """
    told = {
        n: r[part][state] for n, r in rows.items() if "estimate" in r.get(part, {}).get(state, {})
    }
    if not told or any("rmse" in r.get(part, {}).get(state, {}) for r in rows.values()):
        return []
    first = next(iter(told.values()))["estimate"]
    bare = unit.partition(",")[0]
    names = _names(first, bare)
    moving = part == "states"
    table = []
    for name, one in told.items():
        sigma = one["sigma"]
        over = [] if not moving else ["-" if sigma is None else f"{sigma:.4g}"]
        table.append([name, rows[name]["kind"], *_cells(one["estimate"]), *over])
    plain = state if unit == "1" else f"{state} [{unit}]".replace("[1, ", "[")
    head = f"{plain}: estimate at t = {first['t']:.10g} s, ± 1-sigma"
    columns = "|".join(f"{n:>9}" for n in (*names, *(["1-sigma, pass"] if moving else [])))
    return ["", head, *aligned_columns(f"estimator |kind     |{columns}", table)]


def _sensor_cells(name: str, kind: str, sensor: str, one: Mapping[str, Any]) -> list[str]:
    band, lag, edge = one.get("nis_band"), one.get("lag_correlation"), one.get("lag_band")
    return [
        name,
        kind,
        sensor,
        str(one["rows"]),
        "-" if one["nis"] is None else f"{one['nis']:.3f}",
        "-" if not band else f"{band[0]:.3f}..{band[1]:.3f}",
        "-" if lag is None else f"{lag:+.3f}",
        "-" if not edge else f"±{edge[1]:.3f}",
    ]


def _noise_row(noise: Mapping[str, Any]) -> Sequence[str]:
    if not noise["tested"]:
        return [noise["noise"], "-", "-", "not testable by this pass"]
    low, high = noise["factor_ci"]
    factor, interval = f"{noise['factor']:.3f}", f"{low:.3f}..{high:.3f}"
    return [noise["noise"], factor, interval, noise_said(noise)]


def told_lines(summary: Mapping[str, Any]) -> list[str]:
    """Lines on residuals by sensor and on the declared noises; [] where neither is known."""
    table = [
        _sensor_cells(name, row["kind"], sensor, one)
        for name, row in summary["estimators"].items()
        for sensor, one in row.get("sensors", {}).items()
    ]
    lines = list[str]()
    if table:
        title = "residuals in their own sigmas (filtered: innovations; smoothed: standardised)"
        header = "estimator |kind |sensor |rows|mean square|95 % band|lag correlation|95 % band"
        lines += ["", title, *aligned_columns(header, table)]
    noise = summary.get("noise")
    if not noise:
        return lines
    if "missing" in noise:
        why = f"declared noises could not be judged by {noise['residuals_of']}: {noise['missing']}"
        return [*lines, "", why]
    header = "declared noise |true / declared|95 % interval|verdict "
    body = aligned_columns(header, [_noise_row(n) for n in noise["noises"]])
    title = f"declared noises, by the residuals of {noise['residuals_of']}"
    return [*lines, "", title, *body, *noise["text"]]
