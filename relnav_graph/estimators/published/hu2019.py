"""Hu, Chen, Zheng and Dong's filter of attitude, rate and inertia, as printed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import INERTIA_MATRIX, TARGET_ATTITUDE, TARGET_RATE
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import EstimationError, ModelError
from relnav_graph.estimators.published.own_coordinates import PublishedFilter, require
from relnav_graph.linear.assembly import Assembly
from relnav_graph.maths import so3
from relnav_graph.maths.inertia import (
    inertia_of,
    inertia_parameters,
    parameter_slopes,
    second_moments,
)

__all__ = ["HuFiveSteps", "HuOneStep"]

#: (J_yy, J_zz, J_xy, J_xz, J_yz) / J_xx.
RATIOS = Block("inertia_ratios", "J_t", "vector", 5, "1", "t", "1")
#: E_k: what each ratio adds to J' = J / J_xx, and where each stands in it.
_ENTRIES = np.zeros((5, 3, 3))
_PLACES = ([1, 2, 0, 0, 1], [1, 2, 1, 2, 2])
for _k, (_i, _j) in enumerate(zip(*_PLACES, strict=True)):
    _ENTRIES[_k, _i, _j] = _ENTRIES[_k, _j, _i] = 1.0


def _inertia(ratios: Array) -> Array:
    """J' (3, 3) of its ratios (5,), without unit."""
    out: Array = np.diag([1.0, 0.0, 0.0]) + np.tensordot(ratios, _ENTRIES, 1)
    return out


def euler_step(R_it: Array, w: Array, ratios: Array, h: float) -> tuple[Array, Array, Array]:
    """R_it (3, 3) and w_ti_t (3,), rad/s, after one Euler step of h s, and I + A h (11, 11).

        q + h q' made a unit quaternion again,  w + h w',  J' w' = -w x J' w     (eqs. 4, 7, 17)
        d' = -w x d + e,  e' = dw'/dw e + dw'/dJ' j,  j' = 0                   (eqs. 12, 13, 16)

    R_it, w: at the start; ratios (5,): of `RATIOS`. d: rad, the paper's vector part of the error
    quaternion is half of it; e: rad/s; j: of the ratios. rad, s and 1.
    """
    J, W = _inertia(ratios), so3.skew(w)
    inverse = np.linalg.inv(J)
    w_dot = -inverse @ W @ J @ w
    A = np.zeros((11, 11))
    A[:3, :3], A[:3, 3:6] = -W, np.eye(3)
    A[3:6, 3:6] = -inverse @ (W @ J - so3.skew(J @ w))
    A[3:6, 6:] = -inverse @ np.array([E @ w_dot + W @ E @ w for E in _ENTRIES]).T
    length = float(np.linalg.norm(w))
    turn = 2 * np.arctan(0.5 * h * length) / length * w if length > 0 else w
    return R_it @ so3.exp(np.ascontiguousarray(turn)), w + h * w_dot, np.eye(11) + h * A


class _Ratios:
    """The scenario's state with the paper's ratios in place of its inertia parameters."""

    def __init__(self, problem: Problem, steps: int, where: str) -> None:
        blocks = TARGET_ATTITUDE, TARGET_RATE, INERTIA_MATRIX
        self._x = require(problem, blocks, where)
        if problem.orbit is not None:
            raise ModelError(f"{where}: found an orbit, expected axes o that do not turn")
        self.layout = Layout((TARGET_ATTITUDE, TARGET_RATE, RATIOS))
        self._steps, self._where = steps, where

    def own(self, x: Array) -> Array:
        J = inertia_of(self._x.value(x, INERTIA_MATRIX.name))
        return self.layout.pack(self._x.values(x) | {RATIOS.name: J[_PLACES] / J[0, 0]})

    def scenario(self, y: Array) -> Array:
        J = _inertia(self.layout.value(y, RATIOS.name))
        if not (np.isfinite(J).all() and np.linalg.eigvalsh(second_moments(J))[0] > 0):
            raise EstimationError(f"{self._where}: the inertia ratios are those of no body")
        k = inertia_parameters(J)
        return self._x.pack(self.layout.values(y) | {INERTIA_MATRIX.name: k})

    def jacobian(self, y: Array) -> Array:
        out = np.zeros((self._x.dim, self.layout.dim))
        for name in (TARGET_ATTITUDE.name, TARGET_RATE.name):
            out[self._x.tangent(name), self.layout.tangent(name)] = np.eye(3)
        slopes = parameter_slopes(_inertia(self.layout.value(y, RATIOS.name)), _ENTRIES)
        out[self._x.tangent(INERTIA_MATRIX.name), self.layout.tangent(RATIOS.name)] = slopes
        return out

    def predict(self, y: Array, interval: Assembly) -> tuple[Array, Array, Array]:
        values, total = self.layout.values(y), np.eye(self.layout.dim)
        R_it, w, ratios = (values[b.name] for b in self.layout.blocks)
        h = float(interval.times[0] - interval.tables.starts[0]) / self._steps
        for _ in range(self._steps):
            R_it, w, step = euler_step(R_it, w, ratios, h)
            total = step @ total
        if not (np.isfinite(w).all() and np.isfinite(total).all()):
            raise EstimationError(f"{self._where}: t = {interval.times[0]} s: not finite")
        # Its noise is not printed: the scenario's.
        moving = interval.transition(self.scenario(y)[None])[2][0]
        Q, back = np.zeros((self._x.dim, self._x.dim)), np.linalg.inv(self.jacobian(y))
        Q[: len(moving), : len(moving)] = moving
        ahead = {TARGET_ATTITUDE.name: so3.project(R_it), TARGET_RATE.name: w}
        return self.layout.pack(values | ahead), total, back @ Q @ back.T


@dataclass(frozen=True)
class HuOneStep(PublishedFilter):
    """The multiplicative filter of Hu, Chen, Zheng, Dong 2019, with one prediction a sample.

    Eleven error states: attitude, rate, and the ratios (J_yy, J_zz, J_xy, J_xz, J_yz) / J_xx.
    Predicted by Euler's method, Phi = I + A dT (eqs. 12 to 17), see `euler_step`. The noise of
    process and sensors, which is not printed, and the prior are the scenario's.
    """

    kind: ClassVar[str] = "hu2019_one_step"
    steps: int = 1

    def of(self, problem: Problem) -> _Ratios:
        """Raises ModelError unless the state is an attitude in axes that do not turn, a rate, and
        the inertia of a body about any axes."""
        return _Ratios(problem, self.steps, self.kind)


@dataclass(frozen=True)
class HuFiveSteps(HuOneStep):
    """The same with five predictions a sample, which is what the paper is about.

    Each is as long as a fifth of the interval, and so is the step of its Phi.
    """

    kind: ClassVar[str] = "hu2019_five_steps"
    steps: int = 5
