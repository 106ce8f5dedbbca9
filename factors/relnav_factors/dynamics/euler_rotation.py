"""Free rotation of the target: attitude, rate and inertia ratios."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from relnav_factors.shared.inertia import coefficients_of, full_coefficients, principal_coefficients
from relnav_factors.shared.planar_orbit import in_state, orbit_blocks, put_turned
from relnav_factors.shared.rate_steps import published_step, rate_step, start_of
from relnav_factors.shared.statuses import NO_BODY, ROTATION_FAILURES, TOO_FAST, finite
from relnav_factors.shared.white_noise import add_step, duration, put_advanced, step_count
from relnav_graph.arrays import Array
from relnav_graph.compiled import give_way, jit
from relnav_graph.core import catalogue
from relnav_graph.core.contracts import Kernel
from relnav_graph.core.models import DynamicsModel
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3
from relnav_graph.maths.inertia import check_inertia
from relnav_graph.maths.orbit import KeplerOrbit, orbit_array
from relnav_graph.units import Quantity

#: Where the numbers of the kernels stand in p, after the orbit (5,).
_TORQUE_DENSITY, _INERTIA_DENSITY, MAX_STEP, _EULER, _KNOWN = 5, 6, 7, 8, 9
#: The block that holds the inertia.
_BLOCKS = {"principal": (catalogue.INERTIA,), "full": (catalogue.INERTIA_MATRIX,), "known": ()}


@jit
def _rotate(
    p: Array, t: float, u: Array, x: Array, A: Array, dA: Array, x_next: Array, F: Array, Q: Array
) -> int:
    """``R_ot' = R_ot [w_ti_t x] - [w_oi_o x] R_ot`` and w', for the kernels below.

    A: (3, 6), dA: (dim k, 3, 6), see `principal_coefficients`; the rest, and what is returned: see
    `principal_kernel`, `ROTATION_FAILURES`.
    """
    if not finite(A):
        return NO_BODY
    steps = step_count(duration(u), p[MAX_STEP])
    h = duration(u) / steps
    n, angle = x.shape[0] - 6 - in_state(p), np.empty(3)  # n: of the tangent, but for the orbit
    R_ot, w = dense.matrix_at(x, 0), dense.vector_at(x, 9)
    total, noise, step = dense.identity(n), np.zeros((n, n)), dense.identity(n)
    for done in range(steps):
        give_way(done)
        before = start_of(w, n - 3)
        if p[_EULER] != 0.0:
            after, turn = published_step(before, A, dA, h)
        else:
            after, turn = rate_step(before, A, dA, h)
        for i in range(3):
            w[i], angle[i] = after[i, 0], turn[i, 0]
        ahead, bend = so3.exp(angle), so3.right_jacobian(angle)
        dense.put_block(R_ot, 0, 0, dense.matmul(R_ot, ahead), 1.0)
        for i in range(3):
            for j in range(3):
                step[i, j] = ahead[j, i]
            for j in range(3, n):
                step[3 + i, j] = after[i, j - 2]
                step[i, j] = 0.0
                for l in range(3):
                    step[i, j] += bend[i, l] * turn[l, j - 2]
        add_step(step, p[_TORQUE_DENSITY] ** 2, h, total, noise)
        for i in range(6, n):
            noise[i, i] += p[_INERTIA_DENSITY] ** 2 * h
    if not (finite(R_ot) and finite(total)):
        return TOO_FAST
    status = put_turned(p, t, u, x, R_ot, x_next, F)
    if status != 0:
        return status
    dense.put_vector(x_next, 9, w)
    for i in range(12, x_next.shape[0]):
        x_next[i] = x[i]
    put_advanced(total, noise, F, Q)
    return 0


@jit
def principal_kernel(
    p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array
) -> int:
    """``w_x' = l_x w_y w_z`` and cyclic, ``l = tanh(k_x, k_y, -k_x - k_y)``: t are principal axes.

    p (9,): orbit (5,), torque density (rad/s^1.5), density of k (1/sqrt(s)), longest step (s), 1
    for Euler's integrator, else 0. u (rows, 1): dt, s. x, x_next (14,): R_ot row by row, w_ti_t
    (rad/s), k (2,). F, Q (8, 8), in rad, rad/s and 1. Of a constant k: F (6, 8), Q (6, 6). After
    them in x and F an orbit (4,), where it is in the state.
    """
    return _rotate(p, t, u, x, *principal_coefficients(x[12:]), x_next, F, Q)


@jit
def full_kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``J w' = -w x J w`` about any axes t: as `principal_kernel`, with J of k (5,).

    x, x_next (17,): R_ot, w_ti_t (rad/s), k (5,). F, Q (11, 11), or F (6, 11), Q (6, 6).
    """
    return _rotate(p, t, u, x, *full_coefficients(x[12:]), x_next, F, Q)


