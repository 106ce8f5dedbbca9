"""Native factors and variables that tests put into a graph."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.estimators.isam2 import Extra, Keys

MINE, OTHER = gtsam.symbol("L", 0), gtsam.symbol("L", 1)


def isotropic(dim: int, sigma: float) -> Any:
    return gtsam.noiseModel.Isotropic.Sigma(dim, sigma)


def extra_of(factors: list[Any], values: dict[int, Array] | None = None) -> Extra:
    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for factor in factors:
        graph.push_back(factor)
    for key, value in (values or {}).items():
        initial.insert(key, value)
    return Extra(graph, initial)


def closure(keys: Keys, i: int, j: int, difference: Array) -> Any:
    """The position of epoch j less that of epoch i, known to 1 mm."""
    ends = keys["relative_position", i], keys["relative_position", j]
    return gtsam.BetweenFactorVector(*ends, difference, isotropic(3, 1e-3))


def at_zero(dim: int) -> tuple[Array, Any]:
    return np.zeros(dim), isotropic(dim, 1.0)
