"""The catalogue: blocks that several models share; a model may declare others in its own file.

o is the orbital frame of the target, or, where a scenario has no orbit, a frame that does not
rotate.
"""

from __future__ import annotations

from collections.abc import Mapping

from relnav_graph.core.state import Block

CHASER_ATTITUDE = Block("chaser_attitude", "R_oc", "SO3", 3, "rad", "oc", "deg")
TARGET_ATTITUDE = Block("target_attitude", "R_ot", "SO3", 3, "rad", "ot", "deg")
RELATIVE_ATTITUDE = Block("relative_attitude", "R_tc", "SO3", 3, "rad", "tc", "deg")
RELATIVE_POSITION = Block("relative_position", "r_tc_o", "vector", 3, "m", "o", "m")
RELATIVE_VELOCITY = Block("relative_velocity", "v_tc_o", "vector", 3, "m/s", "o", "m/s")
RELATIVE_POSITION_T = Block("relative_position", "r_tc_t", "vector", 3, "m", "t", "m")
RELATIVE_VELOCITY_T = Block("relative_velocity", "v_tc_t", "vector", 3, "m/s", "t", "m/s")
# Of the chaser's own orbit: always inertial, from the Earth's centre.
CHASER_POSITION = Block("chaser_position", "r_c_i", "vector", 3, "m", "i", "m")
CHASER_VELOCITY = Block("chaser_velocity", "v_c_i", "vector", 3, "m/s", "i", "m/s")
#: The target's orbit in its plane, with which o turns, where it is estimated: radius, its rate, the
#: angle of the radius from a direction at rest (of perigee, say), its rate.
ORBIT = (
    Block("orbit_radius", "r_t", "vector", 1, "m", "-", "m"),
    Block("orbit_radial_rate", "r_t'", "vector", 1, "m/s", "-", "m/s"),
    Block("orbit_angle", "th_t", "vector", 1, "rad", "-", "deg"),
    Block("orbit_angular_rate", "th_t'", "vector", 1, "rad/s", "-", "deg/s"),
)
TARGET_RATE = Block("target_rate", "w_ti_t", "vector", 3, "rad/s", "t", "deg/s")
#: The same under another name, for a target whose axes are arbitrary.
BODY_RATE = Block("body_rate", "w_ti_t", "vector", 3, "rad/s", "t", "deg/s")
GYRO_BIAS = Block("gyro_bias", "b_c", "vector", 3, "rad/s", "c", "deg/h")
ACCELEROMETER_BIAS = Block("accelerometer_bias", "b_f_c", "vector", 3, "m/s^2", "c", "m/s^2")
#: The same bias as the chaser's own (absolute) navigation estimates it, beside the relative
#: navigation's estimate.
ABSOLUTE_ACCELEROMETER_BIAS = Block(
    "absolute_accelerometer_bias", "b_F_c", "vector", 3, "m/s^2", "c", "m/s^2"
)
EARTH_SENSOR_BIAS = Block("earth_sensor_bias", "b_e_s", "vector", 2, "rad", "s", "deg")
#: Of a measured distance between target and chaser, and of its rate.
RANGE_BIAS = Block("range_bias", "b_r", "vector", 1, "m", "-", "m")
RANGE_RATE_BIAS = Block("range_rate_bias", "b_v", "vector", 1, "m/s", "-", "m/s")
# A bias may be two blocks: a constant, which has the name of the bias, and what drifts about it.
GYRO_DRIFT = Block("gyro_drift", "d_c", "vector", 3, "rad/s", "c", "deg/h")
ACCELEROMETER_DRIFT = Block("accelerometer_drift", "d_f_c", "vector", 3, "m/s^2", "c", "m/s^2")
ABSOLUTE_ACCELEROMETER_DRIFT = Block(
    "absolute_accelerometer_drift", "d_F_c", "vector", 3, "m/s^2", "c", "m/s^2"
)
EARTH_SENSOR_DRIFT = Block("earth_sensor_drift", "d_e_s", "vector", 2, "rad", "s", "deg")
RANGE_DRIFT = Block("range_drift", "d_r", "vector", 1, "m", "-", "m")
RANGE_RATE_DRIFT = Block("range_rate_drift", "d_v", "vector", 1, "m/s", "-", "m/s")
#: By name: of a drift, the bias about which it drifts.
DRIFTS: Mapping[str, str] = {
    GYRO_DRIFT.name: GYRO_BIAS.name,
    ACCELEROMETER_DRIFT.name: ACCELEROMETER_BIAS.name,
    ABSOLUTE_ACCELEROMETER_DRIFT.name: ABSOLUTE_ACCELEROMETER_BIAS.name,
    EARTH_SENSOR_DRIFT.name: EARTH_SENSOR_BIAS.name,
    RANGE_DRIFT.name: RANGE_BIAS.name,
    RANGE_RATE_DRIFT.name: RANGE_RATE_BIAS.name,
}
#: artanh of the first two ratios l_x = (J_y - J_z) / J_x, l_y = (J_z - J_x) / J_y of the
#: principal inertia. With k_z = -(k_x + k_y), l = tanh(k): l_x + l_y + l_z + l_x l_y l_z
#: = 0 holds by the addition theorem, and every value belongs to a body of positive mass.
INERTIA = Block("inertia_parameters", "k_t", "vector", 2, "1", "t", "1")
#: Of a body of any axes: J = tr(D) I - D with D = exp(S), S = sum k_a TRACELESS[a], up to a
#: scale. D is the second moment of the mass; every k belongs to a body, and a prior that is
#: the same for all k favours no axes.
INERTIA_MATRIX = Block("inertia_matrix_parameters", "S_t", "vector", 5, "1", "t", "1")
#: A point of a target whose shape is unknown, from its centre of mass; numbered, by the ids of the
#: observations.
POINT = Block("point", "X_t", "vector", 3, "m", "t", "mm")
