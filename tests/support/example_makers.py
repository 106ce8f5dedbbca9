"""How examples of models are made: one function for each form of them; see `examples`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from relnav_factors.dynamics.body_velocity import BodyVelocity
from relnav_factors.dynamics.eccentric_relative_motion import EccentricRelativeMotion
from relnav_factors.dynamics.euler_rotation import EulerRotation
from relnav_factors.dynamics.gravity_gradient_rotation import GravityGradientRotation
from relnav_factors.dynamics.gyro_bias import GyroBias
from relnav_factors.dynamics.inertial_orbit_motion import InertialOrbitMotion
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.dynamics.planar_orbit import PlanarOrbit
from relnav_factors.dynamics.previous_pose import PreviousPose
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from relnav_factors.sensors.earth_sensor import EarthSensor
from relnav_factors.sensors.gps_pseudorange import GpsPseudorange
from relnav_factors.sensors.laser_range_angles import LaserRangeAngles
from relnav_factors.sensors.mono_point import MonoPoint
from relnav_factors.sensors.pose_measurement import PoseMeasurement
from relnav_factors.sensors.pose_odometry import PoseOdometry
from relnav_factors.sensors.stereo_point import StereoPoint

from relnav_graph.arrays import Array
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.core.conformance.draws import PLACES, draw_block, draw_blocks
from relnav_graph.core.conformance.examples import DynamicsExample, SensorExample
from relnav_graph.maths import so3
from relnav_graph.maths.orbit import KeplerOrbit

BEACONS = np.array(
    [[0.5, 0.5, 0], [-0.5, -0.5, 0], [-0.5, 0.5, 0], [0.2, 0.5, 0.1], [0, 0.2, -0.1]]
)
MOUNTED: dict[str, Any] = {
    "sensor_attitude": so3.exp(np.array([0.3, -1.1, 0.7])),
    "sensor_position": np.array([0.4, -0.2, 0.1]),
}
TRIANGLE = np.array([[0.1, -0.2, 0.3], [1.5, -0.2, 0.3], [0.5, 0.9, 0.3]])
HU_INERTIA = np.array([[1000.0, 60, 40], [60, 800, 30], [40, 30, 600]])
LOW = KeplerOrbit(7.2e6, 0.05, 0.3)
HYPERBOLA = KeplerOrbit(-2.0e7, 1.4, -1.0)
ESTIMATED = replace(LOW, estimated=True)


def point_sensor(model: Any, anywhere: bool = False) -> SensorExample:
    """All points ahead of the sensor, 5 to 40 m away; or in any direction."""

    def draw(rng: np.random.Generator, regime: str) -> tuple[Array, ...]:
        depth = rng.uniform(5, 40)
        p_s = depth * np.array([*rng.uniform(-0.4, 0.4, 2), 1.0])
        if anywhere:
            p_s = depth * so3.exp(rng.normal(size=3)) @ np.array([0.0, 0.0, 1.0])
        *attitudes, _ = (draw_block(b, rng, regime) for b in model.reads)
        place_c = model.sensor_attitude @ p_s + model.sensor_position
        return *attitudes, -attitudes[0] @ place_c

    return SensorExample(
        model,
        draw,
        step={"relative_position": 1.0, **{b.name: 0.1 for b in model.reads[:-1]}},
        least_large=1.0 if anywhere else 0.0,
    )


def gyro_model(angle: Any, bias: Any, **options: Any) -> GyroBias:
    return GyroBias(angle_random_walk_density=angle, bias_random_walk_density=bias, **options)


def constant(*diagonal: float) -> Callable[..., Array]:
    return lambda *x: np.diag(np.array(diagonal))


def besides(model: Any) -> tuple[Any, ...]:
    """The process of an orbit that a model reads."""
    known = model.orbit is None or not model.orbit.estimated
    return () if known else (PlanarOrbit(acceleration_density=1e-4, orbit=model.orbit),)


def body_velocity(pose: Any, density: Any, attitude: Any) -> DynamicsExample:
    companion = gyro_model(1e-4, 1e-7, attitude=attitude)
    model = BodyVelocity(velocity_density=density, pose=pose)
    return DynamicsExample(
        model,
        lambda r, R: R @ np.diag(model.velocity_density**2) @ R.T,
        {"velocity": 3, "gyro": 3},
        (companion,),
    )


def stereo(**options: Any) -> StereoPoint:
    sigma = np.array([0.4, 0.5, 0.6, 0.7])
    camera: dict[str, Any] = {"fu": 480.0, "fv": 500.0, "cu": 320.0, "cv": 240.0, "baseline": 0.24}
    return StereoPoint(points=BEACONS, pixel_sigma=sigma, **camera, **options)


def mono(**options: Any) -> MonoPoint:
    camera: dict[str, Any] = {"fu": 480.0, "fv": 500.0, "cu": 320.0, "cv": 240.0}
    return MonoPoint(points=BEACONS, pixel_sigma=np.array([0.4, 0.5]), **camera, **options)


def gyro(angle: Any, bias: Any, **options: Any) -> DynamicsExample:
    model = gyro_model(angle, bias, **options)
    squares = [*model.angle_random_walk_density**2, *model.bias_random_walk_density**2]
    count = sum(b.dim for b in model.advances)
    return DynamicsExample(model, constant(*squares[:count]), {"gyro": 3}, besides(model))


def attitude_sensor(model: Any, **step: float) -> SensorExample:
    steps = {b.name: 0.1 for b in model.reads} | step
    return SensorExample(model, draw_blocks(model.reads), step=steps, least_large=1.0)


def position_sensor(model: Any) -> SensorExample:
    return SensorExample(model, draw_blocks(model.reads), step={"chaser_position": 30.0})


def laser(**options: Any) -> SensorExample:
    """Less than a kilometre away, so that ranges and angles both matter."""
    model = LaserRangeAngles(range_sigma=5.0, range_scale=6e-4, angle_sigma=3e-3, **options)
    steps = {b.name: 0.1 for b in model.reads} | {"relative_position": 3.0}

    def draw(rng: np.random.Generator, regime: str) -> tuple[Array, ...]:
        _, *attitude = (draw_block(b, rng, regime) for b in model.reads)
        line = rng.normal(size=3)
        return rng.uniform(100, 1000) * line / np.linalg.norm(line), *attitude

    return SensorExample(model, draw, step=steps, least_large=1.0)


def ranging(cls: Any, sigma: float, **options: Any) -> SensorExample:
    """At least a hundred metres away: no distance is negative, nor nearly zero."""
    model = cls(sigma=sigma, **options)

    def draw(rng: np.random.Generator, regime: str) -> tuple[Array, ...]:
        _, *rest = (draw_block(b, rng, regime) for b in model.reads)
        line = rng.normal(size=3)
        return rng.uniform(100, 1000) * line / np.linalg.norm(line), *rest

    steps = {b.name: 0.1 for b in model.reads} | {"relative_position": 3.0}
    return SensorExample(model, draw, step=steps)


def odometry(**options: Any) -> SensorExample:
    model = PoseOdometry(
        position_sigma=np.array([5e-3, 4e-3, 6e-3]), attitude_sigma=np.full(3, 0.01), **options
    )
    places = {"previous_relative_position": 1.0, "relative_position": 1.0}
    steps = {b.name: 0.1 for b in model.reads} | places
    return SensorExample(model, draw_blocks(model.reads), step=steps, least_large=1.0)


def pose_measurement(
    made: type[PoseMeasurement] = PoseMeasurement, **options: Any
) -> SensorExample:
    model = made(
        position_sigma=np.array([5e-3, 4e-3, 6e-3]), attitude_sigma=np.full(3, 0.01), **options
    )
    steps = {b.name: 0.1 for b in model.reads} | {"relative_position": 1.0}
    return SensorExample(model, draw_blocks(model.reads), step=steps, least_large=1.0)


def copy(**options: Any) -> DynamicsExample:
    return DynamicsExample(PreviousPose(**options), constant(*[0.0] * 9), flow=False)


#: Gravity that turns with the Earth, Sun and Moon.
TURNING: dict[str, Any] = {
    "order": 20,
    "third_bodies": ("sun", "moon"),
    "clock": AbsoluteTime("2021-07-17T00:00:00 TT"),
}


def orbit(degree: Any, **options: Any) -> DynamicsExample:
    walk = options.get("position_density", 0.0) ** 2
    model = OrbitTwoBody(acceleration_density=0.01, degree=degree, **options)
    return DynamicsExample(model, constant(*[walk] * 3, 1e-4, 1e-4, 1e-4))


def relative_two_body(degree: Any, **options: Any) -> DynamicsExample:
    model = RelativeTwoBody(acceleration_density=1e-3, degree=degree, **options)
    gravity = {name: options[name] for name in TURNING if name in options}
    companion = OrbitTwoBody(acceleration_density=0.01, degree=degree, **gravity)
    return DynamicsExample(model, constant(0, 0, 0, 1e-6, 1e-6, 1e-6), {}, (companion,))


def driven(cls: Any, navigation: Any, *companions: Any, **options: Any) -> DynamicsExample:
    """An orbit with an accelerometer; biases stay as they are over an interval."""
    model = cls(velocity_random_walk_density=5e-4, navigation=navigation, **options)
    diffusion = constant(0, 0, 0, *[2.5e-7] * 3)
    channels = {"gyro": 3, "accelerometer": 3}
    gyro_bias = gyro_model(1e-4, 1e-6, part="drift" if model.gyro_drift else "bias")
    return DynamicsExample(model, diffusion, channels, (*companions, gyro_bias))


def own_orbit(navigation: Any, degree: Any, **drifts: bool) -> InertialOrbitMotion:
    return InertialOrbitMotion(
        velocity_random_walk_density=5e-4, navigation=navigation, degree=degree, **drifts
    )


def forgetting(cls: Any, sigma: float, **options: Any) -> DynamicsExample:
    model = cls(sigma=sigma, time_constant=300.0, **options)
    count = sum(b.dim for b in model.advances)
    return DynamicsExample(model, constant(*[2 * sigma**2 / 300.0] * count))


def pseudorange() -> SensorExample:
    """Satellites over the equator, seen from high above a pole: none is ever hidden."""
    model = GpsPseudorange(
        sigma=30.0, satellites=6, planes=1, inclination=0.0, mask=-np.pi / 2, time=100.0
    )

    def draw(rng: np.random.Generator, regime: str) -> tuple[Array, ...]:
        r_c, bias = (draw_block(b, rng, regime) for b in model.reads)
        return r_c - PLACES["chaser_position"] + np.array([0.0, 0.0, 4e7]), bias

    return SensorExample(model, draw, step={"chaser_position": 30.0, "clock_bias": 30.0})


def earth_sensor(**options: Any) -> SensorExample:
    """The Earth up to a radian off the sensor's axis."""
    model = EarthSensor(sigma=3e-4, **options)

    def draw(rng: np.random.Generator, regime: str) -> tuple[Array, ...]:
        _, r_c, *biases = (draw_block(b, rng, regime) for b in model.reads)
        z_i, off = -r_c / np.linalg.norm(r_c), 0.7 * rng.uniform(-1, 1, 3)
        x_i = np.cross(z_i, rng.normal(size=3))
        x_i /= np.linalg.norm(x_i)
        R_is = np.stack([x_i, np.cross(z_i, x_i), z_i], axis=1) @ so3.exp(off)
        return R_is @ model.sensor_attitude.T, r_c, *biases

    step = {"chaser_attitude": 0.01, "chaser_position": 30.0, "earth_sensor_bias": 1e-3}
    step |= {"earth_sensor_drift": 1e-3} if model.drift else {}
    return SensorExample(model, draw, step=step)


