"""Buffers of a stream: samples of inputs, and epochs that wait for their inputs."""

from __future__ import annotations

import bisect
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import process_inputs, stamped
from relnav_graph.core.measurement import (
    SAME_TIME,
    Bridge,
    InputSeries,
    Measurement,
    edge_tolerance,
)
from relnav_graph.core.problem import Problem
from relnav_graph.errors import InputError
from relnav_graph.streaming.lines import InputSample

__all__ = ["Gap", "InputBuffer", "Inputs", "Waiting", "WaitingEpoch"]

#: Samples of one input, and observations, that are kept until they become an epoch: memory stays
#: flat, whatever comes.
ROOM = 100_000


class InputBuffer:
    """Samples of one input in order of time, whatever the order of arrival."""

    def __init__(self, name: str, channels: int) -> None:
        self.name, self.channels = name, channels
        self.samples: list[InputSample] = []

    def add(self, sample: InputSample) -> None:
        """Put a sample in its place. Raises InputError when it overlaps another one, or finds no
        room."""
        k = bisect.bisect_left(self.samples, sample.t_start - SAME_TIME, key=lambda s: s.t_start)
        for other in self.samples[max(k - 1, 0) : k + 1]:
            if (
                other.t_start < sample.t_end - SAME_TIME
                and sample.t_start < other.t_end - SAME_TIME
            ):
                raise InputError(
                    f"overlap: found {sample.t_start} s to {sample.t_end} s, which overlaps"
                    f" {other.t_start} s to {other.t_end} s"
                )
        if len(self.samples) >= ROOM:
            raise InputError(f"full: {ROOM} samples wait for an epoch already")
        self.samples.insert(k, sample)

    def holds(self, sample: InputSample) -> bool:
        """Whether the same sample is there already."""
        k = bisect.bisect_left(self.samples, sample.t_start - SAME_TIME, key=lambda s: s.t_start)
        return any(
            abs(other.t_start - sample.t_start) <= SAME_TIME
            and abs(other.t_end - sample.t_end) <= SAME_TIME
            and np.array_equal(other.values, sample.values)
            for other in self.samples[k : k + 1]
        )

    def reach(self, t0: float, t1: float) -> float:
        """The time, s, up to which samples tell of [t0, t1] without a gap; t0 when none does."""
        t = t0
        for k in range(self._first(t0, t1), len(self.samples)):
            if self.samples[k].t_start > t + SAME_TIME:
                break
            t = max(t, self.samples[k].t_end)
        return t

    def _first(self, t0: float, t1: float) -> int:
        """Number of the first sample that tells of [t0, t1], s, or of what comes after."""
        end = t0 + edge_tolerance(t0, t1)
        return bisect.bisect_right(self.samples, end, key=lambda s: s.t_end)

    def series(self, t0: float, t1: float, beside: bool = False) -> InputSeries:
        """The samples that touch [t0, t1], s; and those before and after them."""
        k, end = self._first(t0, t1), t1 - edge_tolerance(t0, t1)
        j = bisect.bisect_left(self.samples, end, key=lambda s: s.t_start)
        chosen = self.samples[max(k - 1, 0) : j + 1] if beside else self.samples[k:j]
        values = np.array([s.values for s in chosen]).reshape(len(chosen), self.channels)
        edges = np.array([(s.t_start, s.t_end) for s in chosen]).reshape(-1, 2)
        return InputSeries(self.name, edges[:, 0], edges[:, 1], values)

    def resumed(self, t0: float, t1: float) -> bool:
        """Whether a sample tells of the end of [t0, t1], s, whatever is missing before it."""
        last = self.series(t0, t1).t_end[-1:]
        return bool(last.size and last[0] >= t1 - edge_tolerance(t0, t1))

    def held(self, t0: float, t1: float) -> InputSeries:
        """The samples of [t0, t1], s; where they end before t1, the newest one is held to t1."""
        end = self.reach(t0, t1)
        if end >= t1 - edge_tolerance(t0, t1) or not self.samples:
            return self.series(t0, t1)
        past = [s for s in self.samples if s.t_start < end + SAME_TIME]
        values = (past or self.samples)[-1].values
        known = self.series(t0, end)
        return InputSeries(
            self.name,
            np.append(known.t_start, end),
            np.append(known.t_end, t1),
            np.vstack([known.values, values]),
        )

    def drop(self, t: float) -> None:
        """Delete the samples that end by t, s, but the last of them, which may be held."""
        gone = bisect.bisect_right(self.samples, t, key=lambda s: s.t_end)
        del self.samples[: max(gone - 1, 0)]


