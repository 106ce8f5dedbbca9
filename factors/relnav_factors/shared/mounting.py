"""Sensors that are mounted on the chaser with an attitude of their own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.models import SensorModel
from relnav_graph.core.state import check_rotation
from relnav_graph.units import Quantity


@dataclass(frozen=True, kw_only=True)
class MountedSensor(SensorModel):
    """What the sensors share whose axes s are not those of c.

    sensor_attitude: R_cs. Raises InputError when it is not a rotation within 1e-6.
    """

    sensor_attitude: Annotated[Array, Quantity("1", (3, 3))] = field(
        default_factory=lambda: np.eye(3)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_rotation(f"{self.kind}.sensor_attitude", self.sensor_attitude)

    def constants(self) -> Array:
        return self.sensor_attitude.ravel()
