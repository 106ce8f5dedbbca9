"""Extended Kalman filter whose error is that of the group of poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.catalogue import RELATIVE_ATTITUDE, RELATIVE_POSITION_T, RELATIVE_VELOCITY_T
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Layout
from relnav_graph.errors import ModelError
from relnav_graph.estimators.ekf import KalmanEngine, KalmanFilter, KalmanState, sweep
from relnav_graph.estimators.filter_sweep import FilterState, FilterSweep
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.filter import FilterInput, FilterOutput, filter_epochs
from relnav_graph.maths import so3

__all__ = ["InvariantEkf"]


class GroupError:
    """The error xi of a state, with which ``X = exp(xi) X_hat`` on its pose X relative to t.

    X has R_tc, r_tc_t and, where that is in the state, its derivative: SE(3) or SE_2(3). With phi
    and rho their parts of xi: R_tc turns to ``Exp(phi) R_tc``, and r to
    ``Exp(phi) r + J_l(phi) rho``. All other blocks have the error that they have elsewhere.

    Raises ModelError on a layout without such a pose.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        if not {RELATIVE_ATTITUDE, RELATIVE_POSITION_T} <= set(layout.blocks):
            raise ModelError(
                f"invariant_ekf: found {layout}, expected relative_attitude R_tc and"
                ' relative_position in t (pose = "target")'
            )
        own = (RELATIVE_POSITION_T, RELATIVE_VELOCITY_T)
        self.vectors = [block.name for block in own if block in layout.blocks]

    def slope(self, x: Array) -> Array:
        """J (n, n) of ``d = J xi``, to first order, d the tangent at x (size,)."""
        turned = self.layout.tangent(RELATIVE_ATTITUDE.name)
        J = np.eye(self.layout.dim)
        J[turned, turned] = self.layout.value(x, RELATIVE_ATTITUDE.name).T
        for name in self.vectors:
            J[self.layout.tangent(name), turned] = -so3.skew(self.layout.value(x, name))
        return J

    def moved(self, x: Array, xi: Array) -> Array:
        """The state ``exp(xi) x`` (size,), of x (size,) and xi (n,)."""
        d = xi.copy()
        turned = self.layout.tangent(RELATIVE_ATTITUDE.name)
        phi = np.ascontiguousarray(xi[turned])
        d[turned] = self.layout.value(x, RELATIVE_ATTITUDE.name).T @ phi
        ahead, left = so3.exp(phi), so3.right_jacobian(-phi)
        for name in self.vectors:
            r = self.layout.value(x, name)
            d[self.layout.tangent(name)] = ahead @ r + left @ xi[self.layout.tangent(name)] - r
        return self.layout.retract(x, d)

    def regroup(self, before: Array, x: Array, P: Array) -> tuple[Array, Array]:
        """An update in this error, of one that was made in the tangent: state and covariance.

        before: the prediction (size,); x (size,), P (n, n): what the update made of it, P in the
        tangent of x. The rows of both updates are the same, for both errors begin at the
        prediction; the step leads elsewhere, and the covariance of xi is that of the error there.
        """
        d = self.layout.local(before, x)
        if not d.any():
            return x, P
        J = self.slope(before)
        xi: Array = np.linalg.solve(J, d).astype(np.float64)
        there = self.moved(before, xi)
        back = np.linalg.inv(self.layout.right_jacobian(d) @ J)
        M = self.slope(there) @ back
        P = M @ P @ M.T
        return there, 0.5 * (P + P.T)


class InvariantEngine(KalmanEngine):
    """The filter, driven online. Raises ModelError as `GroupError` does, InputError on considered
    blocks."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem, 1)
        problem.expect_none_considered("an invariant filter")
        self.error = GroupError(problem.layout)

    def through(
        self, assembly: Assembly, start: KalmanState, seconds: list[float] | None = None
    ) -> FilterSweep:
        """As of the extended filter, with this error."""

        def steps(
            given: FilterInput,
            begin: int,
            end: int,
            at: FilterState,
            ahead: Array,
            out: FilterOutput,
            failure: Indices,
        ) -> None:
            for k in range(begin, end):
                here = ahead if k == begin else np.zeros_like(ahead)
                one = assembly.tables, given, 1, k, k + 1, at.x, at.P, here, out, failure
                filter_epochs(*one)
                if failure[0]:
                    return
                found = self.error.regroup(out.x_predicted[k], out.x[k], out.P[k])
                out.x[k], out.P[k] = found
                at = FilterState(None, out.x[k], out.P[k])

        at = FilterState(start.t, start.x, start.P)
        return sweep(self.problem, assembly, steps, at, keep=False, seconds=seconds)


@dataclass(frozen=True)
class InvariantEkf(KalmanFilter):
    """Extended Kalman filter with the right-invariant error of the pose relative to the target.

    Barrau and Bonnabel 2017: of known points, and where gyro and velocity are measured, rows and
    transition of this error do not depend on the estimate, so that a bad beginning spoils no later
    step. For states whose pose stands directly relative to the target (pose = "target"). The
    models are those of `ekf`; only where a step leads, and what its covariance is one of, differ.

    Where the attitude is known to 30 deg, it converges where `ekf` does not; `iekf`, which iterates
    its updates, is better than either: see experiments/README.md.
    """

    kind: ClassVar[str] = "invariant_ekf"

    def engine(self, problem: Problem) -> InvariantEngine:
        """For use online. Raises as `InvariantEngine` does."""
        return InvariantEngine(problem)
