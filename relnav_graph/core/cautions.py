"""Cautions: what leaves the status of an estimate as it is, and must be known all the same.

A pass has some (`Problem.cautions`), and each estimate may have its own (`Track.cautions`). All
are shown alike: in tables, in the JSON of a comparison (key `cautions`), in reports, and in the
lines of a stream.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import (
    CopiesBlocks,
    Dynamics,
    KnowsInertialOrbit,
    KnowsOrbit,
    Sensor,
)
from relnav_graph.core.epochs import unit_hint
from relnav_graph.core.measurement import LATEST
from relnav_graph.core.state import Layout
from relnav_graph.units import quantities

__all__ = [
    "Caution",
    "angle_cautions",
    "gap_cautions",
    "interval_cautions",
    "late_cautions",
    "orbit_cautions",
    "parameters_in",
    "untold_cautions",
]

#: Revolutions between the epoch of an orbit and the start of a pass from which on it is doubted
#: that both are of one clock.
FAR = 10.0
#: Median interval between epochs, s, from which on it is doubted that stamps are in seconds.
LONG = 500.0
#: And, at less than that, s, one to ask whether whole numbers of ms were taken for ns.
SHORT = 2e-5


@dataclass(frozen=True)
class Caution:
    """name: of what kind it is, in a word or two; text: what was found, and where."""

    name: str
    text: str

    def __str__(self) -> str:
        return f"{self.name}: {self.text}"


def orbit_cautions(models: Iterable[Any], t: float) -> tuple[Caution, ...]:
    """Of a pass that begins at time t, s, far from the epoch of an orbit that its models know.

    models: sensors, processes, a truth, in any order. One caution for each orbit.
    """
    models = list(models)
    orbits = [m.orbit for m in models if isinstance(m, KnowsOrbit)]
    orbits += [m.inertial_orbit for m in models if isinstance(m, KnowsInertialOrbit)]
    found = []
    for orbit in dict.fromkeys(orbit for orbit in orbits if orbit is not None):
        turns = orbit.revolutions(t)
        if abs(turns) > FAR:
            found.append(
                Caution(
                    "orbit epoch",
                    f"the pass begins at {t:.15g} s, {abs(turns):.4g} revolutions"
                    f" {'after' if turns > 0 else 'before'} {orbit.epoch:.15g} s, where the orbit's"
                    f" true anomaly is said to hold: are both of one clock? [orbit] epoch is that"
                    " time, [time] origin is taken off all stamps",
                )
            )
    return tuple(found)


def angle_cautions(
    layout: Layout, sigma: Array, sensors: Mapping[str, Sensor]
) -> tuple[Caution, ...]:
    """Of angles that are known to no more than half a turn, which says nothing of them: degrees may
    have been taken for radians.

    sigma: of the prior, (dim,), SI, in the order of the layout; sensors: by name, whose parameters
    are looked at.
    """
    copies = {n for s in sensors.values() if isinstance(s, CopiesBlocks) for n in s.copies}
    given = {
        f"prior.{block.name}.sigma": sigma[layout.tangent(block.name)]
        for block in layout
        if block.unit == "rad" and block.name not in copies  # of which nothing is known
    }
    for name, sensor in sensors.items():
        for key in parameters_in(sensor, "rad", "sigma"):
            if (value := getattr(sensor, key)) is not None:
                given[f"sensors.{name}.{key}"] = np.asarray(value)
    found = []
    for path, value in given.items():
        if (most := float(np.max(value))) > np.pi:
            text = (
                f"{path}: {most:.6g} rad is {np.rad2deg(most):.4g} deg, more than half a turn: are"
                f" degrees meant? write '{most:.6g} deg'"
            )
            found.append(Caution("angle", text))
    return tuple(found)


def parameters_in(model: Dynamics | Sensor, unit: str, ending: str) -> list[str]:
    """The parameters of a model that have a unit, and names that end so."""
    try:
        known = quantities(type(model))
    except Exception:  # of a stranger's class, whose annotations need not be types
        return []
    return [name for name, q in known.items() if q.unit == unit and name.endswith(ending)]


def interval_cautions(times: Array) -> tuple[Caution, ...]:
    """Of epochs at times (N,), s, so far apart, or so close, that their stamps may be in another
    unit than they were taken for."""
    typical = float(np.median(np.diff(times))) if len(times) > 1 else LONG / 2
    if SHORT <= typical < LONG:
        return ()
    near = ": are they whole numbers of ms or us, taken for ns?"
    hint = unit_hint(typical) if typical >= LONG else near
    text = f"the epochs are {typical:.6g} s apart (median){hint}"
    return (Caution("intervals", text),)


def late_cautions(t: float) -> tuple[Caution, ...]:
    """Of a pass that begins at a time t, s, that a float64 does not hold to a nanosecond."""
    if abs(t) <= LATEST:
        return ()
    text = (
        f"the pass begins at t = {t:.12g} s, where float64 has steps of {np.spacing(abs(t)):.2g} s:"
        " stamps in whole nanoseconds lose nothing (arrays, datetime64), nor do those from which"
        " an origin was taken ([time] origin of files and streams)"
    )
    return (Caution("late stamps", text),)


def untold_cautions(
    statics: Iterable[str],
    processes: Iterable[Dynamics],
    measured: Iterable[Sensor],
) -> tuple[Caution, ...]:
    """Of static blocks, by name, of which no measurement tells: they end with their priors.

    measured: the sensors that have measured anything. They tell of what they read, and, through a
    process that advances any of that, of what it reads.
    """
    told, linked = {b.name for s in measured for b in s.reads}, list(processes)
    while more := [p for p in linked if told & {b.name for b in p.advances}]:
        linked = [p for p in linked if p not in more]
        told |= {b.name for p in more for b in (*p.advances, *p.reads)}
    untold = [name for name in statics if name not in told]
    if not untold:
        return ()
    text = f"nothing was measured that tells of {', '.join(untold)}: it ends with its prior"
    return (Caution("never seen", text),)


def gap_cautions(bridged: Mapping[str, Sequence[tuple[float, float]]]) -> tuple[Caution, ...]:
    """Of inputs with gaps that were bridged: by input, time of each epoch whose interval has a
    part of one, s, and the length of that part, s."""
    found = []
    for name, parts in bridged.items():
        times = ", ".join(f"{t:.12g}" for t, _ in parts[:10]) + (", ..." if len(parts) > 10 else "")
        found.append(
            Caution(
                "input gap",
                f"input {name!r} has no samples for {sum(length for _, length in parts):.6g} s of"
                f" the intervals that lead to {len(parts)} epochs, t = {times} s: its last mean was"
                f" held, and spreads ([gaps] {name})",
            )
        )
    return tuple(found)
