"""Whether an online estimate is to be trusted: silent sensors, biased or large innovations.

A sensor's mean innovation is watched by an exponentially weighted average of its whitened
innovations (MEWMA: Lowry, Woodall, Champ, Rigdon 1992), which sees a steady shift that no
single innovation shows; their size by the same average of squares; what the gate leaves out
by the average of the fraction left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import chdtri

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Sensor
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.problem import Problem
from relnav_graph.estimators.ekf import FilterSweep
from relnav_graph.estimators.trust import TRUSTED

__all__ = ["Health", "Monitor", "caution"]

Health = Literal["OK", "INITIALISING", "DEGRADED", "LOST"]

#: Weight of the newest sample in the averages: they remember about 1 / WEIGHT samples.
WEIGHT = 0.1
#: Probability that the mean of a consistent sensor is taken for a bias, per sample.
FALSE_ALARM = 1e-7
#: A sensor silent for longer than this many of its periods is missing, and one silent for
#: longer than the second is gone; when all are gone, the estimate is lost.
MISSING, GONE = 5.0, 50.0
#: Fraction of a sensor's observations left out above which it is not to be trusted.
LEFT_OUT = 0.5

# Columns of the numbers kept for each sensor, before the mean.
LAST, PERIOD, SQUARES, OUT, SAMPLES, USED, REJECTED, DOWNWEIGHTED = range(8)
MEAN = 8


@dataclass(frozen=True, eq=False)
class Monitor:
    """Running averages by sensor; immutable: `after` gives the next one.

    table (sensors, 8 + rows): see the columns above; the mean comes last. rare: sensors of
    loop closures, whose silence tells nothing.
    """

    names: tuple[str, ...]
    rows: tuple[int, ...]
    table: Array
    rare: frozenset[str] = frozenset()

    @classmethod
    def of(cls, sensors: Mapping[str, Sensor], table: Array | None = None) -> Monitor:
        """Before anything was seen, or with the numbers of an earlier one."""
        rows = tuple(s.rows for s in sensors.values())
        if table is None:
            table = np.zeros((len(rows), MEAN + max(rows, default=0)))
            table[:, [LAST, PERIOD]] = np.nan
        rare = frozenset(n for n, s in sensors.items() if getattr(s, "keyframe", None) is not None)
        return cls(tuple(sensors), rows, table, rare)

    def after(self, t: float, done: FilterSweep) -> Monitor:
        """With what a filter made of one epoch."""
        table, found = self.table.copy(), done.innovations()
        for i, name in enumerate(self.names):
            own = done.assembly.sensor_of == i
            if not own.any():
                continue
            weights, row = done.weights[own], table[i]
            if name not in self.rare:
                _seen_at(row, t)
            row[REJECTED] += (weights == 0).sum()
            row[DOWNWEIGHTED] += ((weights > 0) & (weights < 1)).sum()
            row[OUT] += WEIGHT * ((weights == 0).mean() - row[OUT])
            if name in found:
                v = found[name].v.reshape(-1, self.rows[i])
                row[USED] += len(v)
                row[SAMPLES] += 1
                row[SQUARES] += WEIGHT * ((v**2).mean() - row[SQUARES])
                mean = row[MEAN : MEAN + self.rows[i]]
                mean += WEIGHT * (v.sum(axis=0) / np.sqrt(len(v)) - mean)
        return replace(self, table=table)

    def count(self, column: int) -> dict[str, int]:
        """A counter's value, by sensor."""
        return {name: int(self.table[i, column]) for i, name in enumerate(self.names)}

    def alarms(self, t: float) -> dict[str, str]:
        """What is wrong at time t, by sensor."""
        out = {}
        for i, name in enumerate(self.names):
            found = list(_alarms(self.table[i], self.rows[i], t))
            if found:
                out[name] = "; ".join(found)
        return out

    def health(self, t: float) -> tuple[Health, str]:
        """OK, DEGRADED or LOST at time t, and why."""
        alarms = self.alarms(t)
        message = "; ".join(f"{name}: {text}" for name, text in alarms.items())
        silent = (t - self.table[:, LAST]) / self.table[:, PERIOD]
        known = np.isfinite(self.table[:, LAST])
        if not known.any():
            return "LOST", "no sensor has seen anything yet"
        gone = ~known | (silent > GONE)  # one seen once only has no period: not gone
        if gone.all():
            return "LOST", message
        return ("DEGRADED" if alarms else "OK"), message


def caution(problem: Problem, epoch: Epoch, x: Array) -> str:
    """Warnings of the processes about the interval that leads to an epoch, or "".

    For instance an aliased rate. x (size,): the estimate there.
    """
    found = []
    for name, process in problem.processes.items():
        # Most models say nothing, ever: to take the state apart for them costs more than a warning.
        if name in epoch.inputs and type(process).caution is not DynamicsModel.caution:
            length = float(epoch.inputs[name][:, 0].sum())
            blocks = process.advances + process.reads
            text = process.caution(length, *(problem.layout.value(x, b.name) for b in blocks))
            found += [f"{name}: {text}"] if text else []
    return "; ".join(found)


def _seen_at(row: Array, t: float) -> None:
    gap = t - row[LAST]
    if gap > 0:
        # A pause is no period: a long gap counts for three of those before.
        longest = gap if np.isnan(row[PERIOD]) else min(gap, 3 * row[PERIOD])
        row[PERIOD] = (
            longest if np.isnan(row[PERIOD]) else (row[PERIOD] + WEIGHT * (longest - row[PERIOD]))
        )
    if not gap <= 0:
        row[LAST] = t


def _alarms(row: Array, rows: int, t: float) -> Sequence[str]:
    found = []
    silent = (t - row[LAST]) / row[PERIOD]
    if silent > MISSING:
        found.append(f"silent for {t - row[LAST]:.6g} s, {silent:.3g} of its periods")
    if row[SAMPLES]:
        # The averages begin at zero: with few samples, correct them for that.
        share = 1 - (1 - WEIGHT) ** row[SAMPLES]
        spread = WEIGHT / (2 - WEIGHT) * (1 - (1 - WEIGHT) ** (2 * row[SAMPLES]))
        shift = float(row[MEAN : MEAN + rows] @ row[MEAN : MEAN + rows]) / spread
        if shift > chdtri(rows, FALSE_ALARM):
            mean = np.sqrt(shift * spread) / share
            found.append(f"its innovations are biased by {mean:.3g} sigma")
        if row[SQUARES] / share > TRUSTED:
            squares = row[SQUARES] / share
            found.append(f"squared innovations are {squares:.3g} times their covariance")
    if row[OUT] > LEFT_OUT:
        found.append(f"{row[OUT]:.0%} of its newest observations left out")
    return found
