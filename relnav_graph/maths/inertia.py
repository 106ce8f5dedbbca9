"""Inertia: which ones a body can have, and a basis for the shape of any of them."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError

__all__ = ["TRACELESS", "check_inertia", "second_moments"]

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
