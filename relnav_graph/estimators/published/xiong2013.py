"""Xiong, Yao and Yu's filter of both craft's poses, as printed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import expm

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    CHASER_POSITION,
    CHASER_VELOCITY,
    GYRO_BIAS,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_VELOCITY,
    TARGET_ATTITUDE,
    TARGET_RATE,
)
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import ModelError
from relnav_graph.estimators.published.own_coordinates import PublishedFilter, require
from relnav_graph.linear.assembly import Assembly

__all__ = ["XiongFilter"]

#: From the target to the chaser, in the chaser's own orbital frame, a: x along-track, y against the
#: orbit normal, z to nadir; and its rate there.
OWN_POSITION = Block("own_relative_position", "rho_a", "vector", 3, "m", "a", "m")
OWN_VELOCITY = Block("own_relative_velocity", "rho'_a", "vector", 3, "m/s", "a", "m/s")
_ORBIT = CHASER_POSITION, CHASER_VELOCITY
#: What both the scenario and the paper have in their states.
_SAME = *_ORBIT, GYRO_BIAS, CHASER_ATTITUDE, TARGET_RATE
#: Of a complex step: its square is nothing beside 1, so that the derivative is exact.
_STEP = 1e-30


def _cross(a: Any, b: Any) -> Any:
    """a x b, (3, ...) each, also of complex numbers."""
    return np.array([a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)])


def _squared(a: Any) -> Any:
    """Sum of squares of real vectors (3, ...), analytic in them."""
    return (a * a).sum(axis=0)


def orbital_axes(r: Any, v: Any) -> tuple[Any, Any]:
    """C_a^i (3, 3, ...) and w_ai_a (3, ...), rad/s, of craft at r, m, and v, m/s, (3, ...): eq. 19.

    x along-track, y against the orbit normal, z to nadir, a in the columns. Analytic in r and v,
    which may be complex.
    """
    h = _cross(r, v)
    z, y = -r / np.sqrt(_squared(r)), -h / np.sqrt(_squared(h))
    rate = np.sqrt(_squared(h)) / _squared(r)
    return np.stack([_cross(y, z), y, z], axis=1), np.array([0 * rate, -rate, 0 * rate])


def clohessy_wiltshire(n: float) -> Array:
    """[0, I; F1, F2] (6, 6), SI, of eq. 12, at the orbital rate n, rad/s, in the axes a.

    F1 = diag(0, -n^2, 3 n^2), F2 = [0, 0, 2n; 0, 0, 0; -2n, 0, 0].
    """
    F = np.zeros((6, 6))
    F[:3, 3:] = np.eye(3)
    F[4, 1], F[5, 2], F[3, 5], F[5, 3] = -(n**2), 3 * n**2, 2 * n, -2 * n
    return F


def relative_in_inertial(own: Any, r: Any, v: Any) -> Any:
    """r_tc_i, m, and v_tc_i, m/s, (6, ...), of rho and rho' in a, (6, ...), and the chaser's r and
    v, (3, ...), in i."""
    C, w = orbital_axes(r, v)
    rate = own[3:] + _cross(w, own[:3])
    both = [np.einsum("ij...,j...->i...", C, one) for one in (own[:3], rate)]
    return np.concatenate(both)


class _Joint:
    """The scenario's state in the paper's coordinates."""

    layout = Layout((OWN_POSITION, OWN_VELOCITY, RELATIVE_ATTITUDE, *_SAME))

    def __init__(self, problem: Problem, where: str) -> None:
        blocks = RELATIVE_POSITION, RELATIVE_VELOCITY, TARGET_ATTITUDE, *_SAME
        self._x = require(problem, blocks, where)
        if problem.orbit is not None:
            raise ModelError(f"{where}: found an orbit, expected axes o that do not turn")

    def own(self, x: Array) -> Array:
        values = self._x.values(x)
        C, w = orbital_axes(values[CHASER_POSITION.name], values[CHASER_VELOCITY.name])
        rho = C.T @ values[RELATIVE_POSITION.name]
        rate = C.T @ values[RELATIVE_VELOCITY.name] - _cross(w, rho)
        R_tc = values[TARGET_ATTITUDE.name].T @ values[CHASER_ATTITUDE.name]
        new = {OWN_POSITION.name: rho, OWN_VELOCITY.name: rate, RELATIVE_ATTITUDE.name: R_tc}
        return self.layout.pack(values | new)

    def scenario(self, y: Array) -> Array:
        values = self.layout.values(y)
        found = relative_in_inertial(*self._orbits(y))
        R_it = values[CHASER_ATTITUDE.name] @ values[RELATIVE_ATTITUDE.name].T
        return self._x.pack(
            values
            | {
                RELATIVE_POSITION.name: found[:3],
                RELATIVE_VELOCITY.name: found[3:],
                TARGET_ATTITUDE.name: R_it,
            }
        )

    def jacobian(self, y: Array) -> Array:
        """With it the scenario's stereo points get the paper's Jacobians (eq. 22, corrected): those
        to the chaser's own orbit, by which C_o^i turns, and to both attitudes."""
        out = np.zeros((self._x.dim, self.layout.dim))
        x, own = self._x.tangent, self.layout.tangent
        for block in _SAME:
            out[x(block.name), own(block.name)] = np.eye(block.dim)
        relative, r, v = self._orbits(y)
        rows = self._x.gather((RELATIVE_POSITION, RELATIVE_VELOCITY))[1]
        columns = self.layout.gather((OWN_POSITION, OWN_VELOCITY, *_ORBIT))[1]
        at = np.concatenate([relative, r, v])[:, None] + _STEP * 1j * np.eye(12)
        out[np.ix_(rows, columns)] = relative_in_inertial(at[:6], at[6:9], at[9:]).imag / _STEP
        # R_it = R_ic R_tc^T: a turn d of c turns t by R_tc d, one of R_tc back by as much.
        R_tc = self.layout.value(y, RELATIVE_ATTITUDE.name)
        out[x(TARGET_ATTITUDE.name), own(CHASER_ATTITUDE.name)] = R_tc
        out[x(TARGET_ATTITUDE.name), own(RELATIVE_ATTITUDE.name)] = -R_tc
        return out

    def predict(self, y: Array, interval: Assembly) -> tuple[Array, Array, Array]:
        """All but the relative orbit by the scenario's processes, which are the paper's (eqs. 5 to
        16); that by Clohessy-Wiltshire, which knows no error of the chaser's orbit."""
        x_next, F, Q_x = interval.transition(self.scenario(y)[None])
        relative, r, v = self._orbits(y)
        dt = float(interval.times[0] - interval.tables.starts[0])
        n = float(np.linalg.norm(orbital_axes(r, v)[1]))
        step = expm(clohessy_wiltshire(n) * dt)
        after = self.own(x_next[0])
        ahead = np.linalg.inv(self.jacobian(after))
        stored, mine = self.layout.gather((OWN_POSITION, OWN_VELOCITY))
        Phi = ahead @ F[0] @ self.jacobian(y)
        Phi[mine] = 0.0
        Phi[np.ix_(mine, mine)] = step
        # Noise of the chaser's orbit is none of rho's: as printed the two are apart (eq. 17).
        ahead[np.ix_(mine, self._x.gather(_ORBIT)[1])] = 0.0
        after[stored] = step @ relative
        return after, Phi, ahead @ Q_x[0] @ ahead.T

    def _orbits(self, y: Array) -> tuple[Array, Array, Array]:
        """rho and rho' (6,), r_c_i and v_c_i (3,), SI."""
        value = self.layout.value
        relative = [value(y, OWN_POSITION.name), value(y, OWN_VELOCITY.name)]
        return (
            np.concatenate(relative),
            value(y, CHASER_POSITION.name),
            value(y, CHASER_VELOCITY.name),
        )


@dataclass(frozen=True)
class XiongFilter(PublishedFilter):
    """The joint filter of Xiong, Yao, Yu 2013: 24 error states of both craft.

    rho, rho', r_c, r_c', attitude of c relative to t, gyro bias, attitude of c, rate of t. The
    relative orbit by Clohessy-Wiltshire (eq. 12) in an orbital frame that is taken from the
    chaser's own orbit (eq. 19), not from the target's, which nobody knows. So stereo points depend
    on the chaser's orbit, too (eqs. 20 to 22).

    As printed but for three errors: the Jacobian to the chaser's attitude is -2 [(A C rho) x], not
    -2 A C [rho x]; H3 lacks a block of zeros; and the star sensor has an identity there, which it
    is only of the error to the measured attitude. All are of the scenario's own sensors here, by
    the chain rule. Full angles in place of half ones. Noise and prior are the scenario's.
    """

    kind: ClassVar[str] = "xiong2013_filter"

    def of(self, problem: Problem) -> _Joint:
        """Raises ModelError unless the state is that of both craft in axes that do not turn, with a
        known inertia."""
        return _Joint(problem, self.kind)
