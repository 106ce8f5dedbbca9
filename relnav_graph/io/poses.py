"""How a body moves, as files say it: attitudes of several forms, poses and their covariances.

What is here is the same for all formats: a frame a, a body b; ``R_ab`` takes b-components to
a-components, the matrix of the Hamilton quaternion (v_a = q v_b q*); ``r_ab_a`` is where b is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.state import UNIT_QUATERNION
from relnav_graph.errors import InputError
from relnav_graph.maths import dense, so3

__all__ = [
    "ORDERS",
    "Motion",
    "Where",
    "check_quaternions",
    "from_matrices",
    "from_mrp",
    "from_quaternions",
    "in_body_axes",
    "in_fixed_axes",
    "pose_covariance_of_inverse",
    "quaternions",
]

#: Where w, x, y, z stand in a quaternion, by the order that a format has.
ORDERS: Mapping[str, tuple[int, ...]] = {"wxyz": (0, 1, 2, 3), "xyzw": (3, 0, 1, 2)}

Where = Callable[[int], str]


def from_quaternions(where: Where, q: Array, order: str = "wxyz") -> Array:
    """Rotations (N, 3, 3) of Hamilton quaternions (N, 4) of that order, normalised.

    where: of a row, for messages. Raises InputError on a length that is not one within 1e-3, and on
    another order.
    """
    if order not in ORDERS:
        raise InputError(f"found the order {order!r} of a quaternion, expected wxyz or xyzw")
    check_quaternions(where, q)
    own = np.ascontiguousarray(q[:, ORDERS[order]], dtype=np.float64)
    return dense.stacked((so3.from_quaternion(one) for one in own), 3, 3)


def check_quaternions(where: Where, q: Array) -> None:
    """Raise InputError unless all quaternions (N, 4) have the length one within 1e-3."""
    bad = np.nonzero(~(np.abs(np.linalg.norm(q, axis=1) - 1) <= UNIT_QUATERNION))[0]
    if len(bad):
        raise InputError(
            f"{where(int(bad[0]))}: found the quaternion {q[bad[0]]} of length"
            f" {np.linalg.norm(q[bad[0]]):.6g}, expected one of length 1, within 1e-3"
        )


def from_matrices(where: Where, matrices: Array) -> Array:
    """The rotations (N, 3, 3) nearest to matrices that are some but for digits lost in a file.

    Raises InputError where R^T R differs from I by more than 1e-3, and on reflections.
    """
    off = np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max(axis=(1, 2))
    bad = np.nonzero(~((off <= UNIT_QUATERNION) & (np.linalg.det(matrices) > 0)))[0]
    if len(bad):
        raise InputError(
            f"{where(int(bad[0]))}: found the matrix {matrices[bad[0]].tolist()}, expected a"
            f" rotation: R^T R - I is up to {off[bad[0]]:.3g}"
        )
    u, _, v = np.linalg.svd(matrices)
    return np.ascontiguousarray(u @ v)


def from_mrp(mrp: Array) -> Array:
    """Rotations (N, 3, 3) of modified Rodrigues parameters (N, 3), ``e tan(angle / 4)``.

    As of the Hamilton quaternion ``(1 - s^2, 2 s) / (1 + s^2)`` (Schaub and Junkins 2018, eq.
    3.150): Basilisk's sigma_BN, whose [BN] takes N-components to B-components, gives R_nb.
    """
    square = (mrp**2).sum(axis=1, keepdims=True)
    q = np.hstack([1 - square, 2 * mrp]) / (1 + square)
    return dense.stacked((so3.from_quaternion(one) for one in np.ascontiguousarray(q)), 3, 3)


def quaternions(R: Array, order: str = "wxyz") -> Array:
    """Hamilton quaternions (N, 4) of that order, w >= 0, of rotations (N, 3, 3)."""
    own = np.ascontiguousarray(R, dtype=np.float64)
    q = dense.stacked((so3.quaternion(one) for one in own), 4)
    return np.ascontiguousarray(q[:, np.argsort(ORDERS[order])])


def _turned(R: Array, P: Array, places: tuple[int, ...]) -> Array:
    """``A P A^T`` (N, n, n), A with R (N, 3, 3) from each of the places on, else the identity."""
    A = np.tile(np.eye(P.shape[1]), (len(P), 1, 1))
    for i in places:
        A[:, i : i + 3, i : i + 3] = R
    return np.ascontiguousarray(A @ P @ np.swapaxes(A, 1, 2))


def in_body_axes(R_ab: Array, P: Array) -> Array:
    """Covariances of poses (N, 6, 6), place (m) then attitude (rad), with errors of the attitude
    about the axes of b, ``R Exp(d)``, of some about those of a, ``Exp(e) R``: d = R^T e.

    The place stays in a. ROS has the axes of a (REP 103: fixed axes).
    """
    return _turned(np.swapaxes(R_ab, 1, 2), P, (3,))


def in_fixed_axes(R_ab: Array, P: Array) -> Array:
    """The reverse of `in_body_axes`: covariances (N, 6, 6) with attitudes about the axes of a."""
    return _turned(R_ab, P, (3,))


def pose_covariance_of_inverse(R_ba: Array, r_ba_b: Array, P: Array) -> Array:
    """Covariances (N, 6, 6) of the inverse poses R_ba (N, 3, 3), r_ba_b (N, 3), m, of P, of the
    poses themselves; place (m), then right perturbations (rad).

    ``r_ba_b = -R_ab^T r_ab_a``: de' = -R_ba de + [r_ba_b x] dd, and dd' = -R_ab dd.
    """
    A = np.zeros((len(P), 6, 6))
    A[:, :3, :3] = -R_ba
    A[:, :3, 3:] = -np.cross(r_ba_b[:, None], np.eye(3)[None])
    A[:, 3:, 3:] = -np.swapaxes(R_ba, 1, 2)
    return np.ascontiguousarray(A @ P @ np.swapaxes(A, 1, 2))


@dataclass(frozen=True, eq=False)
class Motion:
    """What a file says of how b moves in a, at t (N,), s.

    values: attitude R_ab (N, 3, 3); position r_ab_a, m; velocity, m/s, of it in a; rate w_ba_b,
    rad/s; acceleration, m/s^2, in b; others by names of their own; (N, n) each. covariances: (N, n,
    n) by quantity, SI, of an attitude of the right perturbation; "pose": (N, 6, 6), place, then
    attitude; NaN where not given. where: file and line of a row, for messages; arrival: s, (N,).
    """

    t: Array
    values: Mapping[str, Array]
    where: Where
    covariances: Mapping[str, Array] = field(default_factory=dict)
    arrival: Array | None = None

    def covariance(self, quantity: str) -> Array | None:
        """That of one quantity, or of "pose"; None where not given."""
        pose = self.covariances.get("pose")
        if pose is not None and quantity in ("position", "attitude"):
            part = slice(0, 3) if quantity == "position" else slice(3, 6)
            return pose[:, part, part]
        return self.covariances.get(quantity)

    def inverse(self) -> Motion:
        """The pose of a in b, R_ba, r_ba_b, and nothing else. Raises InputError without an
        attitude."""
        R = self.values.get("attitude")
        if R is None:
            raise InputError(
                f"{self.where(0)}: found {', '.join(self.values)} to be inverted, expected a pose"
            )
        R_ba = np.ascontiguousarray(np.swapaxes(R, 1, 2))
        values, covariances = {"attitude": R_ba}, dict[str, Array]()
        if "position" in self.values:
            r = -np.einsum("nij,nj->ni", R_ba, self.values["position"])
            values["position"] = r
            P = self.covariances.get("pose")
            if P is not None:
                covariances["pose"] = pose_covariance_of_inverse(R_ba, r, P)
        elif "attitude" in self.covariances:
            covariances["attitude"] = _turned(R, self.covariances["attitude"], (0,))
        return replace(self, values=values, covariances=covariances)
