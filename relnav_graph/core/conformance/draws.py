"""Values of blocks, drawn near the identity, moderately, and far from everything."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.state import Block
from relnav_graph.maths import so3

__all__ = ["REGIMES", "Draw", "draw_block", "draw_blocks", "scale_of", "sizes"]

Draw = Callable[[np.random.Generator, str], tuple[Array, ...]]

#: near: attitudes near the identity, short intervals, small residuals; moderate; large:
#: any attitude, rates up to 1 rad/s, long intervals, residuals over 1 rad or 10 sigma.
REGIMES = ("near", "moderate", "large")

#: Size of a component of a block or input in each regime, SI; 1 for what is not listed.
SCALES: Mapping[str, tuple[float, float, float]] = {
    "relative_position": (1.0, 100.0, 1000.0),
    "previous_relative_position": (1.0, 100.0, 1000.0),
    "relative_velocity": (0.01, 0.5, 5.0),
    "chaser_position": (1e4, 1e5, 1e6),
    "chaser_velocity": (100.0, 20.0, 1000.0),
    "orbit_radius": (1e4, 1e5, 5e5),
    "orbit_radial_rate": (100.0, 50.0, 500.0),
    "orbit_angle": (1e-3, 1.0, 10.0),
    "orbit_angular_rate": (1e-5, 1e-5, 1e-4),
    "target_rate": (1e-4, 0.05, 0.5),
    "gyro_bias": (1e-7, 1e-5, 1e-2),
    "body_rate": (1e-4, 0.05, 0.15),  # Euler's steps diverge at more
    "inertia_parameters": (0.01, 0.4, 1.0),
    "inertia_matrix_parameters": (0.01, 0.2, 0.5),
    "accelerometer_bias": (1e-6, 1e-4, 1e-2),
    "absolute_accelerometer_bias": (1e-6, 1e-4, 1e-2),
    "gyro_drift": (1e-7, 1e-5, 1e-2),
    "accelerometer_drift": (1e-6, 1e-4, 1e-2),
    "absolute_accelerometer_drift": (1e-6, 1e-4, 1e-2),
    "earth_sensor_drift": (1e-5, 1e-3, 1e-2),
    "range_bias": (1e-3, 0.1, 1.0),
    "range_drift": (1e-3, 0.1, 1.0),
    "range_rate_bias": (1e-5, 1e-3, 0.1),
    "range_rate_drift": (1e-5, 1e-3, 0.1),
    "clock_bias": (1.0, 1e3, 1e4),
    "clock_drift": (0.01, 0.1, 10.0),
    "earth_sensor_bias": (1e-5, 1e-3, 1e-2),
    "gyro": (1e-4, 0.05, 0.5),
    "accelerometer": (1e-3, 0.03, 0.5),
    "velocity": (0.01, 0.5, 5.0),
}


#: About which the components are drawn, where that is not zero: an orbit is no orbit at
#: the centre of the Earth.
PLACES: Mapping[str, Array] = {
    "chaser_position": np.array([3.1e6, -4.9e6, 4.2e6]),
    "orbit_radius": np.array([7.2e6]),
    "orbit_angular_rate": np.array([1.03e-3]),
}


def scale_of(name: str, regime: str) -> float:
    """Size of a component of a block or an input, SI."""
    return SCALES.get(name, (1.0, 1.0, 1.0))[REGIMES.index(regime)]


def draw_block(block: Block, rng: np.random.Generator, regime: str) -> Array:
    """A value of a block, (3, 3) or (dim,), SI; now and then an attitude is the identity."""
    if block.manifold == "SO3":
        if regime == "near":
            return np.eye(3) if rng.random() < 0.1 else so3.exp(1e-3 * rng.normal(size=3))
        return so3.exp((1.0 if regime == "moderate" else 3.0) * rng.normal(size=3))
    spread = scale_of(block.name, regime) * rng.normal(size=block.dim)
    return np.asarray(PLACES.get(block.name, 0.0) + spread)


def draw_blocks(blocks: Iterable[Block]) -> Draw:
    """Draws values of blocks, one for each."""
    return lambda rng, regime: tuple(draw_block(b, rng, regime) for b in blocks)


def sizes(blocks: Iterable[Block], regime: str) -> Array:
    """Size of each tangent component (dims,) in a regime, SI; 1 rad for attitudes."""
    parts = [
        np.full(b.dim, 1.0 if b.manifold == "SO3" else scale_of(b.name, regime)) for b in blocks
    ]
    return np.concatenate(parts)
