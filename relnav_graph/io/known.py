"""What a reader may know of the scenario that it reads for."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field

from relnav_graph.core.contracts import Sensor
from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.core.state import Block
from relnav_graph.core.track import Recording

__all__ = ["Known"]


@dataclass(frozen=True)
class Known:
    """Of a scenario; as by default where a reader is called without one.

    sensors: by name, as far as they can be made before the data are read; inputs: columns of each
    that the processes need, by name; blocks: of the state, by name; statics: which of them have one
    value for the pass; orbital: whether o turns with the target's orbit (the scenario has an
    [orbit]), else it is i; merge: s, how close to an epoch is of it; origin: s, what stamps without
    an absolute time say at t = 0; late: sensors whose stamps lag; target: a recording whose truth
    has target_position, m, and target_velocity, m/s, in i: the target's orbit.
    """

    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    inputs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    blocks: Mapping[str, Block] = field(default_factory=dict)
    statics: Container[str] = ()
    orbital: bool = False
    merge: float = SAME_TIME
    origin: float = 0.0
    late: Container[str] = ()
    target: Recording | None = None
