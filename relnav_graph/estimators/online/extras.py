"""What a user has put into an engine's graph, when the driver saves it or goes back in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.packing import under
from relnav_graph.errors import InputError
from relnav_graph.estimators.online.engine import TakesExtra
from relnav_graph.estimators.online.state import State

__all__ = ["check_numbers", "extras_in", "saved_extras"]


def saved_extras(added: Sequence[tuple[float, Any]]) -> dict[str, Array]:
    """Extras, each with the time of the newest epoch then, s, as arrays of any shape (n,) by name.

    Raises InputError on a factor that cannot be saved.
    """
    out = {f"{i}.t": np.array(t) for i, (t, _) in enumerate(added)}
    for i, (_, extra) in enumerate(added):
        out |= {f"{i}.{name}": array for name, array in extra.save().items()}
    return out


def extras_in(engine: Any, saved: Mapping[str, Array]) -> list[tuple[float, Any]]:
    """What `saved_extras` made arrays (n,) of."""
    out = list[tuple[float, Any]]()
    while (own := under(saved, f"{len(out)}.")) and isinstance(engine, TakesExtra):
        out.append((float(own["t"]), engine.extra(own)))
    return out


def check_numbers(engine: Any, state: State, start: int, times: Sequence[float]) -> None:
    """Raise InputError when late data make an epoch before one that an extra names by number.

    start: of the first epoch that is taken in again, among the moments; times: of these, s.
    """
    known = {moment.epoch.t for moment in state.moments[start:]}
    for i, t in enumerate(times):
        if t not in known and state.moments[start].state.count + i <= engine.named(state.engine):
            raise InputError(
                f"late measurement at {t} s: it makes a new epoch before some that extra factors"
                " name by number, which would be others then"
            )
