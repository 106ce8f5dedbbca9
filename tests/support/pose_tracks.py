"""Tracks of a pose with a full covariance, for what writes poses and reads them."""

from __future__ import annotations

from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import (
    BODY_RATE,
    CHASER_ATTITUDE,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    RELATIVE_VELOCITY_T,
    TARGET_ATTITUDE,
)
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.maths import dense, so3

IN_TARGET = Layout([RELATIVE_ATTITUDE, RELATIVE_POSITION_T, RELATIVE_VELOCITY_T, BODY_RATE])
IN_ORBIT = Layout([CHASER_ATTITUDE, TARGET_ATTITUDE, RELATIVE_POSITION])


def rotations(count: int, rng: np.random.Generator) -> Array:
    """(count, 3, 3), of any attitude."""
    vectors = rng.normal(size=(count, 3))
    return dense.stacked((so3.exp(v) for v in vectors), 3, 3)


def pose_track(layout: Layout = IN_TARGET, count: int = 6, seed: int = 0, **changes: Any) -> Track:
    """Random states with covariances whose parts differ, at times with many digits."""
    rng = np.random.default_rng(seed)
    parts = [
        rotations(count, rng).reshape(count, 9)
        if block.manifold == "SO3"
        else rng.normal(size=(count, block.dim))
        for block in layout
    ]
    roots = rng.normal(size=(count, layout.dim, layout.dim)) * rng.uniform(0.01, 0.1, layout.dim)
    P = roots @ roots.transpose(0, 2, 1)
    t = np.rint(1e9 * (0.1 * np.arange(count) + rng.uniform(0, 0.05, count))) / 1e9
    made: dict[str, Any] = {
        "name": "batch",
        "kind": "smoothed",
        "layout": layout,
        "t": t,
        "P": P,
    } | changes
    return Track(x=np.hstack(parts), **made)
