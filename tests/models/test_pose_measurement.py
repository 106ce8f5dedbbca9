"""The measured pose of the chaser, or of a body mounted on it, relative to the target."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from example_makers import MOUNTED
from relnav_factors.sensors.pose_measurement import PoseMeasurement

from relnav_graph.core.conformance.draws import draw_blocks
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.maths import so3

ONE = np.zeros(1, dtype=np.int64)


def model(pose: Literal["orbital", "target"]) -> PoseMeasurement:
    return PoseMeasurement(
        position_sigma=np.full(3, 0.01), attitude_sigma=np.full(3, 0.01), pose=pose, **MOUNTED
    )


@pytest.mark.parametrize("pose", ["orbital", "target"])
def test_it_is_the_place_and_the_axes_of_the_body_in_the_target(
    pose: Literal["orbital", "target"],
) -> None:
    one, rng = model(pose), np.random.default_rng(1)
    for _ in range(5):
        *attitudes, r = draw_blocks(one.reads)(rng, "moderate")
        R_oc, R_ot = (*attitudes, np.eye(3))[:2]
        z = one.predict(ONE, *attitudes, r)[0]
        place_t = R_ot.T @ (r + R_oc @ MOUNTED["sensor_position"])
        np.testing.assert_allclose(z[:3], place_t, rtol=1e-12)
        axes = R_ot.T @ R_oc @ MOUNTED["sensor_attitude"]
        np.testing.assert_allclose(so3.from_quaternion(z[3:]), axes, atol=1e-12)


@pytest.mark.parametrize("pose", ["orbital", "target"])
def test_one_measurement_tells_the_whole_pose(pose: Literal["orbital", "target"]) -> None:
    one, rng = model(pose), np.random.default_rng(2)
    x = draw_blocks(one.reads)(rng, "large")
    z = one.predict(ONE, *x)
    known = {} if pose == "target" else {"chaser_attitude": x[0]}
    (start,) = one.starts(ONE, z, known)
    values = [(known | start)[b.name] for b in one.reads]
    r, _ = one.residual(Measurement("s", 0.0, z, ONE), *values)
    assert np.abs(r).max() < 1e-9
    assert not list(model("orbital").starts(ONE, z, {}))  # the chaser's own is seen by others


def test_a_quaternion_that_is_none_is_refused() -> None:
    z = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 2.0]])
    with pytest.raises(InputError, match=r"pose_measurement: found .*expected a unit quaternion"):
        model("target").accept(z)
