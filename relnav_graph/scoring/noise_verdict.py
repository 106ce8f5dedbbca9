"""Which declared noise is wrong, in numbers and in words, of one pass or of many."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.scoring.estimated import sensor_rows
from relnav_graph.scoring.variance_components import PRIOR, NoiseResiduals, estimate_factors

__all__ = [
    "NOTABLE",
    "beside_truth",
    "cause_text",
    "noise_factors",
    "noise_owners",
    "noise_said",
    "noise_verdict",
]

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

    names: of the groups of noises; squares (groups,) and coupling: see `estimate_factors`. A
    variance that is estimated to be negative, or zero beside a cause that swells all residuals,
    says nothing of its noise: that counts as not tested.
    """
    variance, sigma = estimate_factors(squares, coupling)
    out = list[dict[str, Any]]()
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
    swollen = any(n["named"] and n["factor"] > 1 for n in out)
    for n in out:
        if n["factor"] == 0 and (swollen or n["factor_ci"][1] == 0):
            n |= {"tested": False, "factor": None, "factor_ci": None, "named": False}
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
    if factor > 1:
        size = f"{factor:.2f} times too small ({low:.2f} to {high:.2f})"
    elif low > 0:
        size = f"{1 / factor:.2f} times too large ({1 / high:.2f} to {1 / low:.2f})"
    else:
        size = f"at least {1 / high:.2f} times too large"
    return f"{noise['noise']} is declared {size}: {owners.get(noise['noise'], '')}"


def _but(tested: Sequence[Mapping[str, Any]]) -> str:
    """Noises that are no cause, and not quite as declared either."""
    doubted = [
        f"{n['noise']} ({n['factor']:.2f} times, {low:.2f} to {high:.2f})"
        for n in tested
        if noise_said(n) == "in doubt"
        for low, high in (n["factor_ci"],)
    ]
    are = "are" if len(doubted) > 1 else "is"
    return f", but for {', '.join(doubted)}, which {are} in doubt" if doubted else ""


def _off(one: Mapping[str, Any], key: str, band: str, middle: float, form: str) -> str:
    """How a number of innovations is beside its 95 % band, too far for chance; "" where it is not.

    one: of a sensor, see `sensor_rows`; middle: what is expected; form: of numbers."""
    value, edges = one.get(key), one.get(band)
    if value is None or edges is None:
        return ""
    edge = edges[1] if value > middle else edges[0]
    if abs(value - middle) < SIGNIFICANT / 1.96 * abs(edge - middle):
        return ""
    low, high = (format(e, form) for e in edges)
    return f"{format(value, form)} (95 % band {low} to {high})"


def _undeclared(tracks: Iterable[Track]) -> str:
    """A sentence where the innovations of each filter are not as declared; "" where those of one
    are: the others then have a linearisation, and no noise, to blame."""
    said = dict[str, str]()
    for track in tracks:
        if track.kind != "filtered" or track.status == "diverged":
            continue
        parts = list[str]()
        for sensor, one in sensor_rows(track).get("sensors", {}).items():
            if square := _off(one, "nis", "nis_band", 1.0, ".3f"):
                parts.append(f"{sensor}, mean square {square}")
            if lag := _off(one, "lag_correlation", "lag_band", 0.0, "+.3f"):
                parts.append(f"{sensor}, correlation with the epoch before {lag}")
        if not parts:
            return ""
        said[track.name] = "; ".join(parts)
    name = next(iter(said), "")
    return f"The innovations of {name} are not as declared: {said[name]}." if name else ""


def noise_verdict(
    problem: Problem, row: str, found: NoiseResiduals, tracks: Iterable[Track] = ()
) -> dict[str, Any]:
    """The verdict on the noises of one pass, by the residuals of a smoothed row, as of a study.

    ``{"residuals_of", "noises", "causes", "text"}``; found: with coupling; tracks: all of the
    pass, whose innovations may say what these residuals do not.
    """
    squares = np.array(list(found.squares.values()))
    coupling = np.zeros((len(squares), len(squares))) if found.coupling is None else found.coupling
    noises = noise_factors(list(found.squares), squares, coupling)
    causes = [n for n in noises if n["named"]]
    owners = noise_owners(problem.sensors, problem.processes)
    text = [f"Likely cause: {cause_text(n, owners)}." for n in causes]
    tested = [n for n in noises if n["tested"]]
    untold = [n["noise"] for n in noises if not n["tested"] and n["noise"] != PRIOR]
    undeclared = _undeclared(tracks) if untold and not causes else ""
    if not causes and tested:
        which = "declared noises that they test" if undeclared else "declared noises"
        text = [f"The residuals of {row} are as the {which} say{_but(tested)}."]
    elif not tested:
        text = [f"The residuals of {row} hold too little to test any declared noise."]
    if untold and tested:
        text.append(f"Not testable by this pass: {', '.join(untold)}.")
    if undeclared:
        looks = "`relnav tune SCENARIO --data DIR` looks at what residuals do not test."
        text += [undeclared, looks]
    return {
        "residuals_of": row,
        "noises": [n for n in noises if n["noise"] != PRIOR],
        "causes": [n["noise"] for n in causes],
        "text": text,
    }


def beside_truth(
    noise: Mapping[str, Any], estimators: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """The verdict of one pass with what the truth says of it, where it is known. estimators: the
    rows of a summary.

    Residuals show the white part of a noise alone. Who has errors that last, as those of a map or a
    lens, declares more, and is right.
    """
    row = estimators.get(str(noise.get("residuals_of")), {})
    anees, band = row.get("anees"), row.get("anees_band")
    larger = any(n["named"] and n["factor"] < 1 for n in noise.get("noises", ()))
    if not larger or anees is None or band is None or not band[0] <= anees <= band[1]:
        return dict(noise)
    text = (
        f"Against the truth {noise['residuals_of']} is as sure as it may be (ANEES {anees:.2f}): a"
        " noise that is declared larger may stand for errors that last, which its residuals do not"
        " show."
    )
    return {**noise, "text": [*noise["text"], text]}
