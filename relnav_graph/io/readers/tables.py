"""Reader of tables as in a data set (`relnav_graph.io.dataset`), as a part of recorded data.

Of the sensors, inputs and true blocks of the scenario those are read that have a table in the
folder; the others are of other parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.clocks import Clock
from relnav_graph.io.dataset import read_dataset
from relnav_graph.io.known import Known
from relnav_graph.maths.instants import Instant

__all__ = ["read"]


def read(
    folder: Path,
    known: Known,
    only: Sequence[str] = (),
    epoch: str = "",
    clock: str = "none",
    sort: bool = False,
) -> Recording:
    """The tables of a folder.

    only: names of the sensors and inputs to read, by default all that are there; epoch: the
    absolute time of a stamp of 0, as "2021-07-17T00:00:00 UTC"; or clock: that of the stamps, see
    `relnav_graph.io.clocks.Clock`; sort: put rows in order of time. Without these, and without a
    dataset.toml that says it, stamps are of the clock of the pass. Where truth stands alone,
    without measurements and epochs, its times are the epochs.

    Raises InputError on tables that are damaged, when none is there, on a name that is not of the
    scenario, and on Unix stamps across a leap second, which they do not tell.
    """
    names = {*known.sensors, *known.inputs}
    unknown = [n for n in only if n not in names]
    if unknown:
        raise InputError(f"only: found {unknown[0]!r}, expected some of {', '.join(sorted(names))}")
    if epoch and clock != "none":
        raise InputError(f"found epoch {epoch!r} and clock {clock!r}, expected one of them")
    absolute = Clock(clock) if clock != "none" else None
    chosen = set(only) or names

    def taken(origin: float) -> Recording:
        return read_dataset(
            folder,
            {n: s for n, s in known.sensors.items() if n in chosen},
            {n: columns for n, columns in known.inputs.items() if n in chosen},
            known.blocks if not only else {},
            known.merge,
            known.statics,
            origin,
            known.late,
            sort,
            partial=True,
        )

    origin = known.origin
    found = taken(origin)
    if not (found.measurements or found.inputs or found.truth):
        raise InputError(f"{folder}: found no table of {', '.join(sorted(chosen))}")
    if (epoch or absolute) and not origin:  # whole seconds, so that no digit of late stamps is lost
        origin = float(np.floor(min(_ends(found))))
        found = taken(origin)
    truth = found.truth
    if not len(found.times) and truth and any(n not in known.statics for n in truth.values):
        found = replace(found, times=truth.t)  # sensors are simulated there, if at all
    zero = found.epoch
    if epoch:
        zero = Instant.parse(epoch).after(origin)
    elif absolute:
        zero = _begin(folder, absolute, origin, _ends(found))
    elif zero is not None:
        zero = zero.after(origin)
    time = {"origin": 0.0} if zero is None else {"epoch": str(zero)}
    return replace(found, settings={**found.settings, "time": time})


def _ends(found: Recording) -> list[float]:
    """The earliest and the latest times of all that is there, s."""
    times = [*found.times[[0, -1]].tolist()] if len(found.times) else []
    for series in found.inputs.values():
        times += [float(series.t_start[0]), float(series.t_end[-1])]
    if found.truth is not None:
        times += found.truth.t[[0, -1]].tolist()
    return [min(times), max(times)]


def _begin(folder: Path, clock: Clock, origin: float, ends: Sequence[float]) -> Instant:
    """When t = 0 is. origin: the stamp of it, s; ends: the first and the last time, s."""
    first, last = (Decimal(origin) + Decimal(t) for t in ends)
    clock.begin(str(folder), first)
    if clock.seconds([last], first)[0] != float(last - first):
        raise InputError(
            f"{folder}: found Unix stamps across a leap second, which they do not tell; expected"
            " another clock"
        )
    return Instant.parse(clock.settings(Decimal(origin))["time"]["epoch"])
