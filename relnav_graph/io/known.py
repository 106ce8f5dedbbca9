"""What a reader may know of the scenario that it reads for."""

from __future__ import annotations

import difflib
import logging
from collections.abc import Container, Mapping
from dataclasses import dataclass, field

from relnav_graph.core.contracts import Sensor
from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError

__all__ = ["Known"]

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Known:
    """Of a scenario; as by default where a reader is called without one.

    sensors: by name, as far as they can be made before the data are read; inputs: columns of each
    that the processes need, by name; blocks: of the state, by name; statics: which of them have one
    value for the pass; orbital: whether o turns with the target's orbit (the scenario has an
    [orbit]), else it is i; merge: s, how close to an epoch is of it; origin: s, what stamps without
    an absolute time say at t = 0; late: sensors whose stamps lag; target: a recording whose truth
    has target_position, m, and target_velocity, m/s, in i: the target's orbit; complete: whether
    sensors and inputs are all that there will be, and none waits for what other data bring.
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
    complete: bool = True

    def columns_of(self, where: str, name: str, hint: str = "") -> tuple[str, ...]:
        """What a sensor measures. Raises InputError on a name that no sensor has; hint: what else
        one may say."""
        sensor = self.sensors.get(name)
        if sensor is None:
            there = ", ".join(self.sensors) or "none"
            raise InputError(f"{where}: found {name!r}, expected a sensor, one of {there}{hint}")
        return tuple(sensor.columns)

    def check_sensor(self, where: str, name: str) -> None:
        """Raise InputError on a sensor that the scenario does not have, where there is one."""
        if self.blocks and self.complete:
            self.columns_of(where, name)

    def check_input(self, where: str, name: str) -> None:
        """Raise InputError on an input that no process of the scenario takes."""
        if self.blocks and self.complete and name not in self.inputs:
            there = ", ".join(self.inputs) or "none"
            raise InputError(f"{where}: found {name!r}, expected an input, one of {there}")

    def check_truth(self, where: str, name: str) -> None:
        """Say that the scenario has no block, nor what derives from its blocks, of a name that
        somebody gave."""
        blocks = self.blocks
        there = [*blocks, *(q.block.name for q in derived_quantities(Layout(blocks.values())))]
        if blocks and name not in there:
            close = difflib.get_close_matches(name, there, 1)
            hint = f" (is {close[0]!r} meant?)" if close else ""
            _LOG.warning(f"{where}: the scenario has no {name!r}{hint}: it scores nothing")
