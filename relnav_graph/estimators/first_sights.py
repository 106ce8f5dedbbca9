"""Where numbered blocks, such as the points of a map, are linearised when they are first seen.

Their prior is wide, and says nothing of where they are: a filter that linearised a sight there
would be lost. So it linearises where the sight itself puts the block. That is only where the first
step begins: prior and measurement tell what is known, as of any other block.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.contracts import ReadsNumbered
from relnav_graph.core.numbered import numbered_of
from relnav_graph.errors import GeometryError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.tables import EPOCH, NUMBERED, OWN_COLUMN, Z_DATA

__all__ = ["first_epochs", "first_sights"]


def _numbered(assembly: Assembly) -> Indices:
    """The observations that read a numbered block."""
    found: Indices = np.flatnonzero(assembly.tables.sensors[assembly.sensor_of, NUMBERED])
    return found


def first_epochs(assembly: Assembly) -> set[int]:
    """The epochs of an assembly in which a numbered block is first seen."""
    observations = assembly.tables.observations[_numbered(assembly)]
    _, first = np.unique(observations[:, OWN_COLUMN], return_index=True)
    return set(observations[first, EPOCH].tolist())


def first_sights(assembly: Assembly, x: Array, P: Array) -> Array:
    """The step (dim,) from the state predicted to the only epoch of an assembly to one with the
    numbered blocks that are seen there, and were not seen before, where they are seen.

    x (size,), P (dim, dim): the estimate before the epoch. A block that was never seen is
    correlated with nothing.
    """
    layout, tables = assembly.layout, assembly.tables
    step, moving = np.zeros(layout.dim), layout.moving.dim
    seen = _numbered(assembly)
    columns = tables.observations[seen, OWN_COLUMN]
    new = seen[[not P[column, :moving].any() for column in columns]]
    if not len(new):
        return step
    try:
        if len(tables.starts):
            x = assembly.transition(x[None])[0][0]
    except GeometryError:  # the filter will say so
        return step
    places: dict[int, Array] = {}
    for name, sensor in assembly.sensors.items():
        which = assembly.sensor_names.index(name)
        block, own = numbered_of(sensor), new[assembly.sensor_of[new] == which]
        if block is None or not isinstance(sensor, ReadsNumbered) or not len(own):
            continue
        z = np.array(
            [tables.numbers[slice(*tables.observations[i, Z_DATA : Z_DATA + 2])] for i in own]
        )
        values = (layout.value(x, b.name) for b in sensor.reads)
        origins, lines = sensor.sights(assembly.ids[own], z, *values)
        found = origins + lines
        if not sensor.sees_depth:  # as near to the centre of mass as the line gets
            found = origins - lines * (origins * lines).sum(axis=1, keepdims=True)
        for i, place in zip(own, found, strict=True):
            if np.isfinite(place).all():
                places.setdefault(int(tables.observations[i, OWN_COLUMN]), place)
    for column, place in places.items():
        stored = column - layout.dim + layout.size  # numbered blocks come last, and are vectors
        step[column : column + len(place)] = place - x[stored : stored + len(place)]
    return step
