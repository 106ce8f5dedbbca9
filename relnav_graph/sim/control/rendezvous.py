"""Rendezvous by a linear-quadratic regulator with a bounded thrust."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from scipy.linalg import solve_continuous_are

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.state import Block
from relnav_graph.maths import so3
from relnav_graph.units import Quantity, check_fields

__all__ = ["Rendezvous"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Rendezvous:
    """Brings the chaser to a place beside the target and keeps it there.

    u = -K (x - x_goal) in axes o, RTN of the target, with K of the Clohessy-Wiltshire
    equations (1960) on the target's mean motion (Anderson and Moore 1990, section 2.3); a
    thrust above the bound is shortened to it. Yang et al. 2016, section 5.

    semi_major_axis: m, for the mean motion; goal: r_tc_o to reach, m; position_scale: m,
    velocity_scale: m/s and thrust_scale: N, errors and thrust of equal cost; mass: kg;
    max_thrust: N; start: s. All that it knows of the craft is the estimate.
    """

    kind: ClassVar[str] = "rendezvous"
    reads: ClassVar[tuple[str, ...]] = (
        *("relative_position", "relative_velocity"),
        *("chaser_position", "chaser_velocity"),
    )
    own: ClassVar[tuple[str, ...]] = ()
    controlled: ClassVar[tuple[Block, ...]] = ()

    semi_major_axis: Annotated[float, Quantity("m", positive=True)]
    goal: Annotated[Array, Quantity("m", (3,))]
    mass: Annotated[float, Quantity("kg", positive=True)]
    max_thrust: Annotated[float, Quantity("N", positive=True)]
    position_scale: Annotated[float, Quantity("m", positive=True)]
    velocity_scale: Annotated[float, Quantity("m/s", positive=True)]
    thrust_scale: Annotated[float, Quantity("N", positive=True)]
    start: Annotated[float, Quantity("s", nonnegative=True)] = 0.0

    def __post_init__(self) -> None:
        check_fields(self)

    @cached_property
    def gain(self) -> Array:
        """K (3, 6): acceleration, m/s^2, of position and velocity in o."""
        n = float(np.sqrt(MU_EARTH / self.semi_major_axis**3))
        A, B = np.zeros((6, 6)), np.vstack([np.zeros((3, 3)), np.eye(3)])
        A[:3, 3:] = np.eye(3)
        A[3, 0], A[5, 2] = 3 * n**2, -(n**2)
        A[3, 4], A[4, 3] = 2 * n, -2 * n
        scales = np.repeat([self.position_scale, self.velocity_scale], 3)
        R = (self.mass / self.thrust_scale) ** 2 * np.eye(3)
        P = solve_continuous_are(A, B, np.diag(1 / scales**2), R)
        return np.asarray(np.linalg.solve(R, B.T @ P))

    def command(self, t: float, estimate: Mapping[str, Array], own: Mapping[str, Array]) -> Array:
        """Thrust (3,), N, in i."""
        r_i, v_i = estimate["relative_position"], estimate["relative_velocity"]
        r_t, v_t = estimate["chaser_position"] - r_i, estimate["chaser_velocity"] - v_i
        h_i = so3.cross(r_t, v_t)
        x_i, z_i = r_t / np.sqrt(r_t @ r_t), h_i / np.sqrt(h_i @ h_i)
        R_io = np.array([x_i, so3.cross(z_i, x_i), z_i]).T
        w_oi_o = np.array([0.0, 0.0, np.sqrt(h_i @ h_i) / (r_t @ r_t)])
        r_o = R_io.T @ r_i
        v_o = R_io.T @ v_i - so3.cross(w_oi_o, r_o)
        thrust: Array = -self.mass * self.gain @ np.concatenate([r_o - self.goal, v_o])
        size = float(np.sqrt(thrust @ thrust))
        if size > self.max_thrust:
            thrust *= self.max_thrust / size
        return np.asarray(R_io @ thrust)

    def control_errors(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """None of its own: the pass is scored by what is estimated of it."""
        return {}
