"""Principal axes and moments of a target whose inertia is full."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_factors.shared.inertia import inertia_matrix
from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import INERTIA_MATRIX
from relnav_graph.core.state import Block

#: The rotations that turn axes by half a turn or not at all: they leave principal axes as such.
_HALF_TURNS = np.array([np.diag(d) for d in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0])])
#: Moments that differ by less than this part of the largest are equal: from rounding, no more.
_EQUAL = 1e-12


def _principal(k: Array) -> tuple[Array, Array, Array]:
    """Moments J_1 <= J_2 <= J_3 (3,), axes (3, 3) in the columns, and P^T dJ P (5, 3, 3) per k.

    The axes are right-handed, of the signs that are nearest to the axes of t.
    """
    J, dJ = inertia_matrix(np.ascontiguousarray(k, dtype=np.float64))
    if not np.isfinite(J).all():  # of a k beyond floats
        return np.full(3, np.nan), np.full((3, 3), np.nan), np.full((5, 3, 3), np.nan)
    moments, axes = np.linalg.eigh(J)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    traces = np.einsum("ii,hii->h", axes, _HALF_TURNS)
    axes = axes @ _HALF_TURNS[np.argmax(traces)]
    return moments, axes, axes.T @ dJ @ axes


@dataclass(frozen=True)
class PrincipalAxes:
    """R_tp from principal axes p to t: R_tp^T J R_tp = diag(J_1, J_2, J_3), J_1 <= J_2 <= J_3."""

    kind: ClassVar[str] = "principal_axes"
    block: ClassVar[Block] = Block("principal_axes", "R_tp", "SO3", 3, "rad", "tp", "deg")
    reads: ClassVar[tuple[Block, ...]] = (INERTIA_MATRIX,)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """R_tp (3, 3) and its Jacobian (3, 5), rad, to right perturbations ``R_tp Exp(d)``.

        x: k (5,), see `relnav_graph.core.catalogue.INERTIA_MATRIX`. From (J + dJ) (p_i + dp_i) =
        (J_i + dJ_i) (p_i + dp_i): p_j^T dp_i = p_j^T dJ p_i / (J_i - J_j). Where two moments are
        equal, any axes in their plane are principal: the Jacobian is then NaN.
        """
        moments, axes, slope = _principal(x[0])
        jacobian = np.empty((3, 5))
        for axis in range(3):  # the turn about p_axis takes p_i towards p_j
            i, j = (axis + 1) % 3, (axis + 2) % 3
            gap = moments[i] - moments[j]
            singular = abs(gap) <= _EQUAL * moments[2]
            jacobian[axis] = np.nan if singular else slope[:, j, i] / gap
        return axes, jacobian

    def nearest(self, value: Array, to: Array) -> Array:
        """Of the axes R_tp (N, 3, 3) and those turned by half turns, (N, 3, 3) nearest to `to`.

        Axes have no sign: all of them are the same principal axes.
        """
        turned = value[:, None] @ _HALF_TURNS
        traces = np.einsum("nij,nhij->nh", to, turned)  # 1 + 2 cos(angle)
        best: Array = turned[np.arange(len(value)), traces.argmax(axis=1)]
        return best


@dataclass(frozen=True)
class PrincipalRatios:
    """(J_1, J_2) / J_3 of the principal moments J_1 <= J_2 <= J_3."""

    kind: ClassVar[str] = "principal_ratios"
    block: ClassVar[Block] = Block("principal_ratios", "J_p", "vector", 2, "1", "p", "1")
    reads: ClassVar[tuple[Block, ...]] = (INERTIA_MATRIX,)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """Ratios (2,) and their Jacobian (2, 5), without unit.

        x: k (5,), see `relnav_graph.core.catalogue.INERTIA_MATRIX`.
        """
        moments, _, slope = _principal(x[0])
        ratios = moments[:2] / moments[2]
        d_moments = np.einsum("aii->ia", slope)
        return ratios, (d_moments[:2] - np.outer(ratios, d_moments[2])) / moments[2]
