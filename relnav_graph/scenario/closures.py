"""Tables of sensors that close loops: one sensor for each of their keyframes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from relnav_graph.core import models
from relnav_graph.core.contracts import CopiesBlocks, Sensor
from relnav_graph.core.copies import closure_name
from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.core.state import Layout
from relnav_graph.errors import InputError, ModelError
from relnav_graph.registry import find_class
from relnav_graph.scenario.schema import Problems
from relnav_graph.scenario.settings import BlockPrior
from relnav_graph.units import Quantity, parse_quantity

__all__ = ["at_keyframes", "copy_priors"]

#: Prior sigmas of copies: so wide that nothing is felt of them, of an attitude, rad, and of other
#: blocks, SI.
_ATTITUDE, _OTHER = 100.0, 1e5


def _expanded(value: Any, time: Any) -> list[float]:
    """Keyframes, s: those listed, or every period of a pass of [time] step and epochs.

    Raises InputError on anything else.
    """
    if isinstance(value, list):
        found = [float(t) for t in Quantity("s", (None,)).parse(value)]
    else:
        period = Quantity("s", positive=True).parse(value)
        known = time if isinstance(time, Mapping) else {}
        if not isinstance(known.get("epochs"), int) or "step" not in known:
            raise InputError(
                f"found the period {value!r}, which needs the [time] step and epochs of the pass;"
                " expected a list of times"
            )
        step = parse_quantity(known["step"], "s")
        if period < step * (1 - 1e-9) or abs(period / step - round(period / step)) > 1e-6:
            raise InputError(
                f"found the period {period:.15g} s, expected a multiple of the [time] step,"
                f" {step:.15g} s: keyframes are epochs"
            )
        last = step * (known["epochs"] - 1)
        found = (period * np.arange(int(last / period + 1e-9) + 1)).tolist()
    if not found or len(set(found)) < len(found):
        raise InputError(f"found {value!r}, expected one time or more, each once")
    if (near := np.diff(np.sort(found)) <= SAME_TIME).any():
        first = np.sort(found)[:-1][near][0]
        raise InputError(f"found two keyframes at {first:.15g} s, {SAME_TIME} s apart or less")
    return found


def _check_in_pass(times: list[float], time: Any) -> None:
    """Raise InputError on a keyframe, s, that is no epoch of a pass of [time] step and epochs."""
    known = time if isinstance(time, Mapping) else {}
    if not isinstance(known.get("epochs"), int) or "step" not in known:
        return
    step, last = parse_quantity(known["step"], "s"), known["epochs"] - 1
    for t in times:
        k = min(max(round(t / step), 0), last) if step > 0 else 0
        if abs(t - k * step) > SAME_TIME:
            raise InputError(
                f"found a keyframe at {t:.15g} s, expected the time of an epoch, from 0 s to"
                f" {last * step:.15g} s in steps of {step:.15g} s; the nearest is at"
                f" {k * step:.15g} s"
            )


def at_keyframes(
    name: str, table: Mapping[str, Any], time: Any, problems: Problems, simulated: bool
) -> dict[str, dict[str, Any]]:
    """The tables, by name, of the sensors that one table stands for: one for each of its
    `keyframes`, where it has them and its model a `keyframe`; else the table as it is.

    time: the [time] of the scenario; `problems` collects what is wrong; simulated: whether [time]
    says what the epochs are, as nothing is recorded.
    """
    own = dict(table)
    try:
        cls = find_class(models.ENTRY_POINTS, str(own.get("kind")))
    except ModelError:
        return {name: own}  # reported elsewhere
    fields = dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ()
    if "keyframes" not in own or "keyframe" not in {f.name for f in fields}:
        return {name: own}
    if "keyframe" in own:
        problems.append(
            (f"sensors.{name}.keyframe", "found beside keyframes, expected one of them")
        )
        return {}
    try:
        times = _expanded(own.pop("keyframes"), time)
        if simulated:
            _check_in_pass(times, time)
    except InputError as error:
        problems.append((f"sensors.{name}.keyframes", str(error)))
        return {}
    return {closure_name(name, t): {**own, "keyframe": t} for t in times}


def copy_priors(sensors: Mapping[str, Sensor], layout: Layout) -> dict[str, BlockPrior]:
    """Priors of the copies that sensors make, which nobody need write: as good as none."""
    names = [n for s in sensors.values() if isinstance(s, CopiesBlocks) for n in s.copies]
    out = {}
    for name in names:
        block = layout.block(name)
        sigma = _ATTITUDE if block.manifold == "SO3" else _OTHER
        out[name] = BlockPrior(sigma=sigma, mean=[0.0] * block.dim)
    return out
