"""Whether a track is to be trusted, by its residuals alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Status
from relnav_graph.estimators.weights import (
    count_downweighted,
    count_rejected,
    left_out,
    lost,
    retired,
)
from relnav_graph.linear.assembly import Assembly

#: Mean squared normalised residual, per row, beyond which a track is not to be trusted.
#: Consistent ones have 1; a lively linearisation error has a few.
TRUSTED = 30.0


def judge(
    away: Mapping[str, float], problem: Problem, misfit: float, rows: int
) -> tuple[Status, str]:
    """The status of a track, and why.

    Degraded when a sensor lost more than half of its observations (`away`, see
    `relnav_graph.estimators.weights.lost`), when not one was used, or when the sum of squared
    whitened residuals, `misfit` over `rows` rows, is far too large.
    """
    seen = dict.fromkeys(problem.sensors, 0)
    for epoch in problem.epochs:
        for m in epoch.measurements:
            seen[m.sensor] += len(m.z)
    for name, count in away.items():
        if count > 0.5 * seen[name]:
            how = " or down-weighted" if name in problem.losses else ""
            return "degraded", (f"{count:.0f} of {seen[name]} observations of {name} rejected{how}")
    if not rows:
        return "degraded", "not one observation was used"
    if misfit > TRUSTED * rows:
        return "degraded", (
            f"squared residuals are {misfit / rows:.3g} times what the covariance says;"
            f" expected about 1, at most {TRUSTED:g}"
        )
    return "ok", ""


def examine(
    problem: Problem, assembly: Assembly, weights: Array, cost: float, unconverged: float | None
) -> dict[str, Any]:
    """status, message, rejected, left_out, retired and downweighted of a track smoothed over a
    whole pass.

    weights (observations,): square roots of the weights that it ended with; cost: half the sum of
    squared whitened residuals; unconverged: length of the last step, in sigmas, where it was not
    small. An estimate that has not converged is degraded.
    """
    rows = assembly.rows_of(weights > 0)
    status, message = judge(lost(assembly, weights), problem, 2 * cost, int(rows.sum()))
    if unconverged is not None:
        stopped = f"not converged: last step {unconverged:.2g} sigma"
        status, message = "degraded", "; ".join(filter(None, [message, stopped]))
    return {
        "status": status,
        "message": message,
        "rejected": dict.fromkeys(problem.sensors, 0) | count_rejected(assembly, weights),
        "left_out": left_out(assembly, weights),
        "retired": retired(assembly, weights),
        "downweighted": count_downweighted(assembly, weights),
    }


def gave_up(problem: Problem, why: str) -> dict[str, Any]:
    """The same of an estimator that found no trajectory."""
    rejected = dict.fromkeys(problem.sensors, 0)
    return {"status": "diverged", "message": why, "rejected": rejected, "downweighted": {}}
