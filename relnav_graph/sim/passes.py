"""A whole pass simulated: truth, inputs, measurements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import DRIFTS
from relnav_graph.core.contracts import BringsTruth, Dynamics, Sensor, Wanders
from relnav_graph.core.copies import with_true_copies
from relnav_graph.core.measurement import SAME_TIME, InputSeries
from relnav_graph.core.problem import layout_of
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording, Truth, at_all_times
from relnav_graph.errors import InputError
from relnav_graph.sim.contracts import (
    ControlledTruth,
    DrivenTruth,
    FliesManoeuvres,
    IntervalInstrument,
    KnownInput,
    PlannedInput,
)
from relnav_graph.sim.instruments.interval_inputs import IntervalInputs, check_samples
from relnav_graph.sim.sensors import Timing, measure_all, stream

__all__ = [
    "biases_as_in",
    "simulate",
    "true_pass",
    "with_statics",
    "with_wander",
]


def _drifted(
    truth_model: Any, inputs: IntervalInputs, times: Array, rng: np.random.Generator
) -> tuple[Truth, dict[str, InputSeries]]:
    """A pass flown without commands, and its inputs. Raises InputError when the truth cannot
    be flown or cannot drive an input."""
    if not isinstance(truth_model, ControlledTruth):
        raise InputError(f"truth.kind: found {truth_model.kind!r}, which drives no such inputs")
    flight = truth_model.fly(float(times[0]), rng)
    values = [{**flight.values(), **inputs.biases(0)}]
    parts: list[dict[str, InputSeries]] = []
    for k in range(1, len(times)):
        t0, t1 = float(times[k - 1]), float(times[k])
        parts.append(inputs.over(t0, t1, flight.advance(t1, None, inputs.edges(t0, t1))))
        values.append({**flight.values(), **inputs.biases(k)})
    series = {}
    for name in parts[0] if parts else ():
        own = [part[name] for part in parts]
        columns = ([s.t_start for s in own], [s.t_end for s in own], [s.values for s in own])
        t_start, t_end, means = (np.concatenate(c) for c in columns)
        series[name] = InputSeries(name, t_start, t_end, means)
    found = {name: np.array([v[name] for v in values]) for name in values[0]}
    return Truth(times, found, truth_model.source), series


def _flown(
    truth_model: Any, plans: Mapping[str, PlannedInput], times: Array, seed: int, run: int
) -> Truth:
    """The truth with what becomes of the plans. Raises InputError when it flies none."""
    rng = stream(seed, run, "truth")
    if not plans:
        truth: Truth = truth_model.simulate(times, rng)
        return truth
    if not isinstance(truth_model, FliesManoeuvres):
        found = f"inputs.{next(iter(plans))}: found manoeuvres"
        raise InputError(f"{found}, which a truth of kind {truth_model.kind} does not fly")
    steps = [plan.flown(stream(seed, run, f"input {name}")) for name, plan in plans.items()]
    flown = np.concatenate(steps)
    return truth_model.flown(times, rng, flown[np.argsort(flown[:, 0], kind="stable")])


def biases_as_in(layout: Layout, values: Mapping[str, Array]) -> dict[str, Array]:
    """True values by name, (dim,) or (N, dim), SI, with biases as a state has them: where it has
    no block for what drifts about a constant bias, the bias is the whole of it."""
    found = dict(values)
    for drift, bias in DRIFTS.items():
        if drift in found and drift not in layout and bias in layout:
            found[bias] = found[bias] + found[drift]
    return found


def with_statics(truth: Truth, statics: Mapping[str, Array]) -> Truth:
    """A truth with the values of static blocks, (3, 3) or (dim,), SI, at all its times (N,).

    Raises InputError when it has one of them itself.
    """
    for name in statics:
        if name in truth.values:
            raise InputError(f"truth.statics.{name}: found a value, but the truth gives its own")
    tiled = {name: at_all_times(value, len(truth.t)) for name, value in statics.items()}
    return replace(truth, values={**truth.values, **tiled})


def _with_brought(truth: Truth, sensors: Mapping[str, Sensor], seed: int, run: int) -> Truth:
    """A truth with what it lacks and sensors bring. Raises InputError on values of another form."""
    values, source = dict(truth.values), truth.source
    for name, sensor in sensors.items():
        lacking = {b.name: b for b in sensor.reads if b.name not in values}
        if not lacking or not isinstance(sensor, BringsTruth):
            continue
        own = sensor.own_truth(truth.t, stream(seed, run, f"truth of {name}"))
        for key, block in lacking.items():
            if key not in own:
                continue
            shape, value = block.unpack(np.zeros(block.size)).shape, np.asarray(own[key], float)
            if value.shape == shape:
                value = at_all_times(value, len(truth.t))
            if value.shape != (len(truth.t), *shape):
                found = f"found {value.shape}, expected {(len(truth.t), *shape)} or {shape}"
                raise InputError(f"sensor {name!r}: own_truth of {key}: {found}")
            values[key], source = value, f"{source}; {key}: that of sensor {name!r}"
    return replace(truth, values=values, source=source)


def with_wander(
    truth: Truth,
    processes: Mapping[str, Dynamics],
    sensors: Mapping[str, Sensor],
    seed: int,
    run: int = 0,
) -> Truth:
    """A truth with what it lacks of what sensors read, where a sensor brings it itself, or else a
    process can draw it, as that of a bias, each with a stream of its own; its source says so."""
    truth = _with_brought(truth, sensors, seed, run)
    lacking = {b.name for s in sensors.values() for b in s.reads} - truth.values.keys()
    values: dict[str, Array] = {}
    for name, process in processes.items():
        if isinstance(process, Wanders) and any(b.name in lacking for b in process.advances):
            values |= process.wandering(truth.t, stream(seed, run, f"process {name}"))
    if not values:
        return truth
    source = f"{truth.source}; {', '.join(values)}: drawn from the estimators' own process"
    return replace(truth, values={**truth.values, **values}, source=source)


def simulate(
    truth_model: Any,
    inputs: Mapping[str, Any],
    processes: Mapping[str, Dynamics],
    sensors: Mapping[str, Sensor],
    timings: Mapping[str, Timing],
    times: Array,
    seed: int,
    run: int = 0,
    statics: Mapping[str, Array] | None = None,
) -> Recording:
    """A simulated pass: truth, inputs and measurements at `times` (N,), s.

    statics: true values of static blocks that the truth does not give itself, (3, 3) or (dim,), SI.

    Raises InputError when the truth cannot drive an input or a sensor, or is not finite.
    """
    models = processes, sensors
    truth, series = true_pass(truth_model, inputs, *models, times, seed, run, statics)
    return Recording(times, measure_all(sensors, timings, truth, seed, run), series, truth)


def true_pass(
    truth_model: Any,
    inputs: Mapping[str, Any],
    processes: Mapping[str, Dynamics],
    sensors: Mapping[str, Sensor],
    times: Array,
    seed: int,
    run: int = 0,
    statics: Mapping[str, Array] | None = None,
) -> tuple[Truth, dict[str, InputSeries]]:
    """The truth of a simulated pass at `times` (N,), s, and its inputs; see `simulate`."""
    layout = layout_of(processes, sensors)
    t0, t1 = float(times[0]), float(times[-1])
    series: dict[str, InputSeries] = {}
    if isinstance(truth_model, DrivenTruth):
        for name, source in inputs.items():
            if not isinstance(source, KnownInput):
                raise InputError(
                    f"inputs.{name}: a truth of kind {truth_model.kind} wants constant_input"
                )
            series[name] = source.series(name, t0, t1)
        rng = stream(seed, run, "truth")
        truth = truth_model.follow(layout, processes, series, times, rng, statics or {})
    elif any(isinstance(source, IntervalInstrument) for source in inputs.values()):
        columns = {name: len(c) for p in processes.values() for name, c in p.inputs.items()}
        drawn = IntervalInputs(
            inputs, columns, times, lambda name: stream(seed, run, f"input {name}")
        )
        truth, series = _drifted(truth_model, drawn, times, stream(seed, run, "truth"))
    else:
        plans = {name: s for name, s in inputs.items() if isinstance(s, PlannedInput)}
        truth = _flown(truth_model, plans, times, seed, run)
        for name, source in inputs.items():
            if isinstance(source, KnownInput | PlannedInput):
                planned = source.series if isinstance(source, KnownInput) else source.planned
                series[name] = planned(name, t0, t1)
                continue
            check_samples(name, source, t0, t1)
            edges = source.edges(t0, t1)
            rates = truth_model.mean_rate(edges[:-1], edges[1:])
            rng = stream(seed, run, f"input {name}")
            series[name], bias = source.sample(rates, edges[:-1], edges[1:], rng)
            at = np.searchsorted(edges, times - SAME_TIME)
            truth = Truth(truth.t, {**truth.values, f"{name}_bias": bias[at]}, truth.source)
    if not isinstance(truth_model, DrivenTruth):
        truth = with_wander(with_statics(truth, statics or {}), processes, sensors, seed, run)
        truth = replace(truth, values=biases_as_in(layout, truth.values))
    known = {b.name: truth.values[b.name] for b in layout if b.name in truth.values}
    for name, values in known.items():
        bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        if bad.any():
            t = truth.t[int(np.nonzero(bad)[0][0])]
            raise InputError(
                f"truth: {name} is not finite at t = {t} s, expected numbers that can be integrated"
                " (too large, or in another unit?)"
            )
    return with_true_copies(Truth(truth.t, known, truth.source), sensors), series
