"""Inertia: which ones a body can have, and a basis for the shape of any of them."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError

__all__ = [
    "TRACELESS",
    "check_inertia",
    "inertia_of",
    "inertia_parameters",
    "parameter_slopes",
    "principal_moments",
    "second_moments",
]

#: A basis of the symmetric (3, 3) matrices without a trace, each with a sum of squares of 2.
TRACELESS = np.zeros((5, 3, 3))
TRACELESS[0] = np.diag([1.0, -1.0, 0.0])
TRACELESS[1] = np.diag([1.0, 1.0, -2.0]) / np.sqrt(3.0)
for _a, (_i, _j) in enumerate(((0, 1), (0, 2), (1, 2)), 2):
    TRACELESS[_a, _i, _j] = TRACELESS[_a, _j, _i] = 1.0
TRACELESS.flags.writeable = False


def second_moments(J: Array) -> Array:
    """D (3, 3), kg m^2, the second moments of the mass of an inertia J = tr(D) I - D.

    J: (3, 3), kg m^2.
    """
    return np.asarray(0.5 * np.trace(J) * np.eye(3) - J)


def principal_moments(J: Array) -> tuple[Array, Array]:
    """Second moments of the mass about the principal axes (3,), kg m^2, and R_tp (3, 3), of an
    inertia J (3, 3), kg m^2, in t."""
    moments, R_tp = np.linalg.eigh(second_moments(J))
    R_tp[:, 2] *= np.linalg.det(R_tp)
    return moments, R_tp


def inertia_parameters(J: Array) -> Array:
    """The block `catalogue.INERTIA_MATRIX` (5,), no unit, of a body's inertia J (3, 3).

    J: kg m^2, in the axes of t; its scale does not matter.
    """
    moments, R_tp = principal_moments(J)
    logs = np.log(moments)
    S = R_tp @ np.diag(logs - logs.mean()) @ R_tp.T
    out: Array = 0.5 * np.einsum("aij,ij->a", TRACELESS, S)  # each of TRACELESS has the square 2
    return out


def inertia_of(k: Array) -> Array:
    """J (3, 3), no unit and of some scale, of the block `catalogue.INERTIA_MATRIX`, k (5,).

    The inverse of `inertia_parameters`.
    """
    logs, R_tp = np.linalg.eigh(np.tensordot(k, TRACELESS, 1))
    moments = np.exp(logs)
    out: Array = R_tp @ np.diag(moments.sum() - moments) @ R_tp.T
    return out


def parameter_slopes(J: Array, changes: Array) -> Array:
    """Derivatives (5, n) of `inertia_parameters` at J (3, 3), kg m^2, along n changes of J (n, 3,
    3), each per unit of its change.

    Of the logarithm of the second moments, by divided differences in their own axes (Higham 2008,
    Functions of Matrices, eq. 3.16).
    """
    moments, R_tp = principal_moments(J)
    logs, gaps = np.log(moments), np.subtract.outer(moments, moments)
    near = np.abs(gaps) < 1e-6 * moments.max()
    mean = 0.5 * np.add.outer(moments, moments)
    divided = np.where(near, 1 / mean, np.subtract.outer(logs, logs) / np.where(near, 1.0, gaps))
    second = 0.5 * np.trace(changes, axis1=1, axis2=2)[:, None, None] * np.eye(3) - changes
    slopes = R_tp @ (divided * (R_tp.T @ second @ R_tp)) @ R_tp.T
    out: Array = 0.5 * np.einsum("aij,nij->an", TRACELESS, slopes)
    return out


def check_inertia(where: str, J: Array) -> None:
    """Raise InputError on an inertia that no body of positive mass has.

    J: kg m^2, a matrix (3, 3), or principal moments (3,).

    It has D positive definite (Wensing, Kim, Slotine 2018, section III): each principal
    moment is below the sum of the other two.
    """
    matrix = np.diag(J) if J.ndim == 1 else J
    symmetric = np.abs(matrix - matrix.T).max() <= 1e-9 * np.abs(matrix).max()
    if not symmetric or not np.linalg.eigvalsh(second_moments(matrix)).min() > 0:
        raise InputError(
            f"{where}: found {J.tolist()} kg m^2, which no body has: expected"
            " symmetry, and principal moments each below the sum of the other two"
        )
