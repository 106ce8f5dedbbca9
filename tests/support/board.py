"""A pass of one's own: a marker board and a gyro, as tables."""

from __future__ import annotations

#: A scenario of recorded data, all but its prior.
BOARD = """
title = "a marker board and a gyro"
[data]
reader = "tables"
[processes.turn]
kind = "gyro_bias"
attitude = "relative_attitude"
angle_random_walk_density = "0.006 deg/sqrt(s)"
bias_random_walk_density = "1e-6 rad/s^1.5"
[processes.move]
kind = "white_noise_acceleration"
pose = "target"
acceleration_density = "1e-3 m/s^1.5"
[sensors.board]
kind = "pose_measurement"
pose = "target"
position_sigma = "10 cm"
attitude_sigma = "1 deg"
"""
