"""Noise parameters from the residuals of one pass, without truth.

Variance components (Fisher's scoring of the restricted likelihood, see
`relnav_graph.scoring.noise_likelihood`), iterated on one pass until nothing moves: after each step
the pass is smoothed anew with the noises found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.errors import EstimationError, InputError
from relnav_graph.estimators.batch import begun
from relnav_graph.estimators.gauss_newton import Solution, solve, solve_gated
from relnav_graph.io.closures import grouped
from relnav_graph.linear.assembly import Assembly
from relnav_graph.runs.passes import Pass
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scoring.metrics import versions
from relnav_graph.scoring.noise_likelihood import Fit, fit
from relnav_graph.units import quantities, unit_of, unit_scale

__all__ = ["MARK", "TELLING", "Noise", "fragment", "tune"]

#: How a file of noises begins: no other is written over.
MARK = "# Noises found by: "
#: A noise can be told where its 95 % interval ends within this factor of the value found.
TELLING = 1.5
#: Information on the logarithm of a variance, in degrees of freedom, below which it is not tried.
_FEWEST = 3.0
#: Most factors by which a variance changes in one step; steps; parts of a sigma that end them.
_FACTOR, _STEPS, _SMALL = 4.0, 40, 0.02
#: Draws of random signs for the information that intervals are made of.
_PROBES = 4


@dataclass(frozen=True)
class Noise:
    """A parameter that says how large a noise is: where it stands in the scenario, its value in SI,
    and unit, the one that it has there; held: why it stays as it is whatever the residuals say, ""
    where it does not."""

    section: str
    owner: str
    field: str
    value: Any
    si: str
    unit: str
    held: str = ""

    @property
    def name(self) -> str:
        """Its path in the scenario."""
        return f"{self.section}.{self.owner}.{self.field}"

    def times(self, factor: float) -> Any:
        """The value times a factor, SI: a number, or a list."""
        return (np.asarray(self.value) * factor).tolist()


def _parameter(
    scenario: Scenario, section: str, owner: str, model: Any, field: str, held: str
) -> Noise:
    quantity = quantities(type(model))[field]  # type: ignore[arg-type]
    table = scenario.raw.get(section, {}).get(owner, {})
    value, given = getattr(model, field), table.get(field, 0.0)
    if field in table and not isinstance(given, list):  # one for all axes stays one
        value = float(np.asarray(value).flat[0])
    if not held and not (np.asarray(value) > 0).all():
        held = "is declared zero"
    unit = unit_of(given, quantity.unit)
    return Noise(section, owner, field, value, quantity.unit, unit, held)


def _sensor_noises(
    scenario: Scenario, seen: Mapping[str, Measurement]
) -> tuple[list[Noise], dict[str, list[str]]]:
    """Parameters of the sensors, and the name of the one that drives each residual row, by sensor.

    seen: a measurement of each sensor that has any. Which rows a parameter drives is found by
    doubling it.
    """
    found, of_rows = list[Noise](), dict[str, list[str]]()
    for owner, members in grouped(scenario.sensors).items():
        model: Any = next(iter(members.values()))
        known = quantities(type(model))  # type: ignore[arg-type]
        fields = [f for f in known if f == "sigma" or f.endswith("_sigma")]
        m = next((seen[name] for name in members if name in seen), None)
        rows = ["" for _ in range(model.rows)]
        loss = any(scenario.options[name].loss is not None for name in members)
        held = "has a robust loss, which changes what residuals say" if loss else ""
        for field in fields:
            if getattr(model, field) is None:
                continue
            own = _parameter(scenario, "sensors", owner, model, field, held)
            if m is None:
                found.append(replace(own, held="nothing was measured"))
                continue
            if m.covariance is not None:
                found.append(replace(own, held="the data bring covariances of their own"))
                continue
            doubled = replace(model, **{field: 2 * np.asarray(own.value)})
            before, after = (np.einsum("kii->ki", s.noise(m)) for s in (model, doubled))
            driven = np.flatnonzero((after > before * (1 + 1e-9)).any(axis=0))
            free = [i for i in driven if not rows[i]]
            if not free:
                own = replace(own, held="drives no residual of its own")
            for i in free:
                rows[i] = own.name
            found.append(own)
        of_rows |= dict.fromkeys(members, rows)
    return found, of_rows


def _noises(scenario: Scenario, problem: Problem) -> tuple[list[Noise], dict[str, list[str]]]:
    """All parameters that say how large a noise is, and see `_sensor_noises`."""
    seen: dict[str, Measurement] = {}
    for epoch in problem.epochs:
        for m in epoch.measurements:
            if len(m.z):
                seen.setdefault(m.sensor, m)
    found, of_rows = _sensor_noises(scenario, seen)
    for owner, process in scenario.processes.items():
        found += [
            _parameter(scenario, "processes", owner, process, field, "")
            for field in dict.fromkeys(process.noises)
        ]
    return found, of_rows


class _Trial:
    """The pass, smoothed with noises scaled as asked, each time from the last trajectory."""

    def __init__(self, opened: Pass, noises: Sequence[Noise], of_rows: Mapping[str, list[str]]):
        self._opened, self._noises, self._of_rows = opened, noises, of_rows
        self._last: Solution | None = None

    def problem(self, logs: Mapping[str, float]) -> Problem:
        """The problem with the variances of noises times exp(logs), by name."""
        opened, scaled = self._opened, dict[str, dict[str, Any]]()
        for noise in self._noises:
            if logs.get(noise.name):
                own = scaled.setdefault(noise.section, {}).setdefault(noise.owner, {})
                own[noise.field] = noise.times(math.exp(0.5 * logs[noise.name]))
        raw = dict(opened.scenario.raw)
        for section, owners in scaled.items():
            tables = {o: {**table, **owners.get(o, {})} for o, table in raw[section].items()}
            raw[section] = tables
        scenario = make_scenario(raw, opened.scenario.name, {}) if scaled else opened.scenario
        problem = scenario.problem(opened.recording, opened.seed, opened.run)
        return replace(problem, considered=())

    def fit(
        self, logs: Mapping[str, float], asked: Sequence[str], probes: int = 1, held: bool = False
    ) -> Fit:
        """How the noises `asked` fit then; held: without deciding anew which observations count."""
        problem = self.problem(logs)
        if self._last is None:
            assembly, x, weights = begun(problem)
        else:
            assembly, x, weights = Assembly.of(problem), self._last.x, self._last.weights
        if held:
            self._last = solve(assembly, problem.prior, x, weights, tolerance=1e-3)
        else:
            self._last = solve_gated(assembly, problem, x, weights)
        return fit(problem, self._last, asked, self._of_rows, probes)


def _telling(found: Fit) -> Any:
    """How wide the 95 % intervals are, as a factor of the noise's sigma, up or down."""
    return np.exp(0.5 * 1.96 * found.sigmas)


