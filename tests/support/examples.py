"""One or more examples of every model, for the tests that walk all models.

To add a model, add its kind to `EXAMPLES` below: instances that together use every option, and,
for a process, the diffusion of its white noise. States and inputs are drawn from
`draws.SCALES`; a sensor that needs a sensible geometry brings its own `draw`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from draws import PLACES, draw_block, draw_blocks
from example_kinds import DerivedExample, DynamicsExample, Example, SensorExample, with_variants
from relnav_factors.derived import relative_pose
from relnav_factors.derived.inertia_ratios import InertiaMatrixRatios, InertiaRatios
from relnav_factors.derived.principal_axes import PrincipalAxes, PrincipalRatios
from relnav_factors.derived.whole_bias import (
    WholeAbsoluteAccelerometerBias,
    WholeAccelerometerBias,
    WholeEarthSensorBias,
    WholeGyroBias,
)
from relnav_factors.dynamics.accelerometer_bias import AccelerometerBias
from relnav_factors.dynamics.body_velocity import BodyVelocity
from relnav_factors.dynamics.earth_sensor_bias import EarthSensorBias
from relnav_factors.dynamics.eccentric_relative_motion import EccentricRelativeMotion
from relnav_factors.dynamics.euler_rotation import EulerRotation
from relnav_factors.dynamics.gravity_gradient_rotation import GravityGradientRotation
from relnav_factors.dynamics.gyro_bias import GyroBias
from relnav_factors.dynamics.inertial_orbit_motion import InertialOrbitMotion
from relnav_factors.dynamics.inertial_relative_motion import InertialRelativeMotion
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.dynamics.previous_pose import PreviousPose
from relnav_factors.dynamics.receiver_clock import ReceiverClock
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from relnav_factors.sensors.attitude_odometry import AttitudeOdometry
from relnav_factors.sensors.beacon_los import BeaconLineOfSight
from relnav_factors.sensors.earth_sensor import EarthSensor
from relnav_factors.sensors.gps_position import GpsPosition
from relnav_factors.sensors.gps_pseudorange import GpsPseudorange
from relnav_factors.sensors.laser_range_angles import LaserRangeAngles
from relnav_factors.sensors.mono_point import MonoPoint
from relnav_factors.sensors.pose_copy import PoseCopy
from relnav_factors.sensors.pose_odometry import PoseOdometry
from relnav_factors.sensors.star_tracker import StarTracker
from relnav_factors.sensors.stereo_point import StereoPoint, StereoPointCartesian
from relnav_factors.sensors.vision_attitude import VisionAttitude

from relnav_graph.arrays import Array
from relnav_graph.maths import so3
from relnav_graph.maths.orbit import KeplerOrbit

BEACONS = np.array(
    [[0.5, 0.5, 0], [-0.5, -0.5, 0], [-0.5, 0.5, 0], [0.2, 0.5, 0.1], [0, 0.2, -0.1]]
)
MOUNTED: dict[str, Any] = {
    "sensor_attitude": so3.exp(np.array([0.3, -1.1, 0.7])),
    "sensor_position": np.array([0.4, -0.2, 0.1]),
}
HU_INERTIA = np.array([[1000.0, 60, 40], [60, 800, 30], [40, 30, 600]])
LOW = KeplerOrbit(7.2e6, 0.05, 0.3)
HYPERBOLA = KeplerOrbit(-2.0e7, 1.4, -1.0)


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
    return DynamicsExample(model, constant(*squares[:count]), {"gyro": 3})


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


def odometry(**options: Any) -> SensorExample:
    model = PoseOdometry(
        position_sigma=np.array([5e-3, 4e-3, 6e-3]), attitude_sigma=np.full(3, 0.01), **options
    )
    places = {"previous_relative_position": 1.0, "relative_position": 1.0}
    steps = {b.name: 0.1 for b in model.reads} | places
    return SensorExample(model, draw_blocks(model.reads), step=steps, least_large=1.0)


def copy(**options: Any) -> DynamicsExample:
    return DynamicsExample(PreviousPose(**options), constant(*[0.0] * 9), flow=False)


def orbit(degree: Any, **options: Any) -> DynamicsExample:
    walk = options.get("position_density", 0.0) ** 2
    model = OrbitTwoBody(acceleration_density=0.01, degree=degree, **options)
    return DynamicsExample(model, constant(*[walk] * 3, 1e-4, 1e-4, 1e-4))


def relative_two_body(degree: Any, **options: Any) -> DynamicsExample:
    model = RelativeTwoBody(acceleration_density=1e-3, degree=degree, **options)
    companion = OrbitTwoBody(acceleration_density=0.01, degree=degree)
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
    return DynamicsExample(model, constant(0, 0, 0, 1e-12, 1e-12, 1e-12))


def rotation(inertia_density: float = 1e-4, **options: Any) -> DynamicsExample:
    model = EulerRotation(torque_density=1e-5, inertia_density=inertia_density, **options)
    ratios = sum(b.dim for b in model.advances[2:])
    return DynamicsExample(model, constant(0, 0, 0, *[1e-10] * 3, *[1e-8] * ratios))


def pulled(**options: Any) -> DynamicsExample:
    model = GravityGradientRotation(
        torque_density=1e-5, known_inertia=HU_INERTIA, semi_major_axis=7.2e6, **options
    )
    return DynamicsExample(model, constant(0, 0, 0, *[1e-10] * 3))


def constant_velocity(**options: Any) -> DynamicsExample:
    model = WhiteNoiseAcceleration(acceleration_density=1e-3, **options)
    return DynamicsExample(model, constant(0, 0, 0, 1e-6, 1e-6, 1e-6))


_EXAMPLES: Mapping[str, tuple[Example, ...]] = {
    "attitude_odometry": (
        attitude_sensor(AttitudeOdometry(sigma=np.full(3, 0.01))),
        attitude_sensor(AttitudeOdometry(sigma=np.full(3, 0.01), keyframe=-2.0, pose="target")),
        attitude_sensor(
            AttitudeOdometry(
                sigma=np.array([0.01, 0.02, 0.03]),
                pose="target",
                sensor_attitude=MOUNTED["sensor_attitude"],
            )
        ),
    ),
    "beacon_los": (
        point_sensor(BeaconLineOfSight(points=BEACONS, sigma=1e-3), anywhere=True),
        point_sensor(BeaconLineOfSight(points=BEACONS, sigma=1e-5, **MOUNTED), anywhere=True),
        point_sensor(
            BeaconLineOfSight(points=BEACONS, sigma=1e-3, pose="target", **MOUNTED), anywhere=True
        ),
    ),
    "gps_position": (
        position_sensor(GpsPosition(sigma=np.full(3, 10.0))),
        position_sensor(
            GpsPosition(
                sigma=np.array([3.0, 4.0, 5.0]), antenna_position=np.array([0.4, -1.2, 2.0])
            )
        ),
    ),
    "gps_pseudorange": (pseudorange(),),
    "earth_sensor": (
        earth_sensor(),
        earth_sensor(sensor_attitude=MOUNTED["sensor_attitude"]),
        earth_sensor(drift=True),
    ),
    "laser_range_angles": (
        laser(),
        laser(axes="orbital"),
        laser(sensor_attitude=MOUNTED["sensor_attitude"]),
    ),
    "mono_point": (
        point_sensor(mono()),
        point_sensor(mono(**MOUNTED)),
        point_sensor(mono(pose="target", **MOUNTED)),
    ),
    "star_tracker": (
        attitude_sensor(StarTracker(sigma=np.full(3, 2e-3))),
        attitude_sensor(
            StarTracker(
                sigma=np.array([1e-4, 1e-4, 1e-3]), sensor_attitude=MOUNTED["sensor_attitude"]
            )
        ),
    ),
    "pose_copy": (
        attitude_sensor(PoseCopy(keyframe=12.5), relative_position=1.0),
        attitude_sensor(PoseCopy(keyframe=0.0, pose="target", position_sigma=1e-3)),
        attitude_sensor(PoseCopy(keyframe=3.0, parts="attitudes", attitude_sigma=1e-3)),
    ),
    "pose_odometry": (
        odometry(scene_centre=np.array([2.0, 0.1, -0.3])),
        odometry(pose="target", scene_centre=np.array([2.0, 0.1, -0.3]), **MOUNTED),
        odometry(**MOUNTED),
        odometry(keyframe=-30.0),
    ),
    "stereo_point": (
        point_sensor(stereo()),
        point_sensor(stereo(**MOUNTED)),
        point_sensor(stereo(pose="target", **MOUNTED)),
    ),
    "stereo_point_cartesian": (
        point_sensor(
            StereoPointCartesian(points=BEACONS, sigma=np.array([0.01, 0.02, 0.05]), **MOUNTED)
        ),
        point_sensor(
            StereoPointCartesian(points=BEACONS, sigma=np.full(3, 0.01), pose="target", **MOUNTED)
        ),
    ),
    "accelerometer_bias": (
        forgetting(AccelerometerBias, 1e-4),
        forgetting(AccelerometerBias, 1e-4, navigation="absolute"),
        forgetting(AccelerometerBias, 1e-4, part="drift"),
        forgetting(AccelerometerBias, 1e-4, navigation="absolute", part="drift"),
    ),
    "earth_sensor_bias": (
        forgetting(EarthSensorBias, 1e-4),
        forgetting(EarthSensorBias, 1e-4, part="drift"),
    ),
    "inertial_orbit_motion": (
        driven(InertialOrbitMotion, "absolute"),
        driven(InertialOrbitMotion, "relative", degree=0, max_step=2.5),
        driven(InertialOrbitMotion, "absolute", gyro_drift=True),
        driven(InertialOrbitMotion, "absolute", gyro_drift=True, accelerometer_drift=True),
    ),
    "inertial_relative_motion": (
        driven(InertialRelativeMotion, "relative", own_orbit("relative", 2)),
        driven(InertialRelativeMotion, "absolute", own_orbit("absolute", 3), degree=3),
        *(
            driven(
                InertialRelativeMotion,
                "relative",
                own_orbit("relative", 2, **drifts),
                **drifts,
            )
            for drifts in (
                {"gyro_drift": True, "accelerometer_drift": True},
                {"accelerometer_drift": True},
            )
        ),
    ),
    "receiver_clock": (
        DynamicsExample(
            ReceiverClock(phase_density=0.1, frequency_density=0.02), constant(0.01, 4e-4)
        ),
        DynamicsExample(ReceiverClock(phase_density=0.1), constant(0.01)),
    ),
    "body_velocity": (
        body_velocity("orbital", [0.1, 0.2, 0.05], "chaser_attitude"),
        body_velocity("target", 0.1, "relative_attitude"),
    ),
    "eccentric_relative_motion": (
        relative_motion(orbit=LOW),
        relative_motion(orbit=LOW, gravity="linear"),
        relative_motion(orbit=HYPERBOLA, max_step=2.5),
    ),
    "euler_rotation": (
        rotation(orbit=LOW),
        rotation(max_step=0.5),
        rotation(inertia="full", orbit=LOW),
        rotation(inertia="known", known_inertia=HU_INERTIA),
        rotation(inertia="full", integrator="euler", max_step=0.2, rate="body_rate"),
        rotation(inertia_density=0.0, orbit=LOW),
        rotation(inertia_density=0.0, inertia="full"),
    ),
    "gravity_gradient_rotation": (
        pulled(),
        pulled(eccentricity=0.05, true_anomaly=0.3, inclination=0.9, raan=2.1, max_step=0.5),
    ),
    "gyro_bias": (
        gyro(1e-4, 1e-6, orbit=LOW),
        gyro([1e-4, 3e-4, 2e-4], [1e-4, 2e-4, 3e-4]),
        gyro(1e-4, 1e-4, attitude="relative_attitude"),
        gyro(1e-4, 1e-4, bias_time_constant=600.0, samples="together"),
        gyro(1e-4, 0.0, orbit=LOW),
        gyro(1e-4, 1e-4, bias_time_constant=600.0, part="drift"),
        gyro(1e-4, 1e-4, part="drift", samples="together", orbit=LOW),
    ),
    "orbit_two_body": (
        orbit(0, position_density=0.1),
        orbit(4),
        orbit(2, max_step=2.5),
    ),
    "previous_pose": (
        copy(),
        copy(pose="target", attitude_sigma=1e-3, position_sigma=1e-3),
        copy(period=7.0),
    ),
    "relative_two_body": (
        relative_two_body(0),
        relative_two_body(3, max_step=5.0),
    ),
    "vision_attitude": tuple(
        attitude_sensor(VisionAttitude(sigma=np.full(3, 8e-3), seen_from=where, **turned))
        for where in ("orbital", "target", "fixed")
        for turned in ({}, {"sensor_attitude": MOUNTED["sensor_attitude"]})
    ),
    "white_noise_acceleration": (
        constant_velocity(),
        constant_velocity(pose="target"),
    ),
    "inertia_matrix_ratios": (DerivedExample(InertiaMatrixRatios()),),
    "inertia_ratios": (DerivedExample(InertiaRatios()),),
    "position_in_target": (DerivedExample(relative_pose.PositionInTarget()),),
    "principal_axes": (DerivedExample(PrincipalAxes()),),
    "principal_ratios": (DerivedExample(PrincipalRatios()),),
    "relative_attitude": (DerivedExample(relative_pose.RelativeAttitude()),),
    "whole_absolute_accelerometer_bias": (DerivedExample(WholeAbsoluteAccelerometerBias()),),
    "whole_accelerometer_bias": (DerivedExample(WholeAccelerometerBias()),),
    "whole_earth_sensor_bias": (DerivedExample(WholeEarthSensorBias()),),
    "whole_gyro_bias": (DerivedExample(WholeGyroBias()),),
    "target_rate_in_chaser": (DerivedExample(relative_pose.TargetRateInChaser()),),
}

EXAMPLES = {kind: with_variants(examples) for kind, examples in _EXAMPLES.items()}
