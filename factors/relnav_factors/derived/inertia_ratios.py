"""Ratios of the target's inertia, as the papers report them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from relnav_factors.shared.inertia import inertia_matrix, principal_ratios
from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import INERTIA, INERTIA_MATRIX
from relnav_graph.core.state import Block

#: Where (J_yy, J_zz, J_xy, J_xz, J_yz) stand in J.
_ENTRIES = ([1, 2, 0, 0, 1], [1, 2, 1, 2, 2])


@dataclass(frozen=True)
class InertiaRatios:
    """(J_y - J_z) / J_x and cyclic, of the target's principal moments."""

    kind: ClassVar[str] = "inertia_ratios"
    block: ClassVar[Block] = Block("inertia_ratios", "l_t", "vector", 3, "1", "t", "1")
    reads: ClassVar[tuple[Block, ...]] = (INERTIA,)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """l (3,) and its Jacobian (3, 2), without unit.

        x: k (2,), see `relnav_graph.core.catalogue.INERTIA`.
        """
        return principal_ratios(np.ascontiguousarray(x[0]))


@dataclass(frozen=True)
class InertiaMatrixRatios:
    """(J_yy, J_zz, J_xy, J_xz, J_yz) / J_xx, as Hu et al. 2019, eq. 9.

    J_xy is the entry of the matrix, with its sign.
    """

    kind: ClassVar[str] = "inertia_matrix_ratios"
    block: ClassVar[Block] = Block("inertia_ratios", "J_t", "vector", 5, "1", "t", "1")
    reads: ClassVar[tuple[Block, ...]] = (INERTIA_MATRIX,)

    def value(self, *x: Array) -> tuple[Array, Array]:
        """Ratios (5,) and their Jacobian (5, 5), without unit.

        x: k (5,), see `relnav_graph.core.catalogue.INERTIA_MATRIX`.
        """
        J, dJ = inertia_matrix(np.ascontiguousarray(x[0]))
        ratios = J[_ENTRIES] / J[0, 0]
        slopes = (dJ[:, _ENTRIES[0], _ENTRIES[1]] - np.outer(dJ[:, 0, 0], ratios)) / J[0, 0]
        return ratios, slopes.T