@dataclass(frozen=True)
class Gap:
    """What is missing of an input, from start to end, s; long: of a gap that is longer than its
    bridge, and over."""

    name: str
    start: float
    end: float
    long: bool


def _endless(bridge: Bridge) -> Bridge:
    return replace(bridge, longest=np.inf)


class Inputs(dict[str, InputBuffer]):
    """All inputs, by name."""

    def lacking(self, now: float, t: float) -> str:
        """A message naming an input that does not cover `now` to t, s; "" when all do."""
        for name, buffer in self.items():
            reach = buffer.reach(now, t)
            if reach < t - edge_tolerance(now, t):
                return f"no inputs: {name} reaches {reach} s only"
        return ""

    def gaps(self, problem: Problem, now: float, t: float) -> list[Gap]:
        """Gaps between `now` and t, s. Raises InputError on one that is not to be bridged: longer
        than its bridge, unless it is over at t, or of an input of which nobody says how far it may
        have gone."""
        found = []
        for name, series in self._series(problem, problem.bridges, now, t).items():
            try:
                parts, long = series.gaps(now, t), False
            except InputError:
                if series.bridge is None or not self[name].resumed(now, t):
                    raise
                parts, long = replace(series, bridge=_endless(series.bridge)).gaps(now, t), True
            found += [Gap(name, start, end, long) for start, end in parts]
        return found

    def _series(
        self, problem: Problem, bridges: Mapping[str, Bridge], now: float, t: float
    ) -> dict[str, InputSeries]:
        jitter = {name: s.jitter for name, s in problem.stamps.items()}
        series = {name: buffer.series(now, t, beside=True) for name, buffer in self.items()}
        return {
            name: replace(own, bridge=bridges.get(name), jitter=jitter.get(name, 0.0))
            for name, own in series.items()
        }

    def since(self, problem: Problem, now: float, t: float, hold: bool) -> dict[str, Array]:
        """Inputs of each process from `now` to t, s, by name: u (rows, 1 + channels).

        Each row: length of the sub-interval, s, then the inputs, SI, and their spreads where a gap
        is bridged, as the problem says, however long: `gaps` says which may be. hold: the newest
        sample goes on beyond its end, without.
        """
        if hold:
            series = {name: buffer.held(now, t) for name, buffer in self.items()}
        else:
            endless = {name: _endless(bridge) for name, bridge in problem.bridges.items()}
            series = self._series(problem, endless, now, t)
        processes = problem.processes
        return {name: process_inputs(p, series, now, t) for name, p in processes.items()}


@dataclass
class WaitingEpoch:
    """Measurements of one time, not estimated yet; arrival: of the last of them, s; rows:
    their observations."""

    t: float
    arrival: float
    measurements: list[Measurement] = field(default_factory=list)
    rows: int = field(init=False)

    def __post_init__(self) -> None:
        self.rows = sum(len(m.z) for m in self.measurements)


class Waiting:
    """Epochs that wait, in order of time. merge: s, how close to one is of it."""

    def __init__(self, merge: float = SAME_TIME) -> None:
        self.merge = merge
        self.epochs: list[WaitingEpoch] = []

    def add(self, t: float, arrival: float, m: Measurement | None = None) -> None:
        """Let a measurement, if there is one, wait in the epoch at t, s: one that waits and is
        close enough, or a new one. Raises InputError when it finds no room."""
        k = bisect.bisect_left(self.epochs, t - self.merge, key=lambda e: e.t)
        new = k == len(self.epochs) or self.epochs[k].t > t + self.merge
        if new and len(self.epochs) >= ROOM:
            raise InputError(f"full: {ROOM} epochs wait for their inputs already")
        epoch = WaitingEpoch(t, arrival) if new else self.epochs[k]
        if m is not None and epoch.rows + len(m.z) > ROOM:
            raise InputError(f"full: {ROOM} observations of that time wait already")
        if new:
            self.epochs.insert(k, epoch)
        epoch.arrival = max(epoch.arrival, arrival)
        if m is not None:
            epoch.measurements.append(stamped(m, epoch.t))
            epoch.rows += len(m.z)

    def measured(self, t: float) -> list[Measurement]:
        """What waits to be taken in at t, s."""
        k = bisect.bisect_left(self.epochs, t - self.merge, key=lambda e: e.t)
        there = k < len(self.epochs) and self.epochs[k].t <= t + self.merge
        return self.epochs[k].measurements if there else []
