"""Records of many runs, added up one at a time, in the order of their numbers: memory stays
flat, and the last digit does not depend on which worker made which run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Kind
from relnav_graph.study.record import RunRecord

__all__ = ["Collected", "RowRuns", "collect"]


@dataclass(eq=False)
class _Sum:
    """Sum over runs of arrays of one shape, counting finite numbers only."""

    total: Array | None = None
    count: Array | None = None

    def add(self, values: Array) -> None:
        known = np.isfinite(values)
        if self.total is None or self.count is None:
            self.total, self.count = np.zeros(values.shape), np.zeros(values.shape)
        if self.total.shape == values.shape:
            self.total += np.where(known, values, 0.0)
            self.count += known

    @property
    def mean(self) -> Array:
        """Mean over runs; NaN where no run had a number."""
        assert self.total is not None
        assert self.count is not None
        with np.errstate(invalid="ignore"):
            return np.array(self.total / self.count)


@dataclass(eq=False)
class RowRuns:
    """One row (a track of an estimator) over the runs in which it exists.

    Lists have one number per run, NaN where the run has none: own (of the row as a whole:
    "anees", "cost"), timing (by what was timed), state (by state and key, such as "rmse"),
    static (of static blocks at the last epoch, by block and key; "" stands for all jointly),
    aligned (of what the alignment of the map leaves, by state and key; "" stands for the map),
    sensor (of innovations, by sensor and key), squares (of whitened residuals, by noise).
    Sums over runs, for means: series (states + 1, 3, bins), nis (sensors, bins). coupling: one
    (noises, noises) of each run that has it, few at most. static_units: of static blocks and
    aligned states; freedoms: degrees of freedom of one run, by state, and "joint"; bad: run, status
    and message where the status is not ok; rejected: observations, by sensor.
    """

    kind: Kind = "filtered"
    units: dict[str, str] = field(default_factory=dict)
    freedoms: dict[str, int] = field(default_factory=dict)
    bad: list[tuple[int, str, str]] = field(default_factory=list)
    rejected: dict[str, int] = field(default_factory=dict)
    own: dict[str, list[float]] = field(default_factory=dict)
    timing: dict[str, list[float]] = field(default_factory=dict)
    state: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    static: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    static_units: dict[str, str] = field(default_factory=dict)
    aligned: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    sensor: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    series: _Sum = field(default_factory=_Sum)
    nis: _Sum = field(default_factory=_Sum)
    squares: dict[str, list[float]] = field(default_factory=dict)
    coupling: list[Array] = field(default_factory=list)

    def of(self, state: str, key: str) -> Array:
        """A number per run, (runs,)."""
        return np.array(self.state.get((state, key), []))

    def of_static(self, block: str, key: str) -> Array:
        """A number per run, (runs,), of a static block at the last epoch."""
        return np.array(self.static.get((block, key), []))

    @property
    def statics(self) -> list[str]:
        """Names of the static blocks."""
        return list(dict.fromkeys(name for name, _ in self.static if name))

    def of_sensor(self, sensor: str, key: str) -> Array:
        """A number per run, (runs,)."""
        return np.array(self.sensor.get((sensor, key), []))


@dataclass(eq=False)
class Collected:
    """All runs of a study.

    runs: their numbers; failed: number and reason of those without a result; bound: 1-sigma
    of the lower bound by kind and state, one number per run; own_bound: by row and state,
    where each estimator flies a pass of its own; bound_series: by kind, as `RowRuns.series`;
    mcreynolds: by filtered row, smoothed row, state and key, one number per run; cautions: the
    runs that have one, by row ("": of the pass itself) and name.
    """

    runs: list[int] = field(default_factory=list)
    rows: dict[str, RowRuns] = field(default_factory=dict)
    failed: list[tuple[int, str]] = field(default_factory=list)
    bound: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    own_bound: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    bound_series: dict[str, _Sum] = field(default_factory=dict)
    mcreynolds: dict[tuple[str, str, str, str], list[float]] = field(default_factory=dict)
    cautions: dict[tuple[str, str], list[int]] = field(default_factory=dict)


def _number(value: Any) -> float:
    return np.nan if value is None else float(value)


def _put(table: dict[Any, list[float]], key: Any, value: Any, before: int) -> None:
    """Append a number to a column, filled up with NaN for the `before` earlier runs."""
    column = table.setdefault(key, [])
    column += [np.nan] * (before - len(column))
    column.append(_number(value))


def _add_row(row: RowRuns, scalars: Mapping[str, Any], run: int, before: int) -> None:
    status = scalars["status"]
    if status != "ok":
        row.bad.append((run, status, scalars["message"]))
    if status == "diverged":
        return  # without numbers, and its kind may be wrong
    row.kind = scalars["kind"]
    for joint, freedoms in {"joint": "freedoms", "without": "freedoms_without"}.items():
        row.freedoms[joint] = max(row.freedoms.get(joint, 0), scalars.get(freedoms, 0))
    for key in ("anees", "anees_without_truth_noise", "anees_without"):
        _put(row.own, key, scalars.get(key), before)
    for sensor, count in scalars["rejected"].items():
        row.rejected[sensor] = row.rejected.get(sensor, 0) + count
    for name, values in scalars["states"].items():
        row.units[name] = values["unit"]
        row.freedoms[name] = max(row.freedoms.get(name, 0), values.get("freedoms", 0))
        for key, value in values.items():
            if key not in ("unit", "freedoms"):
                _put(row.state, (name, key), value, before)
    statics = scalars.get("statics", {})
    row.static_units |= {name: values["unit"] for name, values in statics.items()}
    for name, values in {**statics, "": scalars.get("statics_joint", {})}.items():
        for key, value in values.items():
            if key != "unit":
                _put(row.static, (name, key), value, before)
    laid = scalars.get("aligned") or {}
    states = laid.get("states", {})
    row.static_units |= {name: values["unit"] for name, values in states.items()}
    for key, value in laid.items():
        if key != "states":
            _put(row.aligned, ("", key), value, before)
    for name, values in states.items():
        _put(row.aligned, (name, "rmse"), values["rmse"], before)
    for sensor, values in scalars["innovations"].items():
        for key, value in values.items():
            _put(row.sensor, (sensor, key), value, before)


def _add(found: Collected, record: RunRecord) -> None:
    scalars, run, before = record.scalars, int(record.scalars["run"]), len(found.runs)
    found.runs.append(run)
    if "failed" in scalars:
        found.failed.append((run, scalars["failed"]))
        return
    for name, values in scalars["rows"].items():
        row = found.rows.setdefault(name, RowRuns())
        _add_row(row, values, run, before)
        for key, value in scalars["timing"][name].items():
            parts = value.items() if isinstance(value, Mapping) else [(key, value)]
            for part, seconds in parts:
                _put(row.timing, part, seconds, before)
        if values["status"] != "diverged":
            row.series.add(record.series[name])
            row.nis.add(record.series[f"nis {name}"])
        residuals = scalars["noise"].get(name, {})
        for noise, value in residuals.get("squares", {}).items():
            _put(row.squares, noise, value, before)
        if "cost" in residuals:
            _put(row.own, "cost", residuals["cost"], before)
        if f"coupling {name}" in record.series:
            coupling = record.series[f"coupling {name}"]
            if not row.coupling or row.coupling[0].shape == coupling.shape:
                row.coupling.append(coupling)
        for state, value in values.get("bound", {}).items():
            _put(found.own_bound, (name, state), value, before)
    for name, cautions in scalars.get("cautions", {}).items():
        for caution in cautions:
            found.cautions.setdefault((name, caution), []).append(run)
    for kind, states in scalars["bound"].items():
        for state, value in states.items():
            _put(found.bound, (kind, state), value, before)
        total = found.bound_series.setdefault(kind, _Sum())
        total.add(record.series[f"bound {kind}"])
    for filtered, others in scalars["mcreynolds"].items():
        for smoothed, states in others.items():
            for state, values in states.items():
                for key, value in values.items():
                    _put(found.mcreynolds, (filtered, smoothed, state, key), value, before)


def _pad(found: Collected) -> None:
    """Fill every column up with NaN, so that all have one number per run."""
    tables: list[dict[Any, list[float]]] = [found.bound, found.own_bound, found.mcreynolds]
    for row in found.rows.values():
        tables += [row.own, row.timing, row.state, row.static, row.aligned]
        tables += [row.sensor, row.squares]
    for table in tables:
        for column in table.values():
            column += [np.nan] * (len(found.runs) - len(column))


def collect(records: Iterable[RunRecord]) -> Collected:
    """Records, in the order of their runs, added up."""
    found = Collected()
    for record in records:
        _add(found, record)
    _pad(found)
    return found