def relative_motion(**options: Any) -> DynamicsExample:
    model = EccentricRelativeMotion(acceleration_density=1e-6, **options)
    return DynamicsExample(model, constant(0, 0, 0, *[1e-12] * 3), companions=besides(model))


def planar_orbit(**options: Any) -> DynamicsExample:
    model = PlanarOrbit(acceleration_density=1e-4, orbit=ESTIMATED, **options)
    return DynamicsExample(
        model, lambda r, *rest: np.diag([0, 1e-8, 0, 1e-8 / r[0] ** 2]).astype(float)
    )


def rotation(inertia_density: float = 1e-4, **options: Any) -> DynamicsExample:
    model = EulerRotation(torque_density=1e-5, inertia_density=inertia_density, **options)
    ratios = sum(b.dim for b in model.advances[2:])
    white = constant(0, 0, 0, *[1e-10] * 3, *[1e-8] * ratios)
    return DynamicsExample(model, white, companions=besides(model))


def pulled(**options: Any) -> DynamicsExample:
    model = GravityGradientRotation(
        torque_density=1e-5, known_inertia=HU_INERTIA, semi_major_axis=7.2e6, **options
    )
    return DynamicsExample(model, constant(0, 0, 0, *[1e-10] * 3))


def constant_velocity(**options: Any) -> DynamicsExample:
    model = WhiteNoiseAcceleration(acceleration_density=1e-3, **options)
    return DynamicsExample(model, constant(0, 0, 0, 1e-6, 1e-6, 1e-6))