@jit
def known_kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``J w' = -w x J w`` of a known J: as `principal_kernel`, without k.

    p (27,): ends with A (3, 6) row by row, of `coefficients_of`. x, x_next (12,): R_ot, w_ti_t
    (rad/s). F, Q (6, 6).
    """
    A = p[_KNOWN : _KNOWN + 18].reshape(3, 6)
    return _rotate(p, t, u, x, A, np.zeros((0, 3, 6)), x_next, F, Q)


@dataclass(frozen=True, kw_only=True)
class EulerRotation(DynamicsModel):
    """Attitude, rate and inertia of a free rigid target.

    R_ot' = R_ot [w_ti_t x] - [w_oi_o x] R_ot; J w' = -w x J w + white (Zhang et al. 2015,
    section 3; Hu et al. 2019, eq. 4). inertia = "principal": t are principal axes, and the
    ratios l = tanh(k) stand in the state as k (`catalogue.INERTIA`); "full": any axes,
    `catalogue.INERTIA_MATRIX`; "known": known_inertia, J up to its scale, kg m^2, in t.

    torque_density: rad/s^1.5, angular acceleration per axis; inertia_density: 1/sqrt(s), of a
    random walk of k; 0, the default: k is constant, a static block; max_step: s, the longest step;
    orbit: the target's, None where o does not rotate; integrator: "euler" is Hu's; rate:
    "body_rate" where the axes of t are arbitrary: tables then show it in chaser axes.

    Raises InputError on a known inertia that no body has, that is missing, or unused.
    """

    kind: ClassVar[str] = "euler_rotation"
    failures = ROTATION_FAILURES

    torque_density: Annotated[float, Quantity("rad/s^1.5", positive=True)]
    inertia_density: Annotated[float, Quantity("1/sqrt(s)", nonnegative=True)] = 0.0
    max_step: Annotated[float, Quantity("s", positive=True)] = 1.0
    orbit: KeplerOrbit | None = None
    inertia: Literal["principal", "full", "known"] = "principal"
    known_inertia: Annotated[Array, Quantity("kg*m^2", (3, 3))] | None = None
    integrator: Literal["runge_kutta", "euler"] = "runge_kutta"
    rate: Literal["target_rate", "body_rate"] = "target_rate"

    def __post_init__(self) -> None:
        super().__post_init__()
        J = self.known_inertia
        if (J is not None) != (self.inertia == "known"):
            raise InputError(f"{self.kind}: known_inertia goes with inertia = 'known', and only so")
        if J is not None:
            check_inertia(f"{self.kind}.known_inertia", J)

    @property
    def kernel(self) -> Kernel:  # type: ignore[override]
        return {"principal": principal_kernel, "full": full_kernel, "known": known_kernel}[
            self.inertia
        ]

    @property
    def noises(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("torque_density", "torque_density", "inertia_density")[: len(self.advances)]

    @property
    def advances(self) -> tuple[Block, ...]:
        rate = catalogue.TARGET_RATE if self.rate == "target_rate" else catalogue.BODY_RATE
        inertia = _BLOCKS[self.inertia] if self.inertia_density else ()
        return catalogue.TARGET_ATTITUDE, rate, *inertia

    @property
    def reads(self) -> tuple[Block, ...]:
        inertia = () if self.inertia_density else _BLOCKS[self.inertia]
        return *inertia, *orbit_blocks(self.orbit)

    def caution(self, length: float, *x: Array) -> str:
        """Half a turn or more between epochs looks like the rest of a turn backwards."""
        turn = float(np.linalg.norm(x[1])) * length
        if turn < 0.98 * np.pi:
            return ""
        return f"the target turns {np.degrees(turn):.0f} deg in {length:g} s: aliased from 180 deg"

    def constants(self) -> Array:
        own = [self.torque_density, self.inertia_density, self.max_step, self.integrator == "euler"]
        known = np.zeros(0) if self.known_inertia is None else coefficients_of(self.known_inertia)
        return np.concatenate([orbit_array(self.orbit), own, known.ravel()])

    def directions(self, *x: Array) -> dict[str, tuple[Array, ...]]:
        """What a steady spin hides: the phase, and the inertia ratios."""
        w, none = x[1][:, None], np.zeros((3, 1))
        spin = w / max(float(np.linalg.norm(w)), 1e-12)
        orbit = tuple(np.zeros((b.dim, 1)) for b in orbit_blocks(self.orbit))
        ratios = np.eye(sum(b.dim for b in _BLOCKS[self.inertia]))
        rest = (0 * ratios[:, :1], *orbit) if len(ratios) else orbit
        found = {
            "rotation of the target about its spin axis": (spin, none, *rest),
            "rate of the target along its spin axis": (none, spin, *rest),
        }
        for n, ratio in enumerate(ratios, 1):
            found[f"inertia ratio k{n}"] = (none, none, ratio[:, None], *orbit)
        return found
