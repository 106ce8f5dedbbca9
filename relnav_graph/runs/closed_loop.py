"""Closed loops: estimators whose own estimates fly the chaser.

At each epoch the sensors measure the truth, the estimator makes an estimate, the controller a
command from the estimate, and the truth is propagated to the next epoch with that command
held. So each estimator flies a pass of its own, and its errors really move the craft; the
noises are the same for all. What was flown is then scored like any other pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch, process_inputs
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Recording, Track, Truth
from relnav_graph.errors import (
    EstimationError,
    GeometryError,
    InputError,
    ModelError,
)
from relnav_graph.estimators import GROUP, TakesEpochs, diverged, try_estimator
from relnav_graph.linear.assembly import Assembly
from relnav_graph.registry import find_class
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.sim.contracts import Flight, TakesBesides
from relnav_graph.sim.instruments.interval_inputs import IntervalInputs
from relnav_graph.sim.passes import biases_as_in
from relnav_graph.sim.sensors import check_known, measure_once, stream

__all__ = [
    "ClosedLoop",
    "Flown",
    "flies",
    "fly",
    "fly_all",
]


@dataclass(frozen=True, eq=False)
class Flown:
    """A pass that was flown: its problem, and the track, whose `truth` is what was flown."""

    problem: Problem
    track: Track


class ClosedLoop:
    """A pass as it is flown: a `relnav_graph.estimators.source.Source`.

    Raises InputError when truth, controller and sensors do not go together, EstimationError
    when the prior cannot be measured.
    """

    def __init__(self, scenario: Scenario, seed: int, run: int = 0) -> None:
        if scenario.control is None:
            raise InputError(f"{scenario.name}: no [control], so there is no loop to fly")
        if scenario.truth is None:
            raise InputError(f"{scenario.name}: no [truth] to fly")
        self.scenario, self._law, self.times = scenario, scenario.control, scenario.times
        self.count = len(self.times)
        self._inputs = IntervalInputs(
            scenario.inputs,
            {name: len(columns) for name, columns in scenario.input_columns.items()},
            self.times,
            lambda name: stream(seed, run, f"input {name}"),
        )
        self._flight: Flight = scenario.truth.fly(float(self.times[0]), stream(seed, run, "truth"))
        self._timings, self._sensors = scenario.timings, scenario.true_sensors
        self._streams = {
            name: (
                stream(seed, run, f"sensor {name}"),
                stream(seed, run, f"outliers {name}"),
            )
            for name in scenario.sensors
        }
        self._values: list[Mapping[str, Array]] = []
        self._epochs: list[Epoch] = []
        self._command: Array | None = None
        self._check({**scenario.statics, **self._flight.values()})
        measurements = self._reached()
        first = Recording(self.times[:1], measurements, {}, self.truth())
        self.problem = replace(scenario.problem(first, seed, run), epochs=())
        self._models = Assembly(
            self.problem.layout, self.problem.processes, self.problem.sensors, []
        )
        self._epochs.append(Epoch(float(self.times[0]), measurements))

    def _check(self, values: Mapping[str, Array]) -> None:
        for name, sensor in self._sensors.items():
            check_known(name, sensor, values)
        law = self._law
        missing = [n for n in law.reads if n not in self.scenario.layout]
        missing += [n for n in law.own if n not in values]
        if missing:
            raise InputError(f"control: {law.kind} needs {missing}, which nobody gives")

    def _reached(self) -> tuple[Measurement, ...]:
        """Store the true state at the present epoch, and simulate its measurements."""
        k = len(self._values)
        values = {**self.scenario.statics, **self._flight.values(), **self._inputs.biases(k)}
        values = biases_as_in(self.scenario.layout, values)
        self._values.append(values)
        t, t0, found = float(self.times[k]), float(self.times[0]), []
        for name, sensor in self._sensors.items():
            timing = self._timings[name]
            if timing.fires(t, t0):
                x = [np.ascontiguousarray(values[b.name]) for b in sensor.reads]
                m = measure_once(name, sensor, timing, t, x, *self._streams[name])
                found += [] if m is None else [m]
        return tuple(found)

    def _fly(self, t0: float, t1: float) -> Epoch:
        """Propagate the truth from t0 to t1, s, under the present command; the epoch at t1."""
        means = self._flight.advance(t1, self._command, self._inputs.edges(t0, t1))
        series = self._inputs.over(t0, t1, means)
        measurements = self._reached()
        u = {n: process_inputs(p, series, t0, t1) for n, p in self.problem.processes.items()}
        return Epoch(t1, measurements, u)

    def __iter__(self) -> Iterator[Epoch]:
        yield self._epochs[0]
        for t0, t1 in pairwise(self.times.tolist()):
            self._epochs.append(self._fly(t0, t1))
            yield self._epochs[-1]

    def assembly(self) -> Assembly:
        """The newest epoch, with the interval before it, ready to be linearised."""
        before = self._epochs[-2].t if len(self._epochs) > 1 else None
        return self._models.again(self._epochs[-1], before)

    def take(self, x: Array, besides: Mapping[str, Array]) -> None:
        """Make the next command from an estimate x (size,), and what is estimated besides, by name,
        SI. Raises EstimationError on a command that is not finite."""
        law, t = self._law, self._epochs[-1].t
        if t < law.start - SAME_TIME:
            return
        layout, values = self.problem.layout, self._values[-1]
        estimate = {name: layout.value(x, name) for name in law.reads}
        if isinstance(law, TakesBesides):
            estimate |= {name: besides[name] for name in law.besides if name in besides}
        command = np.asarray(law.command(t, estimate, {name: values[name] for name in law.own}))
        if not np.isfinite(command).all():
            raise EstimationError(f"t = {t} s: found the command {command}, expected finite ones")
        self._command = command

    def whole(self) -> Problem:
        """The problem of what was flown."""
        return replace(self.problem, epochs=tuple(self._epochs))

    def truth(self) -> Truth:
        """The truth of what was flown."""
        names = [b.name for b in self.scenario.layout if b.name in self._values[0]]
        needed = [*names, *(n for n in self._values[0] if n not in names)]
        values = {n: np.array([v[n] for v in self._values]) for n in needed}
        known = {n: values[n] for n in names}
        known |= self._law.control_errors(values)
        truth = Truth(self.times[: len(self._values)], known, self.scenario.truth.source)
        return self.scenario.with_map(truth)


def flies(kind: str) -> bool:
    """Whether an estimator takes one epoch at a time, so that it can fly. Raises ModelError on
    an unknown kind."""
    return issubclass(find_class(GROUP, kind), TakesEpochs)


def fly(scenario: Scenario, kind: str, seed: int, run: int = 0) -> Flown:
    """The pass that an estimator flies. Divergence ends the flight, and the track says so.

    Raises InputError as `ClosedLoop` does, ModelError on an estimator that is for whole
    passes only.
    """
    if not flies(kind):
        raise ModelError(f"estimator {kind!r} is for whole passes; it cannot fly one")
    loop = ClosedLoop(scenario, seed, run)
    estimator: Any = find_class(GROUP, kind)()
    # A filter that diverges overflows before its status says so.
    with threadpool_limits(1, "blas"), np.errstate(over="ignore", invalid="ignore"):
        try:
            track = estimator.drive(loop)
        except (EstimationError, GeometryError, ModelError, np.linalg.LinAlgError) as error:
            track = diverged(kind, loop.whole(), error)
    truth = loop.truth()
    ahead = track.smoothed and replace(track.smoothed, truth=truth)
    controlled = scenario.control.controlled if scenario.control is not None else ()
    track = replace(track, truth=truth, controlled=controlled, smoothed=ahead)
    return Flown(loop.whole(), track)


def fly_all(scenario: Scenario, kinds: Sequence[str], seed: int, run: int = 0) -> Iterator[Flown]:
    """The pass that each estimator flies. One for whole passes, which cannot fly, smooths the
    pass that the last one before it has flown. Raises InputError when there is none before it,
    and as `fly` does."""
    last: Flown | None = None
    for kind in kinds:
        if flies(kind):
            last = fly(scenario, kind, seed, run)
            yield last
            continue
        if last is None:
            raise InputError(f"estimator {kind!r} smooths what another has flown: name one before")
        track = try_estimator(kind, last.problem)
        yield Flown(last.problem, replace(track, truth=last.track.truth))
