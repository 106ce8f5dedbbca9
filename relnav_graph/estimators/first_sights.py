"""Where numbered blocks, such as the points of a map, are linearised when they are first seen.

Their prior is wide, and says nothing of where they are: a filter that linearised a sight there
would be lost. So it linearises where the sight itself puts the block. That is only where the first
step begins: prior and measurement tell what is known, as of any other block.
"""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.catalogue import CHASER_ATTITUDE, RELATIVE_ATTITUDE, TARGET_ATTITUDE
from relnav_graph.core.contracts import ReadsNumbered
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.state import Layout
from relnav_graph.errors import GeometryError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.tables import EPOCH, NUMBERED, OWN_COLUMN, Z_DATA

__all__ = [
    "QUARTER",
    "few_sides",
    "first_epochs",
    "first_sights",
    "has_map",
    "measured",
    "names_of",
    "sights_in",
    "turned",
    "turned_between",
    "unseen",
]

#: Correlation with the states that move below which a block was never seen: it is zero, but for
#: rounding.
TIED = 1e-9
#: By how much an unknown target must have turned before its map is one, rad.
QUARTER = np.pi / 2


def sights_in(assembly: Assembly) -> Indices:
    """The observations that read a numbered block."""
    found: Indices = np.flatnonzero(assembly.tables.sensors[assembly.sensor_of, NUMBERED])
    return found


def first_epochs(assembly: Assembly) -> set[int]:
    """The epochs of an assembly in which a numbered block is first seen."""
    if not assembly.tables.sensors[:, NUMBERED].any():  # asked for at each step online
        return set()
    observations = assembly.tables.observations[sights_in(assembly)]
    _, first = np.unique(observations[:, OWN_COLUMN], return_index=True)
    return set(observations[first, EPOCH].tolist())


def unseen(assembly: Assembly, P: Array) -> Indices:
    """The observations of numbered blocks that were never seen before, by the covariance P (dim,
    dim) of the estimate: they are correlated with nothing that moves."""
    moving, seen = assembly.layout.moving.dim, sights_in(assembly)
    columns = assembly.tables.observations[seen, OWN_COLUMN]
    scale = np.sqrt(np.outer(np.diag(P)[columns], np.diag(P)[:moving]))
    new: Indices = seen[(np.abs(P[columns, :moving]) <= TIED * scale).all(axis=1)]
    return new


def names_of(assembly: Assembly, chosen: Indices) -> list[str]:
    """Names of the numbered blocks that some observations read."""
    read = {name: numbered_of(sensor) for name, sensor in assembly.sensors.items()}
    blocks = [read[assembly.sensor_names[assembly.sensor_of[i]]] for i in chosen]
    pairs = zip(blocks, assembly.ids[chosen], strict=True)
    return [block.numbered(int(i)).name for block, i in pairs if block is not None]


def has_map(layout: Layout) -> bool:
    """Whether numbered blocks are among the static ones of a layout."""
    return any(block.number is not None for block in layout.statics)


def turned(layout: Layout, x: Array) -> Array:
    """By how much the target has turned, seen from the chaser, since the first of the states x (N,
    size): (N,), rad, all turns added up. Infinite where the state does not tell."""
    if RELATIVE_ATTITUDE.name in layout:
        R_tc = layout.value(x, RELATIVE_ATTITUDE.name)
    elif CHASER_ATTITUDE.name in layout and TARGET_ATTITUDE.name in layout:
        R_oc = layout.value(x, CHASER_ATTITUDE.name)
        R_tc = layout.value(x, TARGET_ATTITUDE.name).transpose(0, 2, 1) @ R_oc
    else:
        return np.full(len(x), np.inf)
    steps = np.linalg.norm(RELATIVE_ATTITUDE.local(R_tc[:-1], R_tc[1:]), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def turned_between(layout: Layout, before: Array, after: Array) -> float:
    """By how much the target has turned from one state (size,) to another, rad; see `turned`."""
    return float(turned(layout, np.stack([before, after]))[1])


def few_sides(by: float) -> str:
    """Why a map is not to be trusted yet, by how much the target has turned, rad; or ""."""
    return "" if by >= QUARTER else f"the target has turned by {np.rad2deg(by):.0f} of 90 deg"


def measured(assembly: Assembly, own: Indices) -> Array:
    """What some observations of one sensor measured, z (k, nz)."""
    spans = assembly.tables.observations[own, Z_DATA : Z_DATA + 2]
    return np.array([assembly.tables.numbers[begin:end] for begin, end in spans])


def first_sights(assembly: Assembly, x: Array, P: Array) -> Array:
    """The step (dim,) from the state predicted to the only epoch of an assembly to one with the
    numbered blocks that are seen there, and were not seen before, where they are seen.

    x (size,), P (dim, dim): the estimate before the epoch.
    """
    layout, tables, step = assembly.layout, assembly.tables, np.zeros(assembly.layout.dim)
    new = unseen(assembly, P)
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
        values = (layout.value(x, b.name) for b in sensor.reads)
        origins, lines = sensor.sights(assembly.ids[own], measured(assembly, own), *values)
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
