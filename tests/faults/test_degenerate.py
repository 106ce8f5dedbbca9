"""Geometry that no model can linearise, said by name; numbers beyond floats; starts without end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import draw_block
from examples import BEACONS, EXAMPLES, DynamicsExample, SensorExample, stereo
from passes import ZHANG
from relnav_factors.dynamics.eccentric_relative_motion import EccentricRelativeMotion
from relnav_factors.dynamics.euler_rotation import EulerRotation
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from relnav_factors.sensors.beacon_los import BeaconLineOfSight
from relnav_factors.sensors.earth_sensor import EarthSensor
from relnav_factors.sensors.gps_pseudorange import GpsPseudorange
from relnav_factors.sensors.laser_range_angles import LaserRangeAngles

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Block
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.estimators import run_estimator, try_estimator
from relnav_graph.maths.orbit import KeplerOrbit
from relnav_graph.runs.comparison import compare
from relnav_graph.runs.passes import open_pass
from relnav_graph.scenario.build import load_scenario

ONE = np.zeros(1, dtype=np.int64)
MODELS = [(kind, i) for kind, all_ in EXAMPLES.items() for i in range(len(all_))]
LASER = LaserRangeAngles(range_sigma=0.1, angle_sigma=1e-3, axes="orbital")


def placed(block: Block, size: float, rng: np.random.Generator) -> Array:
    """An attitude, or a vector of components of that size."""
    if block.manifold == "SO3":
        return draw_block(block, rng, "moderate")
    return size * np.where(rng.random(block.dim) < 0.5, -1.0, 1.0)


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-20, 1e12, 1e60, 1e200])
@pytest.mark.parametrize(("kind", "i"), MODELS)
def test_row_47_no_state_makes_a_kernel_fail_without_a_word(kind: str, i: int, size: float) -> None:
    """Finite numbers, or a GeometryError in words; never a kernel blamed for its geometry."""
    rng, example = np.random.default_rng(47), EXAMPLES[kind][i]
    model: Any = example.model
    if isinstance(example, SensorExample):
        ids = model.observables()
        seen = example.draw(rng, "near")
        z = model.predict(ids, *seen)
        x = [placed(b, size, rng) for b in model.reads]
        run = lambda: model.residual(Measurement("s", 1.0, z, ids), *x)  # noqa: E731
    elif isinstance(example, DynamicsExample):
        x = [placed(b, size, rng) for b in model.advances + model.reads]
        u = np.array([[2.0, *np.full(sum(len(c) for c in model.inputs.values()), 0.01)]])
        run = lambda: model.transition(1.0, u, *x)  # noqa: E731
    else:
        return
    try:
        run()
    except GeometryError as error:
        assert "status" not in str(error)  # noqa: PT017
