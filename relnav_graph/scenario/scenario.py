"""Scenarios: checked settings become models, a prior and a `Problem`."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution, angle_cautions, orbit_cautions
from relnav_graph.core.contracts import CopiesBlocks, Derived, Dynamics, Mountable, Sensor
from relnav_graph.core.copies import check_copied, closure_of, copiers, with_true_copies
from relnav_graph.core.epochs import Epoch, epoch_times, make_epochs
from relnav_graph.core.measurement import SAME_TIME, Bridge, Stamps
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.numbered import families, first_seen, number_in
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.scored import Scored
from relnav_graph.core.shown import Shown, listed
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.maths.losses import Loss
from relnav_graph.scenario.first_estimate import with_measured
from relnav_graph.scenario.priors import make_prior, numbered_priors, prior_sigma
from relnav_graph.scenario.schema import ScenarioFile
from relnav_graph.scenario.settings import SensorOptions, besides
from relnav_graph.scenario.true_map import TrueMap
from relnav_graph.scenario.unit_check import check_step, check_units
from relnav_graph.sim.contracts import Controller
from relnav_graph.sim.passes import simulate, true_pass, with_statics, with_wander
from relnav_graph.sim.sensors import Timing, check_known, measure_all, stream
from relnav_graph.units import parse_quantity

__all__ = [
    "Scenario",
    "freed",
]

#: Why a simulated pass takes no truth noise.
NO_NOISE = "found one, but the truth is exact where all sensors are simulated on it"

_LOG = logging.getLogger(__name__)


def freed(sensors: Mapping[str, Sensor]) -> dict[str, Sensor]:
    """Sensors by name, each with its mounting in the state if it has one."""
    return {name: s.freed() if isinstance(s, Mountable) else s for name, s in sensors.items()}


@dataclass(frozen=True, eq=False, repr=False)
class Scenario(Shown):
    """A checked scenario: settings and models, ready to meet simulated or recorded data.

    statics: true values of static blocks that the truth does not give itself, (3, 3) or (dim,), SI.
    Of a mounting that the estimators take for known, too, so that it can be another one. map: the
    true points that no sensor knows. scored: how tracks are compared with the truth. truth_noise:
    sigmas (dim,), SI, of a recorded truth, by block, family or derived quantity.
    """

    name: str
    file: ScenarioFile
    raw: Mapping[str, Any]
    processes: Mapping[str, Dynamics]
    sensors: Mapping[str, Sensor]
    options: Mapping[str, SensorOptions]
    truth: Any
    inputs: Mapping[str, Any]
    layout: Layout
    control: Controller | None = None
    bridges: Mapping[str, Bridge] = field(default_factory=dict)
    statics: Mapping[str, Array] = field(default_factory=dict)
    map: TrueMap | None = None
    scored: Scored = field(default_factory=Scored)
    truth_noise: Mapping[str, Array] = field(default_factory=dict)

    def _shown(self) -> tuple[str, Mapping[str, str]]:
        rows = {
            "processes": listed(f"{n} ({p.kind})" for n, p in self.processes.items()),
            "sensors": listed(f"{n} ({s.kind})" for n, s in self.sensors.items()),
            "state": listed(f"{b.name} {b.symbol}" for b in self.layout),
            "truth": "none" if self.truth is None else str(self.truth.kind),
            "estimators": listed(self.file.estimators),
        }
        return f"Scenario {self.name!r}: {self.file.title}", rows

    @property
    def derived(self) -> list[Derived]:
        """What is scored beside the blocks of the state, or in the place of one."""
        return [*derived_quantities(self.layout), *self.scored.in_axes]

    @property
    def numbered_priors(self) -> dict[str, Prior]:
        """The prior of each numbered block that the sensors read, by the name of its family."""
        return numbered_priors(families(self.sensors), self.file.prior)

    @property
    def gates(self) -> dict[str, float]:
        """Probability of the gate of each sensor that has one."""
        return {name: o.gate for name, o in self.options.items() if o.gate is not None}

    @property
    def losses(self) -> dict[str, Loss]:
        """Robust loss of each sensor that has one."""
        found = self.options.items()
        return {name: Loss(o.loss, o.tuning) for name, o in found if o.loss is not None}

    @property
    def stamps(self) -> dict[str, Stamps]:
        """How late, and how unsteady, the stamps of inputs and sensors are, by name."""
        return {name: Stamps(s.lag, s.jitter) for name, s in self.file.stamps.items()}

    @property
    def timings(self) -> dict[str, Timing]:
        """How each sensor measures when it is simulated: one that closes loops to a keyframe, after
        it; one without a period at each of the epochs that [time] names, not at those that another
        sensor has besides."""
        out = {name: o.timing() for name, o in self.options.items()}
        if self._besides:
            step = self.file.time.step
            out = {n: replace(o, period=o.period or step) for n, o in out.items()}
        for name, sensor in self.sensors.items():
            if (closure := closure_of(name, sensor)) is not None:
                begin = max(out[name].begin, closure[1] + 2 * SAME_TIME)
                out[name] = replace(out[name], begin=begin)
        return out

    @property
    def input_columns(self) -> dict[str, tuple[str, ...]]:
        """Inputs that the processes need: the columns of each, by name."""
        return {k: v for p in self.processes.values() for k, v in p.inputs.items()}

    def window(self, times: Array) -> tuple[float, float] | None:
        """The scored part of a pass at `times` (N,), s, as fractions of it; None for all."""
        if self.file.evaluate is None:
            return None
        t0, length = float(times[0]), float(times[-1] - times[0]) or 1.0
        low, high = (
            (parse_quantity(end, "s") - t0) / length if isinstance(end, str) else end
            for end in self.file.evaluate
        )
        if not low < high or high < 0 or low > 1:
            _LOG.info(
                "evaluate = %s leaves no part of a pass from %g s to %g s: all of it is scored",
                *(self.file.evaluate, t0, t0 + length),
            )
            return None
        return max(low, 0.0), min(high, 1.0)

    @property
    def times(self) -> Array:
        """Epochs (N,) of a simulated pass, s: those that [time] names, and between them those of
        sensors whose period is no multiple of its step. Raises InputError where it names none."""
        time = self.file.time
        if time.step is None or time.epochs is None:
            raise InputError(f"{self.name}: no step and epochs in [time] to simulate at")
        grid = time.step * np.arange(time.epochs, dtype=np.float64)
        if not self._besides:
            return grid
        own = [p * np.arange(int(grid[-1] / p * (1 + 1e-9)) + 1) for p in self._besides]
        return epoch_times(np.sort(np.concatenate([grid, *own])))

    @property
    def _besides(self) -> list[float]:
        """Periods, s, that are no multiples of the step of a simulated pass."""
        step = self.file.time.step if self.file.simulated else None
        return sorted(besides(step, self.options.values()))

    @property
    def cautions(self) -> tuple[Caution, ...]:
        """What is doubtful about it before there are data; of the time of its pass, where one can
        be simulated at `times`."""
        prior = self.file.prior
        sigma = np.concatenate([prior_sigma(b, prior[b.name].sigma) for b in self.layout])
        found = angle_cautions(self.layout, sigma, self.sensors)
        if self.truth is None or self.file.time.epochs is None:
            return found
        models = [*self.processes.values(), *self.sensors.values()]
        return orbit_cautions(models, float(self.times[0])) + found

    @property
    def true_sensors(self) -> dict[str, Sensor]:
        """The sensors that measure, as they are simulated: mounted as `statics` says, where it
        does, and of known points."""
        free, known = freed(self.sensors), self.statics
        measuring = {
            name: free[name] if any(b.name in known for b in free[name].reads) else sensor
            for name, sensor in self.sensors.items()
            if not isinstance(sensor, CopiesBlocks)
        }
        return measuring if self.map is None else self.map.given_to(measuring)

    def with_map(self, truth: Truth) -> Truth:
        """A truth with the points of the map, where there is one, at all its times (N,). One that
        has a map itself, as of a data set, keeps it as it is: the other may be of another target,
        in other axes, or with other ids."""
        if self.map is None or any(number_in(name)[1] is not None for name in truth.values):
            return truth
        return with_statics(truth, self.map.values)

    def with_noise(self, truth: Truth) -> Truth:
        """A recorded truth with the sigmas that the scenario says; they win over those of data."""
        derived, sigmas = {q.block.name for q in self.derived}, dict(truth.sigmas)
        for name, sigma in self.truth_noise.items():
            own = [n for n in truth.values if name in (n, number_in(n)[0])]
            sigmas |= dict.fromkeys(own or ([name] if name in derived else []), sigma)
            if not own and name not in derived:
                _LOG.warning(f"truth_noise.{name}: the truth does not know {name}")
        count = len(truth.t)
        tiled = {n: s if s.ndim > 1 else np.tile(s, (count, 1)) for n, s in sigmas.items()}
        return replace(truth, sigmas=tiled)

    def simulate(self, seed: int, run: int = 0) -> Recording:
        """A simulated pass, without any control. Raises InputError when the scenario is not
        for simulation."""
        if self.truth is None or self.file.time.step is None:
            raise InputError(
                f"{self.name}: no [truth] and [time] to simulate from; give recorded data"
            )
        self.refuse_noise()
        models, timings = (self.processes, self.true_sensors), (self.timings, self.times)
        found = simulate(self.truth, self.inputs, *models, *timings, seed, run, self.statics)
        found = replace(found, truth=found.truth and self._scored(found.truth))
        return found.with_lags(self.stamps)

    def check_truth(self) -> None:
        """Raise InputError, naming each sensor and what it lacks, where the truth of a simulated
        pass does not give all that the sensors read. Flies the first two epochs."""
        if self.truth is None or self.file.time.step is None:
            return
        sensors, lacking = self.true_sensors, list[str]()
        given = self.truth, self.inputs, self.processes, sensors, self.times[:2]
        truth = true_pass(*given, self.file.seed, 0, self.statics)[0]
        for name, sensor in sensors.items():
            try:
                check_known(name, sensor, truth.values)
            except InputError as error:
                lacking.append(str(error))
        if lacking:
            raise InputError("\n".join(f"{self.name}: {one}" for one in lacking))

    def refuse_noise(self) -> None:
        """Raise InputError where a noise is said of a truth that is exact: of a simulated pass."""
        if self.truth_noise:
            raise InputError(f"{self.name}: truth_noise: {NO_NOISE}")

    def _scored(self, truth: Truth) -> Truth:
        """What of a truth is of this state, and the map."""
        known = {n: v for n, v in truth.values.items() if n in self.layout or n not in self.statics}
        return self.with_map(replace(truth, values=known))

    def completed(self, recording: Recording, seed: int, run: int = 0) -> Recording:
        """A recording with the true statics, and the sensors that [data] has simulated on its
        truth.

        Raises InputError when there is no truth, or none of what a sensor reads.
        """
        truth = recording.truth
        if truth is not None:
            truth = with_true_copies(with_statics(truth, self.statics), self.sensors)
            recording = replace(recording, truth=self.with_noise(self._scored(truth)))
        names = self.file.data.simulate if self.file.data is not None else []
        if not names:
            return recording
        if truth is None:
            raise InputError(f"data.simulate: found {names}, but the recording has no truth")
        if len(names) == len(self.sensors):
            self.refuse_noise()
        sensors = {name: self.true_sensors[name] for name in names}
        truth = with_wander(truth, self.processes, sensors, seed, run)
        recording = replace(recording, truth=self._scored(truth))
        made = measure_all(sensors, self.timings, truth, seed, run)
        return replace(recording, measurements=(*recording.measurements, *made))

    @property
    def measured(self) -> tuple[str, ...]:
        """Blocks whose prior is to be taken from the first measurements."""
        prior = self.file.prior
        return tuple(b.name for b in self.layout if prior[b.name].mean == "measured")

    def problem(self, recording: Recording, seed: int, run: int = 0) -> Problem:
        """The problem of a recording, with the scenario's prior.

        Raises InputError when the prior asks for a truth that is not known, when there is no epoch
        to close a loop to, or when the first measurements fit it in another unit only;
        EstimationError when it is to be measured and cannot be.
        """
        check_step(recording.times, self.file.time.step)
        recording, bridges = recording.without_lags(self.stamps), self.bridges
        inputs = {
            n: replace(s, bridge=bridges.get(n), jitter=self.stamps.get(n, Stamps()).jitter)
            for n, s in recording.inputs.items()
        }
        epochs = make_epochs(
            self.processes,
            recording.measurements,
            inputs,
            recording.times,
            self.file.time.tolerance,
        )
        numbered = first_seen(self.sensors, (m for e in epochs for m in e.measurements))
        prior = self.prior(recording.truth, epochs[0].t, seed, run, numbered)
        problem = self.problem_at(prior, epochs)
        if copiers(self.sensors):
            seen = [m for epoch in problem.epochs for m in epoch.measurements]
            check_copied(seen, self.sensors, {m.sensor: 1 for m in seen})
        problem = with_measured(problem, self.measured)
        check_units(problem)
        return problem

    def problem_at(self, prior: Prior, epochs: Sequence[Epoch] = ()) -> Problem:
        """The problem with a given prior; without epochs, one to be driven online."""
        models, options = (self.processes, self.sensors), (self.gates, self.file.online.window)
        return Problem(
            *(*models, prior, tuple(epochs), *options, self.losses),
            bridges=self.bridges,
            stamps=self.stamps,
            merge=self.file.time.tolerance,
            numbered=self.numbered_priors,
            considered=self._considered,
        )

    @property
    def _considered(self) -> tuple[str, ...]:
        """Blocks, and families, that are counted and not estimated: a mounting that is known may
        have a prior, and is not in the state."""
        there = {*(b.name for b in self.layout), *families(self.sensors)}
        return tuple(n for n, p in self.file.prior.items() if p.considered and n in there)

    def prior(
        self,
        truth: Truth | None,
        t: float,
        seed: int,
        run: int = 0,
        numbered: Sequence[Block] = (),
    ) -> Prior:
        """The prior at time t, s, drawn about the truth where it has no mean; with that of numbered
        blocks after it.

        Raises InputError when it needs a truth that is not known.
        """
        rng = stream(seed, run, "prior")
        layout = Layout(self.layout.moving, (*self.layout.statics, *numbered))
        return make_prior(layout, self.file.prior, truth, t, rng)

    def prior_with(self, means: Mapping[str, Array], t: float) -> Prior:
        """The prior at time t, s, with `means` for blocks whose mean the scenario leaves open.

        means: by block name, (3, 3) or (dim,), SI, in the block's frame. Blocks whose mean is to
        be measured may lack one. Raises InputError when another one is missing.
        """
        given = {n: self.file.prior[n].model_copy(update={"mean": "truth"}) for n in means}
        given |= {n: p for n, p in self.file.prior.items() if isinstance(p.mean, list)}
        truth = Truth(np.array([t]), {n: value[None] for n, value in means.items()})
        rng = stream(0, 0, "prior")  # nothing is drawn
        return make_prior(self.layout, {**self.file.prior, **given}, truth, t, rng)
