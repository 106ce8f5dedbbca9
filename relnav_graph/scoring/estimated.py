"""What a pass tells without truth, as numbers: estimates with their sigmas, and residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.state import Block
from relnav_graph.core.track import Innovations, Track
from relnav_graph.maths import so3
from relnav_graph.scoring.deviations import StateEstimates, chi2_band

__all__ = ["component_names", "estimate_row", "innovation_sums", "sensor_rows"]


def component_names(block: Block) -> tuple[str, ...]:
    """Of a value as people read it: w, x, y, z of a quaternion, x, y, z, or numbers of what has no
    axes, such as ratios."""
    if block.manifold == "SO3":
        return ("w", "x", "y", "z")
    if block.dim == 3 and block.unit != "1":
        return ("x", "y", "z")
    return tuple(str(k + 1) for k in range(block.dim))


def _value(block: Block, value: Array) -> list[float]:
    """One value (3, 3) or (dim,) in table units, an attitude as a quaternion, w first, w >= 0."""
    if block.manifold == "SO3":
        return [float(v) for v in so3.quaternion(np.ascontiguousarray(value))]
    return [float(v) for v in block.table_scale * value]


def estimate_row(state: StateEstimates, t: Array) -> dict[str, Any]:
    """``{"estimate": {...}}`` of a state at the last of its epochs, at times t (N,), s.

    t; components: their names; value: in table units, an attitude as a quaternion (Hamilton, scalar
    first); sigma: 1-sigma in table units, of an attitude about the axes of its right frame. {} for
    a family of blocks, and where it is not finite.
    """
    if state.members or not len(t):
        return {}
    variance = np.diagonal(state.P[-1])
    if not (np.isfinite(state.value[-1]).all() and np.isfinite(variance).all()):
        return {}
    block, sigma = state.block, state.block.table_scale * np.sqrt(np.maximum(variance, 0))
    one = {"t": float(t[-1]), "components": list(component_names(block))}
    return {"estimate": one | {"value": _value(block, state.value[-1]), "sigma": sigma.tolist()}}


def innovation_sums(i: Innovations) -> dict[str, float]:
    """Sums over a pass: NIS = sum_k v_k^T v_k, and the lag product sum_k v_k^T v_k-1 of
    whitened innovations v, over the residual rows that both epochs have."""
    shared = np.minimum(i.rows[1:], i.rows[:-1])
    pairs = zip(i.offsets[:-2], i.offsets[1:-1], shared, strict=True)
    product = sum(float(i.v[a : a + m] @ i.v[b : b + m]) for a, b, m in pairs)
    return {
        "nis": float(i.nis.sum()),
        "rows": int(i.rows.sum()),
        "lag_product": product,
        "lag_rows": int(shared.sum()),
    }


def _sensor(i: Innovations, white: bool) -> dict[str, Any]:
    sums = innovation_sums(i)
    rows, lag_rows = int(sums["rows"]), int(sums["lag_rows"])
    nis = sums["nis"] / rows
    found: dict[str, Any] = {"rows": rows, "nis": nis if math.isfinite(nis) else None}
    if not white:
        return found
    edge = 1.96 / math.sqrt(lag_rows) if lag_rows else None
    lag = sums["lag_product"] / lag_rows if lag_rows else None
    return found | {
        "nis_band": list(chi2_band(rows)),
        "lag_correlation": lag if lag is not None and math.isfinite(lag) else None,
        "lag_band": None if edge is None else [-edge, edge],
    }


def sensor_rows(track: Track) -> dict[str, Any]:
    """``{"sensors": {...}}``: by sensor, how many residual rows were used, and their mean square in
    units of what is expected of them, nis; {} without any.

    Of a filter: innovations, with the 95 % band of independent rows, and the correlation with the
    epoch before. Of a smoother: standardised residuals, which depend on each other, without bands.
    """
    white = track.kind == "filtered"
    found: Mapping[str, Any] = {
        name: _sensor(i, white) for name, i in track.innovations.items() if len(i.v)
    }
    return {"sensors": found} if found else {}
