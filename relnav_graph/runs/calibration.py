"""How sensors are mounted and how late inputs are, from a pass: values that other passes hold.

The mounting of a sensor is static blocks of the state. What makes it observable is the truth, as
measurements of the pose with the noise that the truth has. The lag of an input is no state, nor is
any other number of a scenario, such as the baseline of a camera: the pass is smoothed with several,
and the posterior, with all states at their most likely values, is nearly a parabola in these
parameters. Its minimum and curvature give values and covariance, and how the mounting follows them
tells how their covariance adds to that of the mounting:

    P_m = P_m|p + D P_p D^T,  D = dm / dp
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Mountable, Sensor
from relnav_graph.core.measurement import Measurement, Stamps
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.weights import residual_weights
from relnav_graph.linear.assembly import Assembly
from relnav_graph.runs.parameter_search import Parameter, ParameterSearch
from relnav_graph.runs.passes import Pass
from relnav_graph.scenario.build import MOUNTED, make_scenario
from relnav_graph.scenario.priors import prior_sigma
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.toml import merge
from relnav_graph.units import quantities

__all__ = ["Calibration", "MountFound", "ParameterFound", "calibrate", "tables_of"]

#: The sensor that the truth becomes, and what is known of a mounting where the prior says nothing.
TRUTH, ROTATION, ARM = "measured_truth", "10 deg", "0.5 m"
#: A pass tells what it knows twice as well as before.
TOLD = 0.5


@dataclass(frozen=True, eq=False)
class MountFound:
    """What was found of one static block of a mounting: how far it is off what the sensor states.

    value (3, 3) or (3,): R_ns, or d_sn_c, m; P (3, 3): its covariance, rad^2 or m^2; told (3,):
    whether the pass tells it, along each axis; held: whether it was not estimated at all.
    """

    sensor: str
    block: Block
    value: Array
    P: Array
    told: NDArray[np.bool_]
    held: bool


@dataclass(frozen=True)
class ParameterFound:
    """A parameter, its value and sigma, SI; told: whether that is a small change of it."""

    parameter: Parameter
    value: float
    sigma: float
    told: bool


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a pass says of mountings, lags and other parameters.

    sensors: the fields of each that say how it is mounted, as they were found, by name; truth:
    whether that was used; before, after: mean squared whitened residual of the measurements that
    count, smoothed without the truth, before and with what was found.
    """

    scenario: str
    sensors: Mapping[str, Mapping[str, Array]]
    mounts: tuple[MountFound, ...]
    parameters: tuple[ParameterFound, ...]
    truth: bool
    before: float = np.nan
    after: float = np.nan


def calibrate(
    opened: Pass,
    sensors: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    settings: Sequence[str] = (),
    *,
    arms: bool | None = None,
    truth: bool = True,
) -> Calibration:
    """Mountings and lags that a pass says.

    sensors: those whose mounting is to be found, by default all that have one; inputs: those whose
    lag is, by default all; settings: paths of other numbers to be found, of sensors or processes
    ("sensors.camera.baseline"); arms: whether lever arms are estimated, by default where the truth
    is used: without it they may run away; truth: whether it is used, as measurements of the pose
    with the scenario's [truth_noise].

    Raises InputError on names that are none, when there is nothing to calibrate, or no truth, or
    no noise of it; EstimationError when the pass cannot be smoothed.
    """
    scenario = opened.scenario
    sensors, inputs = _chosen(scenario, sensors, inputs)
    arms = truth if arms is None else arms
    recording, tables = opened.recording, _freed(scenario, sensors, arms)
    if truth:
        posed = _truth_tables(scenario, recording)
        tables = merge(tables, {"sensors": {TRUTH: posed}})
        made = make_scenario(tables, scenario.name, {})
        recording = _with_truth(made, recording)
    parameters = *_lags(scenario, recording, inputs), *(_setting(scenario, n) for n in settings)
    search = ParameterSearch(tables, scenario.name, recording, opened, parameters)
    values, P, track = search.minimum()
    slopes = search.slopes(values, track)
    every = zip(parameters, values, np.sqrt(np.diag(P)), strict=True)
    mounts = tuple(_mounts(search.scenario(values), sensors, arms, track, slopes, P))
    found = Calibration(
        scenario.name,
        {name: _fields(scenario.sensors[name], mounts) for name in sensors},
        mounts,
        tuple(ParameterFound(p, float(v), float(s), bool(s < p.small)) for p, v, s in every),
        truth,
    )
    with_it = make_scenario(merge(scenario.raw, tables_of(found)), scenario.name, {})
    return replace(found, before=_misfit(scenario, opened), after=_misfit(with_it, opened))


