"""What a stream has taken in and not estimated yet: by the clock, without contradictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.errors import InputError
from relnav_graph.streaming.buffers import InputBuffer, Inputs, Waiting
from relnav_graph.streaming.clock import Clock
from relnav_graph.streaming.lines import InputSample, Tick

__all__ = ["Intake", "Item", "name_of", "times_of"]

Item = Measurement | InputSample | Tick
#: The name under which epochs that nobody measures have their place in the clock.
TICK = "an epoch"


def name_of(item: Item) -> str:
    """Sensor or input of a line, or "an epoch"."""
    if isinstance(item, InputSample):
        return item.name
    return item.sensor if isinstance(item, Measurement) else TICK


def times_of(item: Item) -> tuple[float, ...]:
    """Times of a line, s: where it begins, for an input; of validity, or its end; of arrival."""
    times = (item.t_start, item.t_end) if isinstance(item, InputSample) else (item.t,)
    return (*times, times[-1] if item.t_arrival is None else item.t_arrival)


class Intake:
    """The clock, the inputs, and the epochs that wait for them.

    columns: of each input, by name; begin: time of the prior, s, where the stream gives it;
    merge: s, how close to an epoch is of it.
    """

    def __init__(
        self,
        sensors: Sequence[str],
        columns: Mapping[str, Sequence[str]],
        max_gap: float,
        patience: float,
        begin: float | None,
        merge: float,
    ) -> None:
        self.clock = Clock((*sensors, *columns, TICK), max_gap, patience)
        self.inputs = Inputs({name: InputBuffer(name, len(c)) for name, c in columns.items()})
        self.waiting = Waiting(merge)
        self._begin, self._merge = begin, merge
        if begin is not None:
            self.clock.heard = begin
            self.waiting.add(begin, begin)

    def take(self, item: Item, epochs: Sequence[Epoch], now: float | None) -> str:
        """Take in a line; a message when its time has jumped, or "".

        epochs: those that it may still change; now: time of the newest of them that is
        estimated, s. Raises InputError, and changes nothing, when its times cannot be right, or
        it is at odds with what is there.
        """
        name, times = name_of(item), times_of(item)
        again = self.repeats(item, epochs)
        self.clock.check(name, times, again)
        self._check_late(item, times[-2], epochs, now)
        if isinstance(item, InputSample):
            if again:
                raise InputError("duplicate: of an input that is there already")
            self.inputs[name].add(item)
        else:
            m = item if isinstance(item, Measurement) else None
            if m is not None and not again:
                _check_second(m, self._measured(m, epochs))
            self.waiting.add(item.t, times[-1], m)
        return self.clock.take(name, times[-1])

    def refuse(self, item: Item, epochs: Sequence[Epoch], error: InputError) -> str:
        """Note that `take` refused a line; a message when that tells, as the first one, that a
        clock is wrong, else ""."""
        if self.repeats(item, epochs):
            self.clock.repeated(name_of(item))
            return ""
        return self.clock.refuse(name_of(item), times_of(item)[-1], error)

    def repeats(self, item: Item, epochs: Sequence[Epoch]) -> bool:
        """Whether a line repeats what is there."""
        if isinstance(item, InputSample):
            return self.inputs[item.name].holds(item)
        return isinstance(item, Measurement) and any(
            np.array_equal(m.ids, item.ids) and np.array_equal(m.z, item.z)
            for m in self._measured(item, epochs)
        )

    def _measured(self, m: Measurement, epochs: Sequence[Epoch]) -> list[Measurement]:
        """What its sensor has measured at its time, as far as it is still there."""
        found = list(self.waiting.measured(m.t))
        if epochs and m.t <= epochs[-1].t + self._merge:
            found += [o for e in epochs if abs(e.t - m.t) <= self._merge for o in e.measurements]
        return [other for other in found if other.sensor == m.sensor]

    def _check_late(self, item: Item, t: float, epochs: Sequence[Epoch], now: float | None) -> None:
        if self._begin is not None and t < self._begin - self._merge:
            raise InputError(f"late: before the prior, which is of {self._begin} s")
        if now is None:
            return
        if isinstance(item, InputSample):
            if t <= now + SAME_TIME:
                raise InputError(f"late: an input of a time before the newest epoch, {now} s")
        elif t < epochs[0].t - self._merge:
            raise InputError(f"late: before the window, which begins at {epochs[0].t} s")


def _check_second(m: Measurement, others: Sequence[Measurement]) -> None:
    """A sensor sees each id once at a time: raise InputError where another value is there."""
    for other in others:
        ids, i, j = np.intersect1d(m.ids, other.ids, return_indices=True)
        for id, found, known in zip(ids.tolist(), m.z[i], other.z[j], strict=True):
            if not np.array_equal(found, known):
                raise InputError(
                    f"second value: found {found} of id {id} at {m.t} s, where {known} was measured"
                )
