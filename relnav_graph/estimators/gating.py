"""Which observations to use: the chi-square gate, the same for filter and smoothers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from relnav_graph.assembly import Assembly, MeasurementRows
from relnav_graph.loops import ROWS

__all__ = ["count_rejected", "residual_weights", "thresholds"]

Array = NDArray[np.float64]


def thresholds(assembly: Assembly, gates: Mapping[str, float]) -> Array:
    """Squared normalised residual above which an observation is left out, (observations,).

    A filter tests an innovation against H P H^T + R with it.
    """
    limits = np.full(len(assembly.sensor_names), np.inf)
    for i, name in enumerate(assembly.sensor_names):
        if name in gates:
            limits[i] = chdtri(assembly.tables.sensors[i, ROWS], 1.0 - gates[name])
    by_observation: Array = limits[assembly.sensor_of]
    return by_observation


def residual_weights(
    assembly: Assembly, rows: MeasurementRows, gates: Mapping[str, float]
) -> Array:
    """1 or 0 for each observation, by its residual at a smoothed estimate against R."""
    ends = np.cumsum(assembly.heights)
    total = np.concatenate(([0.0], np.cumsum(rows.r**2)))
    squares = total[ends] - total[ends - assembly.heights]
    weights: Array = (rows.status == 0).astype(np.float64)
    weights[squares > thresholds(assembly, gates)] = 0.0
    return weights


def count_rejected(assembly: Assembly, weights: Array) -> dict[str, int]:
    """Observations left out, by sensor."""
    return assembly.by_sensor(weights == 0)
