"""Attitude propagated by a gyro, jointly with the random walk of the gyro's bias."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Literal, Self

import numpy as np

from relnav_factors.shared.gauss_markov import Part, walk_and_integral
from relnav_factors.shared.planar_orbit import in_state, orbit_blocks, put_turned
from relnav_factors.shared.statuses import ORBIT_FAILURES, finite
from relnav_factors.shared.strapdown import GYRO_COLUMNS, LARGEST_TURN, condense
from relnav_factors.shared.white_noise import carry, put_advanced
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE, GYRO_BIAS, GYRO_DRIFT, RELATIVE_ATTITUDE
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.maths.orbit import KeplerOrbit, orbit_array
from relnav_graph.units import Quantity

#: Where the numbers of the kernel stand in p, after the orbit (5,).
_ANGLE, _WALK, _TIME_CONSTANT = 5, 8, 11


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``R_next = R_o1o0 R_oc Exp((gyro - b) dt) ...``, a factor per row; ``b' = -b / T + white``.

    p (12,): orbit (5,), density of the angle's random walk (3,), rad/sqrt(s), of the bias's (3,),
    rad/s^1.5, T (s; inf: the bias is a random walk). u (rows, 4): dt (s), mean of the gyro
    (rad/s, in c). x, x_next (12,): R_oc (or R_tc) row by row, b (rad/s, in c). F, Q (6, 6), in rad
    and rad/s. Of a constant bias: x_next (9,), F (3, 6), Q (3, 3). Of one that drifts: b is the
    drift, x (15,) ends with the constant, which the gyro has besides, and F is (6, 9). An orbit in
    the state stands last in x and F, (4,). Status: see `GyroBias.failures`.

    Noises of attitude and bias are correlated: the bias walks while the attitude turns. R_o1o0 is
    the turn of the orbital frame, see `relnav_factors.shared.planar_orbit.put_turned`.
    """
    R_oc, b = dense.matrix_at(x, 0), dense.vector_at(x, 9)
    n = x.shape[0] - 6 - in_state(p)  # R_oc counts three
    constant = dense.vector_at(x, 12) if n > 6 else np.zeros(3)
    total, noise, step = dense.identity(n), np.zeros((n, n)), dense.identity(n)
    turn = np.empty(3)
    for row in range(u.shape[0]):
        dt = u[row, 0]
        kept, counts, own, of_integral = walk_and_integral(dt, p[_TIME_CONSTANT])
        joint = counts * counts / 2
        for i in range(3):
            turn[i] = u[row, 1 + i] * dt - b[i] * counts - constant[i] * dt
        ahead = so3.exp(turn)
        dense.put_block(R_oc, 0, 0, dense.matmul(R_oc, ahead), 1.0)
        for i in range(3):
            for j in range(3):
                step[i, j] = ahead[j, i]
            step[3 + i, 3 + i] = kept
            b[i] *= kept
        bent = so3.right_jacobian(turn)
        dense.put_block(step, 0, 3, bent, -counts)
        if n > 6:
            dense.put_block(step, 0, 6, bent, -dt)
        carry(step, total, noise)
        for i in range(3):
            v, w = p[_ANGLE + i], p[_WALK + i]
            noise[i, i] += v * v * dt + w * w * of_integral
            noise[i, 3 + i] -= w * w * joint
            noise[3 + i, i] -= w * w * joint
            noise[3 + i, 3 + i] += w * w * own
    if not finite(R_oc):
        return 2
    status = put_turned(p, t, u, x, R_oc, x_next, F)
    if status != 0:
        return status
    for i in range(9, x_next.shape[0]):
        x_next[i] = b[i - 9]
    put_advanced(total, noise, F, Q)
    return 0


