"""The first numbers of each sensor and input of a stream, held against what they should be."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.estimators.online.driver import Online
from relnav_graph.scenario.unit_check import wrong_input, wrong_unit

__all__ = ["check_inputs", "misfits"]

#: Stands among the known units, as no name can, when an input was found in a wrong one.
WRONG = "!"


def check_inputs(
    online: Online,
    known: set[str],
    measurements: tuple[Measurement, ...],
    t: float,
    inputs: Mapping[str, Array],
) -> None:
    """Raise InputError when measurements at t, s, fit with an input in another unit only.

    known: inputs whose unit is right already. All are added unless something is wrong with them;
    once it was, which `WRONG` in it says, only when measurements fit. inputs: u (rows,
    1 + channels) by process, SI, from the newest epoch to t.
    """
    problem = online.problem
    names = {n for p in problem.processes.values() for n in p.inputs}
    if not measurements or not inputs or names <= known:
        return
    reason = wrong_input(problem, measurements, inputs, partial(online.predict, t))
    if reason or (reason is None and WRONG in known):
        known.add(WRONG)
        raise InputError(
            f"unit: {reason or 'an input was in another unit before, and fits in none'}"
        )
    known |= names


def misfits(
    online: Online,
    known: set[str],
    measurements: tuple[Measurement, ...],
    t: float,
    inputs: Mapping[str, Array],
) -> list[tuple[Measurement, str]]:
    """Measurements at t, s, that fit in another unit only, and in which.

    known: sensors whose unit is right already; those that are found right are added. inputs: as
    in `check_inputs`.
    """
    problem, found = online.problem, []
    unknown = {m.sensor for m in measurements} - known
    if not unknown:
        return []
    prior = problem.prior
    x, P = (prior.x, prior.P) if online.t is None else online.predict(t, inputs)
    for m in measurements:
        if m.sensor in unknown:
            reason = wrong_unit(problem.sensors[m.sensor], m, problem.layout, x, P)
            if reason is None:
                known.add(m.sensor)
            else:
                found.append((m, f"unit: {reason}"))
    return found
