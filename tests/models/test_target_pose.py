"""The pose of the target in the axes of the camera that sees it."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from example_makers import MOUNTED
from relnav_factors.sensors.pose_measurement import PoseMeasurement
from relnav_factors.sensors.target_pose import TargetPose
from scipy.spatial.transform import Rotation

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.draws import draw_blocks
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.io.poses import Motion

ONE = np.zeros(1, dtype=np.int64)
SIGMAS: dict[str, Any] = {"position_sigma": np.full(3, 0.01), "attitude_sigma": np.full(3, 0.02)}
Pose = Literal["orbital", "target"]


def drawn(pose: Pose, seed: int) -> tuple[TargetPose, list[Any], Array]:
    one = TargetPose(pose=pose, **SIGMAS, **MOUNTED)
    x = draw_blocks(one.reads)(np.random.default_rng(seed), "moderate")
    return one, list(x), one.predict(ONE, *x)


@pytest.mark.parametrize("pose", ["orbital", "target"])
def test_it_is_where_the_target_is_in_the_camera(pose: Pose) -> None:
    for seed in range(5):
        one, x, z = drawn(pose, seed)
        R_oc, R_ot = (x[0], x[1]) if pose == "orbital" else (x[0], np.eye(3))
        r_tc, R_os = x[-1], R_oc @ MOUNTED["sensor_attitude"]
        place_s = -R_os.T @ (r_tc + R_oc @ MOUNTED["sensor_position"])
        np.testing.assert_allclose(z[0, :3], place_s, rtol=1e-12)
        R_st = Rotation.from_quat(z[0, 3:], scalar_first=True).as_matrix()
        np.testing.assert_allclose(R_st, R_os.T @ R_ot, atol=1e-12)
        assert one.accept(z).shape == (1, 7)


@pytest.mark.parametrize("pose", ["orbital", "target"])
def test_one_measurement_tells_the_whole_pose(pose: Pose) -> None:
    one, x, z = drawn(pose, 2)
    known = {} if pose == "target" else {"chaser_attitude": x[0]}
    (start,) = one.starts(ONE, z, known)
    values = [(known | start)[b.name] for b in one.reads]
    r, _ = one.residual(Measurement("s", 0.0, z, ONE), *values)
    assert np.abs(r).max() < 1e-9


def test_its_noise_is_that_of_a_measured_pose() -> None:
    """As a covariance of a file is: of the place in s, and of turns about the axes of t."""
    one, x, z = drawn("target", 3)
    e = np.array([[0.0, 0.0, 0.3, 0.2, 0.0, 0.0]])
    seen = one.perturb(z, e)
    turned = Rotation.from_quat(z[0, 3:], scalar_first=True) * Rotation.from_rotvec([0.2, 0, 0])
    got = Rotation.from_quat(seen[0, 3:], scalar_first=True)
    assert (got.inv() * turned).magnitude() < 1e-12
    np.testing.assert_allclose(seen[0, :3] - z[0, :3], [0, 0, 0.3], atol=1e-12)
    r, _ = one.residual(Measurement("s", 0.0, seen, ONE), *x)
    np.testing.assert_allclose(r.ravel(), -e[0], atol=1e-12)


@pytest.mark.parametrize("turned", [False, True])
def test_a_covariance_of_the_inverse_weighs_the_same(turned: bool) -> None:
    """A pose with a full covariance tells a state the same, whichever way round it is read; with a
    covariance that was not turned round it does not."""
    x = [Rotation.from_rotvec([0.3, -0.4, 1.0]).as_matrix(), np.array([4.0, -7.0, 2.0])]
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * np.array([0.01] * 3 + [0.02] * 3)[:, None]
    P = root @ root.T + 1e-6 * np.eye(6)
    camera, body = (
        cls(pose="target", **SIGMAS, **MOUNTED) for cls in (TargetPose, PoseMeasurement)
    )
    z = camera.predict(ONE, *x)
    R = Rotation.from_quat(z[:, 3:], scalar_first=True).as_matrix()
    pose = {"position": z[:, :3], "attitude": R}
    back = Motion(np.zeros(1), pose, lambda k: "", {"pose": P[None]}).inverse()
    other = back.covariances["pose"][0] if turned else P
    found = list[Array]()
    for sensor, own in ((camera, P), (body, other)):
        _, slopes = sensor.residual(Measurement("s", 0.0, sensor.predict(ONE, *x), ONE), *x)
        H = np.hstack([slope.reshape(6, 3) for slope in slopes])
        found.append(H.T @ np.linalg.solve(own, H))
    a, b = found
    assert np.allclose(a, b, rtol=1e-6, atol=1e-6 * np.abs(a).max()) == turned


def test_a_turn_of_the_camera_moves_where_it_is_in_the_target() -> None:
    """A place at 10 m, seen with 0.02 rad: what the two sensors say of it."""
    x = [np.eye(3), np.array([10.0, 0.0, 0.0])]
    across = np.hypot(0.01, 10 * 0.02)
    for cls, expected in (
        (PoseMeasurement, [0.01, 0.01, 0.01]),
        (TargetPose, [0.01, across, across]),
    ):
        one = cls(pose="target", **SIGMAS)
        m = Measurement("s", 0.0, one.predict(ONE, *x), ONE)
        _, slopes = one.residual(m, *x)
        H = np.hstack([slope.reshape(6, 3) for slope in slopes])
        P = np.linalg.inv(H.T @ np.linalg.solve(one.noise(m)[0], H))
        np.testing.assert_allclose(np.sqrt(np.diag(P)[3:]), expected, rtol=1e-9)


def test_a_quaternion_that_is_none_is_refused() -> None:
    z = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 2.0]])
    with pytest.raises(InputError, match=r"target_pose: found .*expected a unit quaternion"):
        TargetPose(pose="target", **SIGMAS).accept(z)
