"""Measurements, inputs and stamps given in another unit than the one in the name of their column.

A wrong unit is wrong from the first number on, by a factor that people know: so a sensor's first
measurement is held against what is expected of it, an input by the first measurements that
follow it, and where they fit only after such a factor, the error says which.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import chdtri

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Sensor
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Layout
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.whitening import measurement_noise
from relnav_graph.units import column_unit, unit_scale

__all__ = ["check_step", "check_units", "wrong_input", "wrong_unit"]

#: Units that people mean, by the SI unit that the name of a column says.
_MEANT = {
    "rad/s": ("deg/s", "deg/h"),
    "m/s": ("km/s", "mm/s"),
    "m/s^2": ("g0", "mm/s^2"),
    "rad": ("deg", "arcsec", "mrad"),
    "m": ("km", "mm"),
}
#: Chi-square tail probabilities: below the first, a measurement does not fit as it is; above
#: the second, it fits in another unit.
_MISFIT, _FIT = 1e-9, 1e-3
#: Squared misfit by which one unit must fit better than another that is more usual.
_DECISIVE = 16.0


def _misfit(
    sensor: Sensor, m: Measurement, layout: Layout, x: Array, P: Array
) -> tuple[float, int]:
    """r^T S^-1 r with S = H P H^T + R at the state x (size,) of covariance P (n, n); rows of r."""
    values, own = layout.values(x), numbered_of(sensor)
    blocks = [] if own is None else [own.numbered(int(i)) for i in m.ids]
    given = [values[b.name] for b in sensor.reads]
    if own is not None:
        given.append(np.array([values[b.name] for b in blocks]))
    r, jacobians = sensor.residual(m, *given)
    H = np.hstack(jacobians[: len(sensor.reads)])
    if own is not None:  # each row reads the block of its own observation
        rows = np.arange(len(r)).reshape(len(blocks), -1)
        each = [np.where(np.isin(np.arange(len(r)), k)[:, None], jacobians[-1], 0.0) for k in rows]
        H = np.hstack([H, *each])
    _, columns = layout.gather([*sensor.reads, *blocks])
    S = H @ P[np.ix_(columns, columns)] @ H.T
    for k, R in enumerate(measurement_noise(m.sensor, sensor, m)):
        part = slice(k * sensor.rows, (k + 1) * sensor.rows)
        S[part, part] += R
    return float(r @ np.linalg.solve(S, r)), len(r)


def _scales(columns: Sequence[str]) -> Iterator[tuple[str, Array]]:
    """Each wrong unit that columns may be in, in words, and the factors (columns,) to the right."""
    units = [column_unit(c) for c in columns]
    for si, meant in _MEANT.items():
        chosen = np.array([u == si for u in units])
        for unit in meant if chosen.any() else ():
            yield f"{unit} given for {si}", np.where(chosen, unit_scale(unit, si), 1.0)


def wrong_unit(sensor: Sensor, m: Measurement, layout: Layout, x: Array, P: Array) -> str | None:
    """A message when a measurement fits in another unit only; None when it fits as it is, or in
    no unit. x (size,), P (n, n): predicted state and covariance."""
    fitting = None
    try:
        misfit, rows = _misfit(sensor, m, layout, x, P)
        if misfit <= chdtri(rows, _MISFIT):
            return None
        for words, scale in _scales(sensor.columns):
            misfit, _ = _misfit(sensor, replace(m, z=m.z * scale), layout, x, P)
            if misfit <= chdtri(rows, _FIT) and fitting is None:
                fitting = words
    except Exception:  # what a model has against it is for the estimator to say
        return None
    if fitting is None:
        return None
    return f"{fitting}? its squared misfit is far from chance as it is, and not in that unit"


def _least_misfit(
    problem: Problem, measurements: Sequence[Measurement], x: Array, P: Array
) -> tuple[float, int]:
    """Squared misfit of measurements and of a prediction x (size,), P (n, n), at the state that
    suits both best, and the rows: of linear models that of the innovation."""
    layout = problem.layout
    assembly = Assembly(
        layout, {}, problem.sensors, [Epoch(measurements[0].t, tuple(measurements))]
    )
    every, whiten = np.ones(assembly.observations), np.linalg.inv(np.linalg.cholesky(P))

    def rows_at(x_now: Array) -> tuple[Array, Array]:
        rows = assembly.measure(x_now[None], every)
        if (rows.status > 0).any():
            raise GeometryError("an observation is impossible there")
        return np.concatenate([rows.r, whiten @ layout.local(x, x_now)]), rows.H

    now = x
    (r, H), step = rows_at(now), 1.0
    for _ in range(30):
        d = -np.linalg.lstsq(np.vstack([H, whiten]), r, rcond=None)[0]
        moved = layout.retract(now, step * d)
        r_moved, H_moved = rows_at(moved)
        gained = r @ r - r_moved @ r_moved
        if gained < 0:
            step *= 0.5
            continue
        now, r, H, step = moved, r_moved, H_moved, min(1.0, 2 * step)
        if gained < 1e-3 * (1 + r @ r):
            break
    return float(r @ r), len(H)


#: What the prediction to an epoch is, x (size,) and P (n, n), with inputs u by process.
Predict = Callable[[Mapping[str, Array]], tuple[Array, Array]]


def wrong_input(
    problem: Problem,
    measurements: Sequence[Measurement],
    inputs: Mapping[str, Array],
    predict: Predict,
) -> str | None:
    """A message when measurements fit with an input in another unit only; "" when they fit as it
    is, None when in no unit.

    inputs: u (rows, 1 + channels) by process, SI, from a known state to the measurements' epoch;
    predict: what is expected there with such inputs.
    """
    least, fitting = np.inf, None
    try:
        size, rows = _least_misfit(problem, measurements, *predict(inputs))
        if size <= chdtri(rows, _MISFIT):
            return ""
        for name in dict.fromkeys(n for p in problem.processes.values() for n in p.inputs):
            columns = next(p.inputs[name] for p in problem.processes.values() if name in p.inputs)
            for words, scale in _scales(columns):
                given = predict(_scaled(problem, inputs, name, scale))
                size, rows = _least_misfit(problem, measurements, *given)
                # The first of several that fit: the more usual one.
                if size <= chdtri(rows, _FIT) and size < least - _DECISIVE:
                    least, fitting = size, f"input {name!r}: {words}?"
    except Exception:  # what a model has against it is for the estimator to say
        return None
    if fitting is None:
        return None
    return f"{fitting} what is measured next is far from chance as it is, and not in that unit"


def _scaled(
    problem: Problem, inputs: Mapping[str, Array], name: str, scale: Array
) -> dict[str, Array]:
    """The inputs u of all processes with one input times scale (channels,)."""
    out = {}
    for key, u in inputs.items():
        factors, at = np.ones(u.shape[1]), 1
        for other, columns in problem.processes[key].inputs.items():
            if other == name:
                factors[at : at + len(columns)] = scale
            at += len(columns)
        out[key] = u * factors
    return out


def check_units(problem: Problem) -> None:
    """Raise InputError when the first measurements of a problem fit its prior in another unit only,
    or those after the inputs began with inputs in another unit only."""
    x, P = problem.prior.x, problem.prior.P
    for m in problem.epochs[0].measurements if problem.epochs else ():
        reason = wrong_unit(problem.sensors[m.sensor], m, problem.layout, x, P)
        if reason is not None:
            raise InputError(f"sensor {m.sensor!r} at t = {m.t} s: {reason}")
    driven = any(p.inputs for p in problem.processes.values())
    for before, epoch in pairwise(problem.epochs) if driven else ():
        t = before.t

        def predict(
            u: Mapping[str, Array], t0: float = t, t1: float = epoch.t, at: Any = (x, P)
        ) -> tuple[Array, Array]:
            ahead = [Epoch(t1, (), u)]
            return Assembly(problem.layout, problem.processes, {}, ahead, t0).predict(*at)

        if epoch.measurements:
            reason = wrong_input(problem, epoch.measurements, epoch.inputs, predict)
            if reason:
                raise InputError(f"from t = {t} s to {epoch.t} s: {reason}")
            return
        x, P = predict(epoch.inputs)


def check_step(times: Array, step: float | None) -> None:
    """Raise InputError when epochs at times (N,), s, are a thousand, a million or a billion times
    further apart than `step`, s, which a scenario gives."""
    if step is None or len(times) < 2:
        return
    typical = float(np.median(np.diff(times)))
    for unit, factor in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if 0.9 < typical / (factor * step) < 1.1:
            raise InputError(
                f"the epochs from t = {times[0]:.15g} s on are {typical:.6g} s apart, expected"
                f" time.step = {step:g} s: are the stamps in {unit}?"
            )
