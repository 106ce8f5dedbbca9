"""One or more examples of every model, for the tests that walk all models.

To add a model, add its kind to `EXAMPLES` below: instances that together use every option, and,
for a process, the diffusion of its white noise. States and inputs are drawn from
`draws.SCALES`; a sensor that needs a sensible geometry brings its own `draw`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from example_kinds import with_variants
from example_makers import (
    BEACONS,
    ESTIMATED,
    HU_INERTIA,
    HYPERBOLA,
    LOW,
    MOUNTED,
    TRIANGLE,
    TURNING,
    attitude_sensor,
    body_velocity,
    constant,
    constant_velocity,
    copy,
    driven,
    earth_sensor,
    forgetting,
    gyro,
    laser,
    mono,
    odometry,
    orbit,
    own_orbit,
    planar_orbit,
    point_sensor,
    pose_measurement,
    position_sensor,
    pseudorange,
    pulled,
    ranging,
    relative_motion,
    relative_two_body,
    rotation,
    stereo,
)
from relnav_factors.derived import relative_pose
from relnav_factors.derived.inertia_ratios import InertiaMatrixRatios, InertiaRatios
from relnav_factors.derived.principal_axes import PrincipalAxes, PrincipalRatios
from relnav_factors.derived.whole_bias import (
    WholeAbsoluteAccelerometerBias,
    WholeAccelerometerBias,
    WholeEarthSensorBias,
    WholeGyroBias,
    WholeRangeBias,
    WholeRangeRateBias,
)
from relnav_factors.dynamics.accelerometer_bias import AccelerometerBias
from relnav_factors.dynamics.earth_sensor_bias import EarthSensorBias
from relnav_factors.dynamics.inertial_orbit_motion import InertialOrbitMotion
from relnav_factors.dynamics.inertial_relative_motion import InertialRelativeMotion
from relnav_factors.dynamics.range_bias import RangeBias, RangeRateBias
from relnav_factors.dynamics.receiver_clock import ReceiverClock
from relnav_factors.sensors.attitude_odometry import AttitudeOdometry
from relnav_factors.sensors.beacon_los import BeaconLineOfSight
from relnav_factors.sensors.gps_position import GpsPosition
from relnav_factors.sensors.inter_satellite_range import Range, RangeRate
from relnav_factors.sensors.pose_copy import PoseCopy
from relnav_factors.sensors.position_fix import PositionFix
from relnav_factors.sensors.star_tracker import StarTracker
from relnav_factors.sensors.stereo_point import StereoPointCartesian
from relnav_factors.sensors.target_pose import TargetPose
from relnav_factors.sensors.three_point_attitude import ThreePointAttitude
from relnav_factors.sensors.vision_attitude import VisionAttitude

from relnav_graph.core.conformance.examples import DerivedExample, DynamicsExample, Example

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
    "pose_measurement": (
        pose_measurement(),
        pose_measurement(**MOUNTED),
        pose_measurement(pose="target", **MOUNTED),
    ),
    "target_pose": (
        pose_measurement(TargetPose),
        pose_measurement(TargetPose, **MOUNTED),
        pose_measurement(TargetPose, pose="target", **MOUNTED),
    ),
    "pose_odometry": (
        odometry(scene_centre=np.array([2.0, 0.1, -0.3])),
        odometry(pose="target", scene_centre=np.array([2.0, 0.1, -0.3]), **MOUNTED),
        odometry(**MOUNTED),
        odometry(keyframe=-30.0),
    ),
    "position_fix": (
        position_sensor(PositionFix(sigma=np.full(3, 10.0))),
        position_sensor(PositionFix(sigma=np.array([3.0, 4.0, 5.0]), pose="target")),
    ),
    "range": (
        ranging(Range, 0.01),
        ranging(Range, 0.01, bias=True, pose="target"),
        ranging(Range, 0.01, bias=True, drift=True),
        ranging(Range, 0.01, drift=True),
    ),
    "range_rate": (
        ranging(RangeRate, 1e-3),
        ranging(RangeRate, 1e-3, bias=True, drift=True),
        ranging(RangeRate, 1e-3, drift=True, pose="target"),
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
    "range_bias": (
        forgetting(RangeBias, 0.01),
        forgetting(RangeBias, 0.01, part="drift"),
    ),
    "range_rate_bias": (
        forgetting(RangeRateBias, 1e-4),
        forgetting(RangeRateBias, 1e-4, part="drift"),
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
        relative_motion(orbit=ESTIMATED),
    ),
    "euler_rotation": (
        rotation(orbit=LOW),
        rotation(max_step=0.5),
        rotation(inertia="full", orbit=LOW),
        rotation(inertia="known", known_inertia=HU_INERTIA),
        rotation(inertia="full", integrator="euler", max_step=0.2, rate="body_rate"),
        rotation(inertia_density=0.0, orbit=LOW),
        rotation(inertia_density=0.0, orbit=ESTIMATED),
        rotation(inertia="known", known_inertia=HU_INERTIA, orbit=ESTIMATED),
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
        gyro(1e-4, 1e-6, orbit=ESTIMATED),
        gyro(1e-4, 1e-4, part="drift", orbit=ESTIMATED),
    ),
    "orbit_two_body": (
        orbit(0, position_density=0.1),
        orbit(4),
        orbit(2, max_step=2.5),
        orbit(20, **TURNING),
    ),
    "planar_orbit": (planar_orbit(), planar_orbit(max_step=2.5)),
    "previous_pose": (
        copy(),
        copy(pose="target", attitude_sigma=1e-3, position_sigma=1e-3),
        copy(period=7.0),
    ),
    "relative_two_body": (
        relative_two_body(0),
        relative_two_body(3, max_step=5.0),
        relative_two_body(20, **TURNING),
    ),
    "three_point_attitude": (
        attitude_sensor(ThreePointAttitude(sigma=np.full(3, 3e-3), triangle=TRIANGLE)),
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
    "whole_range_bias": (DerivedExample(WholeRangeBias()),),
    "whole_range_rate_bias": (DerivedExample(WholeRangeRateBias()),),
    "target_rate_in_chaser": (DerivedExample(relative_pose.TargetRateInChaser()),),
}

EXAMPLES = {kind: with_variants(examples) for kind, examples in _EXAMPLES.items()}
