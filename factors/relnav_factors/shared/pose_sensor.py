"""What the sensors share that measure a whole pose: a place and an attitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_factors.shared.attitude import unit_quaternions
from relnav_factors.shared.mounting import PlacedSensor
from relnav_factors.shared.points import Pose
from relnav_graph.arrays import Array
from relnav_graph.core.measurement import QUATERNION, Measurement
from relnav_graph.units import Quantity


@dataclass(frozen=True, kw_only=True)
class PoseSensor(PlacedSensor):
    """A place (m) and q_wxyz. position_sigma: m, attitude_sigma: rad, per axis, one for all or one
    each; pose: how the pose stands in the state."""

    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m", *QUATERNION)
    rows: ClassVar[int] = 6
    residual_columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m", "x_rad", "y_rad", "z_rad")

    position_sigma: Annotated[Array, Quantity("m", (3,), positive=True, fill=True)]
    attitude_sigma: Annotated[Array, Quantity("rad", (3,), positive=True, fill=True)]
    pose: Pose = "orbital"

    def accept(self, z: Array) -> Array:
        """The place (m) and unit quaternions, (k, 7).

        Raises InputError when the length of a quaternion is not 1 within 1e-3.
        """
        z = super().accept(z)
        return np.hstack([z[:, :3], unit_quaternions(self.kind, z[:, 3:])])

    def noise(self, m: Measurement) -> Array:
        sigma = np.concatenate([self.position_sigma, self.attitude_sigma])
        return np.tile(np.diag(sigma**2), (len(m.z), 1, 1))