def _converged(trial: _Trial, logs: dict[str, float], asked: list[str]) -> tuple[Fit, int]:
    """Step until nothing moves; `logs` is what is found. Noises that are lost on the way (their
    residuals say nothing more) are taken out of `asked`."""
    for step in range(1, _STEPS + 1):
        found = trial.fit(logs, asked)
        weak = [n for n, t in zip(asked, np.diag(found.T), strict=True) if not t > _FEWEST]
        if weak:
            asked[:] = [n for n in asked if n not in weak]
            logs |= dict.fromkeys(weak, 0.0)
            if not asked:
                return found, step
            continue
        factor = np.clip(1 + found.step, 1 / _FACTOR, _FACTOR)
        for name, f in zip(asked, factor, strict=True):
            logs[name] += float(np.log(f))
        if (np.abs(np.log(factor)) < _SMALL * found.sigmas).all():
            return trial.fit(logs, asked, _PROBES), step
    raise EstimationError(
        f"the noises {', '.join(asked)} have not settled in {_STEPS} steps: they cannot be told"
        " apart, or the models do not describe this pass"
    )


def tune(opened: Pass, tell: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Noise parameters of a pass that is open, as an object that JSON can hold, schema 1.

    tell: hears of each step. Noises that cannot be told (see `TELLING`), one after the other, the
    worst first, go back to what was declared, and the others are found anew. Raises InputError
    where nothing can be tuned, EstimationError where the noises do not settle or the pass cannot be
    smoothed.
    """
    if opened.flown:
        raise InputError(f"{opened.scenario.name}: flown in closed loops; give recorded data")
    with threadpool_limits(1, "blas"):
        return _tune(opened, tell)


def _tune(opened: Pass, tell: Callable[[str], None]) -> dict[str, Any]:
    scenario = opened.scenario
    noises, of_rows = _noises(scenario, opened.problem)
    trial = _Trial(opened, noises, of_rows)
    asked = [n.name for n in noises if not n.held]
    if not asked:
        raise InputError(f"{scenario.name}: no noise parameter to tune")
    logs, steps = dict.fromkeys(asked, 0.0), 0
    declared, every = dict(logs), list(asked)
    tell(f"{scenario.name}: {len(asked)} noises, {len(opened.problem.epochs)} epochs ...")
    while asked:
        found, more = _converged(trial, logs, asked)
        steps += more
        if not asked:
            break
        width = _telling(found)
        worst = int(width.argmax())
        tell(f"{', '.join(asked)}: settled after {more} steps")
        if width[worst] <= TELLING:
            break
        logs[asked.pop(worst)] = 0.0
    width = _telling(found) if asked else np.zeros(0)
    half = dict(zip(asked, width.tolist(), strict=True))
    end = trial.fit(logs, every, probes=0)
    begin = trial.fit(declared, every, probes=0, held=True)  # of the same observations
    return {
        "schema": 1,
        "scenario": scenario.name,
        "seed": opened.seed if opened.simulated else None,
        "epochs": len(opened.problem.epochs),
        "versions": versions(),
        "telling": TELLING,
        "steps": steps,
        "log_likelihood": {"declared": begin.log_likelihood, "tuned": end.log_likelihood},
        "noises": {n.name: _row(n, logs, half) for n in noises},
    }


def _row(noise: Noise, logs: Mapping[str, float], half: Mapping[str, float]) -> dict[str, Any]:
    told = noise.name in half
    factor = math.exp(0.5 * logs.get(noise.name, 0.0)) if told else 1.0
    scale = 1 / unit_scale(noise.unit, noise.si)
    declared = np.asarray(noise.value) * scale
    out: dict[str, Any] = {
        "unit": noise.unit,
        "declared": declared.tolist(),
        "told": told,
        "why": noise.held or ("" if told else "residuals of this pass hardly show it"),
        "value": (declared * factor).tolist(),
        "factor": factor if told else None,
        "factor_ci": [factor / half[noise.name], factor * half[noise.name]] if told else None,
    }
    return out


def fragment(found: Mapping[str, Any], command: str) -> str:
    """The noises that were told as the text of a TOML file, for a scenario's `base`."""
    lines = [
        f"{MARK}{command}",
        "# 95 % intervals of each, as a factor of the value; take it by: base = [..., this file]",
    ]
    section = ""
    for name, row in found["noises"].items():
        if not row["told"]:
            continue
        owner, _, field = name.rpartition(".")
        if owner != section:
            section = owner
            lines += ["", f"[{_keys(owner)}]"]
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        values = row["value"] if isinstance(row["value"], list) else [row["value"]]
        texts = [f'"{v:.6g}{unit}"' if unit else f"{v:.6g}" for v in values]
        value = f"[{', '.join(texts)}]" if isinstance(row["value"], list) else texts[0]
        low, high = (end / row["factor"] for end in row["factor_ci"])
        lines.append(f"{field} = {value}    # {low:.3g} to {high:.3g} times that")
    return "\n".join([*lines, ""])


def _keys(path: str) -> str:
    """A dotted path as a key of TOML; names may hold `.` and `+`."""
    section, _, owner = path.partition(".")
    bare = owner.replace("_", "").replace("-", "").isalnum() and owner.isascii()
    return f"{section}.{owner}" if bare else f'{section}."{owner}"'