def tables_of(found: Calibration) -> dict[str, Any]:
    """What was found as tables of a scenario, which holds it; and the covariance of a mounting as a
    prior that counts, without being estimated, where the scenario says mounting = "estimated"."""
    sensors = {
        name: {"mounting": "known", **{key: value.tolist() for key, value in own.items()}}
        for name, own in found.sensors.items()
    }
    priors = {
        m.block.name: {
            "sigma": np.sqrt(np.diag(m.P)).tolist(),
            "mean": [0.0, 0.0, 0.0],
            "considered": True,
        }
        for m in found.mounts
        if m.told.any()
    }
    tables: dict[str, Any] = {"sensors": sensors, "prior": priors}
    for one in found.parameters:
        if one.told:
            tables = merge(tables, one.parameter.tables(one.value))
    return tables


def _lags(scenario: Scenario, recording: Recording, inputs: Sequence[str]) -> Iterator[Parameter]:
    """The lag of each input; small against a sample of it."""
    for name in inputs:
        series, known = recording.inputs[name], scenario.stamps.get(name, Stamps())
        sample = float(np.median(series.t_end - series.t_start))
        yield Parameter(("stamps", name, "lag"), known.lag, sample, "s")


def _setting(scenario: Scenario, path: str) -> Parameter:
    """A number of a sensor or process, by its path; small: 2 % of it. Raises InputError on what is
    none."""
    parts = tuple(path.split("."))
    models = {"sensors": scenario.sensors, "processes": scenario.processes}
    model: Any = models.get(parts[0], {}).get(parts[1]) if len(parts) == 3 else None
    value = getattr(model, parts[-1], None)
    quantity = quantities(model.__class__).get(parts[-1]) if model is not None else None
    if quantity is None or not isinstance(value, float) or not value:
        raise InputError(
            f"{scenario.name}: found the setting {path!r}, expected a number of a sensor or a"
            ' process, not zero, like "sensors.camera.baseline"'
        )
    return Parameter(parts, value, 0.02 * abs(value), quantity.unit)


