"""Which declared noise is wrong, in numbers and in words, of one pass or of many."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.problem import Problem
from relnav_graph.scoring.variance_components import PRIOR, NoiseResiduals, estimate_factors

__all__ = ["NOTABLE", "cause_text", "noise_factors", "noise_owners", "noise_said", "noise_verdict"]

#: A noise is named as a likely cause where its variance factor is this many of its sigmas
#: from 1, and its sigma is wrong by more than this factor, up or down.
SIGNIFICANT, NOTABLE = 4.0, 1.25


def noise_owners(
    sensors: Mapping[str, Sensor], processes: Mapping[str, Dynamics]
) -> dict[str, str]:
    """The sensor or process that each noise belongs to, in words, by the noise's path."""
    found = {f"sensors.{name}": f"sensor {name} ({s.kind})" for name, s in sensors.items()}
    for name, process in processes.items():
        inputs = " and ".join(process.inputs)
        driven = f", of the input {inputs}" if inputs else ""
        for noise in process.noises or tuple(b.name for b in process.advances):
            found[f"processes.{name}.{noise}"] = f"process {name} ({process.kind}{driven})"
    return found


def noise_factors(names: Sequence[str], squares: Array, coupling: Array) -> list[dict[str, Any]]:
    """The factor of each declared sigma, with its 95 % interval, and whether it is a likely cause.

    names: of the groups of noises; squares (groups,) and coupling: see `estimate_factors`.
    """
    variance, sigma = estimate_factors(squares, coupling)
    out = []
    for name, v, s in zip(names, variance.tolist(), sigma.tolist(), strict=True):
        tested = math.isfinite(s) and name != PRIOR
        # s holds for a factor of 1; the sigma of an estimated variance grows in proportion.
        low, high = (max(v + k * s * max(v, 1.0), 0.0) for k in (-1.96, 1.96))
        factor = math.sqrt(max(v, 0.0))
        notable = max(factor, 1 / max(factor, 1e-9)) > NOTABLE
        out.append(
            {
                "noise": name,
                "tested": tested,
                "factor": factor if tested else None,
                "factor_ci": [math.sqrt(low), math.sqrt(high)] if tested else None,
                "named": tested and notable and abs(v - 1) > SIGNIFICANT * s,
            }
        )
    return out


def noise_said(noise: Mapping[str, Any]) -> str:
    """What is said of a declared noise that was tested. Few rows cannot name it as a cause; where
    its interval is beside one all the same, they are no proof that it is none."""
    low, high = noise["factor_ci"]
    if noise["named"]:
        return "likely cause"
    return "as declared" if low <= 1 <= high else "in doubt"


def cause_text(noise: Mapping[str, Any], owners: Mapping[str, str]) -> str:
    """What is wrong with a noise that is a likely cause, of `noise_factors`, in words."""
    factor, (low, high) = noise["factor"], noise["factor_ci"]
    size = "too small" if factor > 1 else "too large"
    if factor < 1:
        low, factor, high = (1 / max(v, 1e-9) for v in (high, factor, low))
    upper = f"{high:.2f}" if high < 1e6 else "more"
    return (
        f"{noise['noise']} is declared {factor:.2f} times {size} ({low:.2f} to {upper}):"
        f" {owners.get(noise['noise'], '')}"
    )


def _but(tested: Sequence[Mapping[str, Any]]) -> str:
    """Noises that are no cause, and not quite as declared either."""
    doubted = [
        f"{n['noise']} ({n['factor']:.2f} times, {low:.2f} to {high:.2f})"
        for n in tested
        if noise_said(n) == "in doubt"
        for low, high in (n["factor_ci"],)
    ]
    return f", but for {', '.join(doubted)}, which is in doubt" if doubted else ""


def noise_verdict(problem: Problem, row: str, found: NoiseResiduals) -> dict[str, Any]:
    """The verdict on the noises of one pass, by the residuals of a smoothed row, as of a study.

    ``{"residuals_of", "noises", "causes", "text"}``; found: with coupling.
    """
    squares = np.array(list(found.squares.values()))
    coupling = np.zeros((len(squares), len(squares))) if found.coupling is None else found.coupling
    noises = noise_factors(list(found.squares), squares, coupling)
    causes = [n for n in noises if n["named"]]
    owners = noise_owners(problem.sensors, problem.processes)
    text = [f"Likely cause: {cause_text(n, owners)}." for n in causes]
    tested = [n for n in noises if n["tested"]]
    if not causes and tested:
        text = [f"The residuals of {row} are as the declared noises say{_but(tested)}."]
    elif not tested:
        text = [f"The residuals of {row} hold too little to test any declared noise."]
    untold = [n["noise"] for n in noises if not n["tested"] and n["noise"] != PRIOR]
    if untold and tested:
        text.append(f"Not testable by this pass: {', '.join(untold)}.")
    return {
        "residuals_of": row,
        "noises": [n for n in noises if n["noise"] != PRIOR],
        "causes": [n["noise"] for n in causes],
        "text": text,
    }
