"""Lags, and other numbers of a scenario, at which a pass, smoothed, is most likely."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import EstimationError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.likelihood import posterior_cost
from relnav_graph.runs.passes import Pass
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.toml import merge

__all__ = ["Parameter", "ParameterSearch"]

_LOG = logging.getLogger(__name__)

#: Rounds of the search, at most; the change, in sigmas, that ends it.
ROUNDS, SMALL = 12, 0.02


@dataclass(frozen=True)
class Parameter:
    """A number of a scenario: its path in the tables, its value to begin with, and what is a small
    change of it, all in `unit`, which is SI."""

    path: tuple[str, ...]
    value: float
    small: float
    unit: str

    @property
    def name(self) -> str:
        """The path with dots."""
        return ".".join(self.path)

    def tables(self, value: float) -> dict[str, Any]:
        """The tables of a scenario that have it, and nothing else."""
        nested: Any = value
        for key in reversed(self.path):
            nested = {key: nested}
        return dict(nested)


@dataclass(eq=False)
class ParameterSearch:
    """Newton's method over parabolas through smoothed passes.

    tables, name: of the scenario; opened: the pass, of which recording is a richer form; parameters
    (k): what is looked for.
    """

    tables: Mapping[str, Any]
    name: str
    recording: Recording
    opened: Pass
    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        self._made: dict[tuple[float, ...], tuple[float, Track]] = {}
        self.small = np.array([p.small for p in self.parameters])

    def scenario(self, values: Array) -> Scenario:
        """With values (k,) of the parameters, SI."""
        tables = dict(self.tables)
        for parameter, value in zip(self.parameters, values, strict=True):
            tables = merge(tables, parameter.tables(float(value)))
        return make_scenario(tables, self.name, {})  # what data bring is in them

    def at(self, values: Array) -> tuple[float, Track]:
        """The cost at values (k,), SI, and the smoothed pass. Raises EstimationError where there is
        none."""
        key = tuple(values.tolist())
        if key not in self._made:
            opened = self.opened
            problem = self.scenario(values).problem(self.recording, opened.seed, opened.run)
            track = run_estimator("batch", problem)
            if track.status == "diverged":
                raise EstimationError(f"{self.name}: not smoothed: {track.message}")
            self._made[key] = posterior_cost(problem, track.states), track
            every = zip(self.parameters, values, strict=True)
            text = ", ".join(f"{p.name} = {v:.6g} {p.unit}" for p, v in every)
            _LOG.info(f"{text or 'smoothed'}: cost {self._made[key][0]:.6g}")
        return self._made[key]

    def minimum(self) -> tuple[Array, Array, Track]:
        """The most likely values (k,), SI, their covariance (k, k), infinite where they are not
        told, and the pass."""
        values, h = np.array([p.value for p in self.parameters]), 0.5 * self.small
        P: Array = np.zeros((len(values), len(values)))
        for _ in range(ROUNDS if len(values) else 0):
            cost, _ = self.at(values)
            g, H = self._parabola(values, h)
            curved = bool(np.linalg.eigvalsh(H)[0] > 0)
            P = np.array(np.linalg.inv(H)) if curved else np.diag(np.full(len(values), np.inf))
            near = min(self._made, key=lambda key: self._made[key][0])
            step = -P @ g if curved else np.array(near) - values
            step = np.clip(step, -4 * h, 4 * h)
            if curved:
                sigma = np.sqrt(np.diag(P))
                small = np.abs(step) < SMALL * sigma
                narrow = h <= 4 * sigma
                h = np.clip(3 * sigma, 0.01 * self.small, 0.5 * self.small)
                if small.all() and narrow.all():
                    break
            for _ in range(4):
                if self.at(values + step)[0] <= cost:
                    values = values + step
                    break
                step = step / 2
            else:
                break
        return values, P, self.at(values)[1]

    def _parabola(self, values: Array, h: Array) -> tuple[Array, Array]:
        """Gradient (k,) and curvature (k, k) of the cost at values (k,), over steps h (k,), SI."""
        k = len(values)
        steps, f0 = np.diag(h), self.at(values)[0]
        up = np.array([self.at(values + one)[0] for one in steps])
        down = np.array([self.at(values - one)[0] for one in steps])
        H = np.diag((up - 2 * f0 + down) / h**2)
        for i, j in itertools.combinations(range(k), 2):
            both = self.at(values + steps[i] + steps[j])[0]
            H[i, j] = H[j, i] = (both - up[i] - up[j] + f0) / (h[i] * h[j])
        return (up - down) / (2 * h), H

    def slopes(self, values: Array, track: Track) -> Array:
        """How the static blocks follow the values (k,), (m, k), SI."""
        if track.statics is None:
            return np.zeros((0, len(values)))
        layout, columns = track.statics.layout, list[Array]()
        for step in np.diag(0.1 * self.small):
            ends = [self.at(values + sign * step)[1].statics for sign in (-1, 1)]
            assert ends[0] is not None
            assert ends[1] is not None
            moved = layout.local(ends[0].x[-1], ends[1].x[-1])
            columns.append(moved / (2 * step.sum()))
        return np.array(columns).reshape(len(values), layout.dim).T
