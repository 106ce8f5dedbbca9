"""The true map of a target whose points are unknown to the estimators: listed, or generated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import POINT
from relnav_graph.core.contracts import Mappable, Sensor
from relnav_graph.core.numbered import families, numbered_of
from relnav_graph.errors import InputError
from relnav_graph.scenario.schema import Problems, from_pydantic
from relnav_graph.sim.sensors import stream
from relnav_graph.units import Quantity

__all__ = ["TrueMap", "true_map"]

_STRICT = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


@dataclass(frozen=True, eq=False)
class TrueMap:
    """Points (n, 3) in t, m, by id, and their outward normals (n, 3), None for points that are seen
    from all sides."""

    points: Array
    normals: Array | None = None

    @property
    def values(self) -> dict[str, Array]:
        """By the name of its block, where each point is: (3,), m, in t."""
        return {POINT.numbered(i).name: point for i, point in enumerate(self.points)}

    def given_to(self, sensors: Mapping[str, Sensor]) -> dict[str, Sensor]:
        """Sensors by name, as they are simulated: those of unknown points know them."""
        return {
            name: s.mapped(self.points, self.normals)
            if isinstance(s, Mappable) and numbered_of(s) == POINT
            else s
            for name, s in sensors.items()
        }


class _Generated(BaseModel):
    """Points drawn uniformly on the surface of a cuboid, its middle the origin of t."""

    model_config = _STRICT

    count: int = Field(ge=1, le=100_000)
    box: Annotated[Any, Quantity("m", (3,), positive=True)]
    seed: int = Field(default=0, ge=0)

    def made(self) -> TrueMap:
        """The map: each point with the outward normal of its face."""
        rng, box = stream(self.seed, 0, "map"), np.asarray(self.box)
        areas = box.prod() / box
        axis = rng.choice(3, self.count, p=areas / areas.sum())
        normals = np.zeros((self.count, 3))
        normals[np.arange(self.count), axis] = rng.choice([-1.0, 1.0], self.count)
        inside = rng.uniform(-0.5, 0.5, (self.count, 3))
        return TrueMap(box * np.where(normals == 0, inside, 0.5 * normals), normals)


class _Listed(BaseModel):
    """Points one by one."""

    model_config = _STRICT

    points: Annotated[Any, Quantity("m", (None, 3))]
    normals: Annotated[Any, Quantity("1", (None, 3))] | None = None

    def made(self) -> TrueMap:
        """The map. Raises InputError on normals that are not one direction for each point."""
        if self.normals is not None and len(self.normals) != len(self.points):
            found = f"found {len(self.normals)} normals for {len(self.points)} points"
            raise InputError(f"{found}, expected one for each")
        for k, normal in enumerate(() if self.normals is None else self.normals):
            if not np.linalg.norm(normal) > 0:
                raise InputError(f"found normals[{k}] of length zero, expected a direction")
        return TrueMap(self.points, self.normals)


def _brought(sensors: Mapping[str, Sensor], settings: Any) -> Iterator[tuple[str, Any]]:
    """The points that data bring for sensors whose points the scenario says are unknown."""
    tables = settings.get("sensors") if isinstance(settings, Mapping) else None
    for name, table in tables.items() if isinstance(tables, Mapping) else ():
        known = isinstance(table, Mapping) and not isinstance(table.get("points", ""), str)
        if known and name in sensors and numbered_of(sensors[name]) == POINT:
            yield name, table["points"]


def true_map(
    table: Any,
    sensors: Mapping[str, Sensor],
    settings: Any,
    simulated: bool,
    problems: Problems,
) -> TrueMap | None:
    """The map of the [truth.map] of a file, else of the settings that recorded data bring; None
    where there is none. `problems` collects what is wrong.

    simulated: whether it is needed wherever sensors see unknown points.
    """
    unknown = families(sensors)
    if table is None:
        found = list(_brought(sensors, settings))
        if not found:
            if POINT.name in unknown and simulated:
                names = ", ".join(n for n, s in sensors.items() if numbered_of(s) == POINT)
                message = f"missing: a simulated pass needs the points that {names} would see"
                problems.append(("truth.map", message))
            return None
        (name, points), *others = found
        if any(other != points for _, other in others):
            message = f"the data bring other points for {others[0][0]} than for {name}"
            problems.append(("truth.map", f"{message}; give those of the map"))
        table = {"points": points}
    elif POINT.name not in unknown:
        message = "no sensor sees points of an unknown map (points = 'unknown')"
        problems.append(("truth.map", message))
        return None
    try:
        if isinstance(table, Mapping) and "points" not in table:
            return _Generated.model_validate(table).made()
        if isinstance(table, Mapping) and (both := set(table) & set(_Generated.model_fields)):
            more = f"found points and {', '.join(sorted(both))}"
            raise InputError(f"{more}, expected a map that is listed, or one that is generated")
        return _Listed.model_validate(table).made()
    except ValidationError as error:
        problems += from_pydantic("truth.map", error)
    except InputError as error:
        problems.append(("truth.map", str(error)))
    return None
