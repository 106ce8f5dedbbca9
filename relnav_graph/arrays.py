"""The array types of all signatures, C-contiguous unless a docstring says otherwise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Indices", "finite"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def finite(*arrays: Array) -> NDArray[np.bool_]:
    """Which rows are finite in all arrays (N, ...)."""
    rows = np.ones(len(arrays[0]), dtype=np.bool_)
    for a in arrays:
        rows &= np.isfinite(a).all(axis=tuple(range(1, a.ndim)))
    return rows
