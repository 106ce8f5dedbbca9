"""Which observations to use: the chi-square gate, the same for filter and smoothers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from relnav_graph.assembly import Assembly, MeasurementRows

__all__ = ["count_rejected", "innovation_weights", "residual_weights"]

Array = NDArray[np.float64]


def _thresholds(assembly: Assembly, gates: Mapping[str, float]) -> Array:
    """Squared normalised residual above which an observation is left out, (observations,)."""
    out = np.full(assembly.observations, np.inf)
    for name, part, rows in assembly.sensor_parts:
        if name in gates:
            out[part] = chdtri(rows, 1.0 - gates[name])
    return out


def innovation_weights(
    assembly: Assembly, rows: MeasurementRows, P: Array, gates: Mapping[str, float]
) -> Array:
    """1 or 0 for each observation of one epoch, by its innovation against H P H^T + R."""
    weights: Array = (rows.status == 0).astype(np.float64)
    if not gates:
        return weights
    limits = _thresholds(assembly, gates)
    for i, (start, stop) in enumerate(assembly.observation_rows):
        if weights[i] and np.isfinite(limits[i]):
            H, r = rows.H[start:stop], rows.r[start:stop]
            S = H @ P @ H.T + np.eye(len(r))  # the rows are whitened: R = I
            weights[i] = float(r @ np.linalg.solve(S, r) <= limits[i])
    return weights


def residual_weights(
    assembly: Assembly, rows: MeasurementRows, gates: Mapping[str, float]
) -> Array:
    """1 or 0 for each observation, by its residual at a smoothed estimate against R."""
    limits = _thresholds(assembly, gates)
    total = np.concatenate(([0.0], np.cumsum(rows.r**2)))
    squares = np.diff(total[assembly.observation_rows], axis=1)[:, 0]
    weights: Array = ((rows.status == 0) & (squares <= limits)).astype(np.float64)
    return weights


def count_rejected(assembly: Assembly, weights: Array) -> dict[str, int]:
    """Observations left out, by sensor."""
    return {name: int((weights[part] == 0).sum()) for name, part, _ in assembly.sensor_parts}