@dataclass(frozen=True, kw_only=True)
class GyroBias(DynamicsModel):
    """Chaser attitude and gyro bias, driven by a rate-integrating gyro.

    R_oc' = R_oc [w_ci_c x] - [w_oi_o x] R_oc, w_ci_c = gyro - b - white, b' = white.
    Source: Farrenkopf 1978; Crassidis and Junkins 2011, section 7.2; exact for a rate
    that is constant over each gyro sample.

    angle_random_walk_density: rad/sqrt(s), bias_random_walk_density: rad/s^1.5, one for
    all axes of c or one each; 0, the default of the latter: the bias is constant, a static block.
    bias_time_constant: T, s, of a bias with b' = -b / T + white; orbit: the target's, None where o
    does not rotate. part: "bias", or "drift": density and time constant are of what drifts about a
    constant bias, a static block of its own. attitude: which block turns with the chaser: R_oc, or
    R_tc of a target at rest in o. samples: "together" for a fast gyro: those of an interval as one
    or a few rows.

    Raises InputError where the bias of some axes only walks, or one that decays does not.
    """

    kind: ClassVar[str] = "gyro_bias"
    inputs: ClassVar[Mapping[str, tuple[str, ...]]] = {"gyro": GYRO_COLUMNS}
    kernel = staticmethod(kernel)
    failures = {**ORBIT_FAILURES, 2: "a turn of the gyro is beyond what floats hold"}

    angle_random_walk_density: Annotated[
        Array, Quantity("rad/sqrt(s)", (3,), positive=True, fill=True)
    ]
    bias_random_walk_density: Annotated[
        Array, Quantity("rad/s^1.5", (3,), nonnegative=True, fill=True)
    ] = field(default_factory=lambda: np.zeros(3))
    orbit: KeplerOrbit | None = None
    attitude: Literal["chaser_attitude", "relative_attitude"] = "chaser_attitude"
    bias_time_constant: Annotated[float | None, Quantity("s", positive=True)] = None
    samples: Literal["each", "together"] = "each"
    part: Part = "bias"

    def __post_init__(self) -> None:
        super().__post_init__()
        walks = self.bias_random_walk_density > 0
        if walks.any() != walks.all():
            raise InputError(
                f"{self.kind}.bias_random_walk_density: found {self.bias_random_walk_density},"
                " expected a positive value for each axis, or 0 for all: a constant bias"
            )
        if self.bias_time_constant is not None and not walks.any():
            raise InputError(
                f"{self.kind}.bias_time_constant: found {self.bias_time_constant} s of a constant"
                " bias, expected it with a positive bias_random_walk_density"
            )
        if self.part == "drift" and not walks.any():
            raise InputError(
                f"{self.kind}.part: found a drift without a bias_random_walk_density, expected a"
                " positive one, of the drift"
            )

    @property
    def advances(self) -> tuple[Block, ...]:
        chaser = self.attitude == "chaser_attitude"
        attitude = CHASER_ATTITUDE if chaser else RELATIVE_ATTITUDE
        moving = GYRO_BIAS if self.part == "bias" else GYRO_DRIFT
        return (attitude, moving) if self.bias_random_walk_density.any() else (attitude,)

    @property
    def reads(self) -> tuple[Block, ...]:
        own = (GYRO_BIAS,) if GYRO_BIAS not in self.advances else ()
        return *own, *orbit_blocks(self.orbit)

    @property
    def noises(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("angle_random_walk_density", "bias_random_walk_density")[: len(self.advances)]

    def without_drift(self) -> Self:
        """The same with a constant bias, see `relnav_graph.core.contracts.Drifts`."""
        if self.part == "bias":
            return self
        still = np.zeros(3)
        return replace(self, part="bias", bias_random_walk_density=still, bias_time_constant=None)

    def constants(self) -> Array:
        densities = self.angle_random_walk_density, self.bias_random_walk_density
        T = self.bias_time_constant
        return np.concatenate([orbit_array(self.orbit), *densities, [np.inf if T is None else T]])

    def condense(self, u: Array) -> Array:
        """The samples of an interval, one by one or taken together."""
        return condense(u, LARGEST_TURN) if self.samples == "together" else u