def _chosen(
    scenario: Scenario, sensors: Sequence[str] | None, inputs: Sequence[str] | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The sensors and inputs to calibrate. Raises InputError on what cannot be, or when there is
    nothing."""
    mountable = [n for n, s in scenario.sensors.items() if isinstance(s, Mountable)]
    known = list(scenario.input_columns)
    for what, names, all_of in (("sensor", sensors, mountable), ("input", inputs, known)):
        for name in names or ():
            if name not in all_of:
                raise InputError(
                    f"{scenario.name}: found {what} {name!r}, expected one of those that can be"
                    f" calibrated: {', '.join(all_of) or 'none'}"
                )
    chosen = tuple(mountable if sensors is None else sensors)
    lagging = tuple(known if inputs is None else inputs)
    if not chosen and not lagging:
        raise InputError(f"{scenario.name}: found neither a mounting nor an input to calibrate")
    return chosen, lagging


def _blocks(sensor: Sensor) -> tuple[Block, ...]:
    """The static blocks of a sensor's mounting."""
    assert isinstance(sensor, Mountable)
    return tuple(b for b in sensor.freed().reads if b.name.endswith(MOUNTED))


def _freed(scenario: Scenario, sensors: Sequence[str], arms: bool) -> dict[str, Any]:
    """The scenario's tables with these mountings in the state; lever arms only with `arms`."""
    own: dict[str, Any] = {"sensors": {}, "prior": {}}
    for name in sensors:
        own["sensors"][name] = {"mounting": "estimated"}
        for block in _blocks(scenario.sensors[name]):
            rotation = block.manifold == "SO3"
            wide = {"sigma": ROTATION if rotation else ARM, "mean": [0.0, 0.0, 0.0]}
            given = scenario.file.prior.get(block.name)
            if not rotation and not arms:
                own["prior"][block.name] = {**wide, "sigma": "1e-6 m", "considered": True}
            elif given is None or given.considered:
                own["prior"][block.name] = {**wide, "considered": False}
    return merge(scenario.raw, own)


def _pose(names: Sequence[str] | Layout) -> tuple[str, tuple[str, ...]]:
    """How the pose stands in a state, and the blocks that hold it."""
    if "relative_attitude" in names:
        return "target", ("relative_attitude", "relative_position")
    return "orbital", ("chaser_attitude", "target_attitude", "relative_position")


def _truth_tables(scenario: Scenario, recording: Recording) -> dict[str, Any]:
    """The table of the sensor that the truth becomes. Raises InputError without a truth of the
    pose, or without its noise."""
    pose, names = _pose(scenario.layout)
    truth = recording.truth
    lacking = [n for n in names if truth is None or n not in truth.values]
    if lacking:
        raise InputError(
            f"{scenario.name}: the truth does not know {', '.join(lacking)}; without it, lags and"
            " rotations are told by the measurements alone (--without-truth)"
        )
    noise = scenario.truth_noise
    turns = [noise[n] for n in names[:-1] if n in noise] or (
        [noise["relative_attitude"]] if "relative_attitude" in noise else []
    )
    if not turns or names[-1] not in noise:
        raise InputError(
            f"{scenario.name}: found [truth_noise] of {', '.join(noise) or 'nothing'}, expected"
            f" that of {' and '.join(names)}: the truth counts as a measurement; or none of it"
            " (--without-truth)"
        )
    sigma = np.sqrt(np.sum([np.square(np.broadcast_to(one, 3)) for one in turns], axis=0))
    place = np.broadcast_to(noise[names[-1]], 3)
    return {
        "kind": "pose_measurement",
        "pose": pose,
        "attitude_sigma": sigma.tolist(),
        "position_sigma": place.tolist(),
    }


def _with_truth(scenario: Scenario, recording: Recording) -> Recording:
    """The recording with its true poses as measurements, where they are known."""
    truth, sensor = recording.truth, scenario.sensors[TRUTH]
    assert truth is not None
    rows, known = truth.at(recording.times)
    values = [truth.values[name] for name in _pose(scenario.layout)[1]]
    ids, made = np.zeros(1, np.int64), list[Measurement]()
    for t, row in zip(recording.times[known], rows[known], strict=True):
        x = [np.ascontiguousarray(value[row]) for value in values]
        if all(np.isfinite(one).all() for one in x):
            made.append(Measurement(TRUTH, float(t), sensor.predict(ids, *x), ids))
    return replace(recording, measurements=(*recording.measurements, *made))


def _mounts(
    scenario: Scenario,
    sensors: Sequence[str],
    arms: bool,
    track: Track,
    slopes: Array,
    P_parameters: Array,
) -> Iterator[MountFound]:
    """The static blocks of the mountings, with the covariance that parameters add."""
    if track.statics is None:
        return
    layout, statics, seen = track.statics.layout, track.statics, set[str]()
    finite = np.where(np.isfinite(P_parameters), P_parameters, 0.0)
    P = statics.P[-1] + slopes @ finite @ slopes.T
    for name in sensors:
        for block in _blocks(scenario.sensors[name]):
            if block.name in seen:  # sensors of one mount
                continue
            seen.add(block.name)
            held = block.manifold != "SO3" and not arms
            own = layout.tangent(block.name)
            before = np.broadcast_to(prior_sigma(block, scenario.file.prior[block.name].sigma), 3)
            told = np.sqrt(np.diag(P[own, own])) < TOLD * before
            value = track.value(block.name)[-1]
            yield MountFound(name, block, value, P[own, own], told & (not held), held)


def _fields(sensor: Sensor, mounts: Sequence[MountFound]) -> dict[str, Array]:
    """How the sensor was found to be mounted, by its fields: those that the pass tells."""
    assert isinstance(sensor, Mountable)
    fields = sensor.mounting_fields({m.block.name: m.value for m in mounts if m.told.any()})
    return {n: v for n, v in fields.items() if not np.array_equal(v, getattr(sensor, n))}


def _misfit(scenario: Scenario, opened: Pass) -> float:
    """Mean squared whitened residual of the measurements that count, smoothed."""
    problem = scenario.problem(opened.recording, opened.seed, opened.run)
    track, assembly = run_estimator("batch", problem), Assembly.of(problem)
    if track.status == "diverged":
        return np.nan
    rows = assembly.measure(track.states, np.ones(assembly.observations))
    weights = residual_weights(assembly, rows, problem.gates, {})
    return float(np.mean(rows.r[assembly.rows_of(weights > 0)] ** 2))
