"""The array types of all signatures: C-contiguous unless a docstring says otherwise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Indices"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
