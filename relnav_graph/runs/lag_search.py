"""The lags of inputs at which a pass, smoothed, is most likely."""

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

__all__ = ["LagSearch"]

_LOG = logging.getLogger(__name__)

#: Rounds of the search for the lags, at most; the change, in sigmas, that ends it.
ROUNDS, SMALL = 12, 0.02


@dataclass(eq=False)
class LagSearch:
    """Newton's method over parabolas through smoothed passes.

    tables, name: of the scenario, without these lags; opened: the pass, of which recording is a
    richer form; inputs: names of those whose lag is looked for.
    """

    tables: Mapping[str, Any]
    name: str
    recording: Recording
    opened: Pass
    inputs: tuple[str, ...]

    def __post_init__(self) -> None:
        series = self.recording.inputs
        self._made: dict[tuple[float, ...], tuple[float, Track]] = {}
        self.samples = np.array(
            [float(np.median(series[n].t_end - series[n].t_start)) for n in self.inputs]
        )
        known = self.opened.scenario.stamps
        self.start = np.array([known[n].lag if n in known else 0.0 for n in self.inputs])

    def scenario(self, lags: Array) -> Scenario:
        """With lags (k,), s."""
        late = {n: {"lag": float(v)} for n, v in zip(self.inputs, lags, strict=True)}
        return make_scenario(merge(self.tables, {"stamps": late}), self.name)

    def at(self, lags: Array) -> tuple[float, Track]:
        """The cost at lags (k,), s, and the smoothed pass. Raises EstimationError where there is
        none."""
        key = tuple(lags.tolist())
        if key not in self._made:
            opened = self.opened
            problem = self.scenario(lags).problem(self.recording, opened.seed, opened.run)
            track = run_estimator("batch", problem)
            if track.status == "diverged":
                raise EstimationError(f"{self.name}: not smoothed: {track.message}")
            self._made[key] = posterior_cost(problem, track.states), track
            text = ", ".join(f"{n} {v:.6g} s" for n, v in zip(self.inputs, lags, strict=True))
            _LOG.info(f"lags {text or 'none'}: cost {self._made[key][0]:.6g}")
        return self._made[key]

    def minimum(self) -> tuple[Array, Array, Track]:
        """Lags (k,), s, their covariance (k, k), infinite where they are not told, and the pass."""
        lags, h = self.start, 0.5 * self.samples
        P: Array = np.zeros((len(lags), len(lags)))
        for _ in range(ROUNDS if len(lags) else 0):
            cost, _ = self.at(lags)
            g, H = self._parabola(lags, h)
            curved = bool(np.linalg.eigvalsh(H)[0] > 0)
            P = np.array(np.linalg.inv(H)) if curved else np.diag(np.full(len(lags), np.inf))
            near = min(self._made, key=lambda key: self._made[key][0])
            step = -P @ g if curved else np.array(near) - lags
            step = np.clip(step, -4 * h, 4 * h)
            if curved:
                sigma = np.sqrt(np.diag(P))
                small = np.abs(step) < SMALL * sigma
                narrow = h <= 4 * sigma
                h = np.clip(3 * sigma, 0.01 * self.samples, 0.5 * self.samples)
                if small.all() and narrow.all():
                    break
            for _ in range(4):
                if self.at(lags + step)[0] <= cost:
                    lags = lags + step
                    break
                step = step / 2
            else:
                break
        return lags, P, self.at(lags)[1]

    def _parabola(self, lags: Array, h: Array) -> tuple[Array, Array]:
        """Gradient (k,) and curvature (k, k) of the cost at lags (k,), s, over steps h (k,), s."""
        k = len(lags)
        steps, f0 = np.diag(h), self.at(lags)[0]
        up = np.array([self.at(lags + one)[0] for one in steps])
        down = np.array([self.at(lags - one)[0] for one in steps])
        H = np.diag((up - 2 * f0 + down) / h**2)
        for i, j in itertools.combinations(range(k), 2):
            both = self.at(lags + steps[i] + steps[j])[0]
            H[i, j] = H[j, i] = (both - up[i] - up[j] + f0) / (h[i] * h[j])
        return (up - down) / (2 * h), H

    def slopes(self, lags: Array, track: Track) -> Array:
        """How the static blocks follow the lags, (m, k), per s."""
        if track.statics is None:
            return np.zeros((0, len(lags)))
        layout, columns = track.statics.layout, list[Array]()
        for step in np.diag(0.1 * self.samples):
            ends = [self.at(lags + sign * step)[1].statics for sign in (-1, 1)]
            assert ends[0] is not None
            assert ends[1] is not None
            moved = layout.local(ends[0].x[-1], ends[1].x[-1])
            columns.append(moved / (2 * step.sum()))
        return np.array(columns).reshape(len(lags), layout.dim).T
