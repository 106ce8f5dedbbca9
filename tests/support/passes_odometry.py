"""A pass with odometry between epochs, drawn from the estimators' own models."""

from __future__ import annotations

from typing import Any

from relnav_graph.scenario.build import make_scenario
from relnav_graph.scenario.scenario import Scenario

#: A target that tumbles beside a chaser 2 m away; a star tracker sees now and then.
ODOMETRY: dict[str, Any] = {
    "title": "odometry",
    "time": {"step": 1.0, "epochs": 80},
    "processes": {
        "chaser": {
            "kind": "gyro_bias",
            "angle_random_walk_density": 1e-4,
            "bias_random_walk_density": 1e-6,
        },
        "target": {
            "kind": "euler_rotation",
            "inertia": "full",
            "torque_density": 1e-4,
            "inertia_density": 1e-8,
        },
        "translation": {"kind": "white_noise_acceleration", "acceleration_density": 1e-3},
        "previous": {"kind": "previous_pose"},
    },
    "sensors": {
        "odometry": {
            "kind": "pose_odometry",
            "position_sigma": 0.005,
            "attitude_sigma": "0.6 deg",
            "scene_centre": [2.0, 0.0, 0.0],
            "sensor_attitude": [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
            "sensor_position": [0.1, 0.05, -0.02],
        },
        "stars": {"kind": "star_tracker", "sigma": 1e-3},
    },
    "prior": {
        "chaser_attitude": {"sigma": 1e-3},
        "gyro_bias": {"sigma": 1e-4},
        "target_attitude": {"sigma": 1e-3},
        "target_rate": {"sigma": 0.02},
        "inertia_matrix_parameters": {"sigma": 0.1},
        "relative_position": {"sigma": 0.05},
        "relative_velocity": {"sigma": 0.01},
        "previous_chaser_attitude": {"sigma": 1e-3},
        "previous_target_attitude": {"sigma": 1e-3},
        "previous_relative_position": {"sigma": 1e-3},
    },
    "truth": {
        "kind": "own_models",
        "initial": {
            "target_rate": [0.03, 0.07, -0.05],
            "relative_position": [-2.0, 0.2, 0.1],
            "inertia_matrix_parameters": [0.2, -0.1, 0.05, 0.0, 0.1],
        },
    },
    "inputs": {"gyro": {"kind": "constant_input", "values": [0.001, -0.002, 0.003]}},
}


def odometry_scenario(
    gate: float | None = None, period: float | None = None, **sections: Any
) -> Scenario:
    """The pass; period: of odometry and its copy, s; sections: whole tables to replace."""
    raw = {**ODOMETRY, **sections}
    odometry, previous = raw["sensors"]["odometry"], raw["processes"]["previous"]
    if gate is not None:
        odometry = {**odometry, "gate": gate}
    if period is not None:
        odometry, previous = {**odometry, "period": period}, {**previous, "period": period}
    raw["sensors"] = {**raw["sensors"], "odometry": odometry}
    raw["processes"] = {**raw["processes"], "previous": previous}
    return make_scenario(raw, "odometry")
