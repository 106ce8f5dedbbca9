"""Two craft and a tumbling body written plainly, in the inertial frame, attitudes as matrices, and
integrated by SciPy: what the simulated truth is compared with."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from relnav_graph.arrays import Array
from relnav_graph.core.track import Truth
from relnav_graph.sim.truths.rigid_body_pair import RigidBodyPair

DEG = np.pi / 180

# zhang2015, near perigee: the target tumbles at 2.5 deg/s, 300 m away.
PAIR = RigidBodyPair(
    semi_major_axis=7.2e6,
    eccentricity=0.05,
    true_anomaly=0.3,
    inclination=0.9,
    raan=2.1,
    argument_of_perigee=-1.2,
    relative_position=np.array([200.0, 200.0, 100.0]),
    relative_velocity=np.array([0.01, -0.4325, 0.01]),
    target_attitude=np.array([0.3, -0.8, 0.5]),
    chaser_attitude=np.array([-0.2, 0.1, 1.4]),
    target_inertia=np.array([100.0, 80.0, 60.0]),
    target_rate=np.array([0.2, 2.5, 0.2]) * DEG,
    chaser_rate=np.array([0.001, -0.002, 0.003]),
)


def run(pair: RigidBodyPair, times: Any, seed: int = 0) -> Truth:
    return pair.simulate(np.asarray(times, dtype=float), np.random.default_rng(seed))


def skew(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rodrigues(phi: Array) -> Array:
    angle = np.linalg.norm(phi)
    K = skew(phi / angle)
    out: Array = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    return out


def rtn(r_i: Array, v_i: Array) -> tuple[Array, Array]:
    """R_io and w_oi_o of a position and velocity."""
    h_i = np.cross(r_i, v_i)
    x_i, z_i = r_i / np.linalg.norm(r_i), h_i / np.linalg.norm(h_i)
    R_io = np.column_stack([x_i, np.cross(z_i, x_i), z_i])
    return R_io, np.array([0.0, 0.0, np.linalg.norm(h_i) / (r_i @ r_i)])


def angles(A: Array, B: Array) -> Array:
    """Angles between rotations (N, 3, 3), rad; for small ones."""
    return np.asarray(np.linalg.norm(A - B, axis=(1, 2)) / np.sqrt(2.0))


def initial_inertial(pair: RigidBodyPair) -> tuple[Array, Array]:
    """r_ti_i and v_ti_i at t = 0 through the perifocal frame (Vallado 2013, alg. 10)."""
    e, nu = pair.eccentricity, pair.true_anomaly
    p = pair.semi_major_axis * (1 - e**2)
    x, z = np.eye(3)[0], np.eye(3)[2]
    plane = rodrigues(pair.raan * z) @ rodrigues(pair.inclination * x)
    perifocal = plane @ rodrigues(pair.argument_of_perigee * z)
    r = p / (1 + e * np.cos(nu)) * np.array([np.cos(nu), np.sin(nu), 0])
    v = np.sqrt(pair.mu / p) * np.array([-np.sin(nu), e + np.cos(nu), 0])
    return perifocal @ r, perifocal @ v


def reference(pair: RigidBodyPair, times: Array) -> dict[str, Array]:
    """The same physics written plainly: two craft in i, all attitudes as matrices."""
    r_i, v_i = initial_inertial(pair)
    R_io, w_oi_o = rtn(r_i, v_i)
    J = pair.target_inertia
    chaser_v_o = pair.relative_velocity + np.cross(w_oi_o, pair.relative_position)
    r_c, v_c = r_i + R_io @ pair.relative_position, v_i + R_io @ chaser_v_o
    R_it, R_ic = R_io @ rodrigues(pair.target_attitude), R_io @ rodrigues(pair.chaser_attitude)
    y0 = np.concatenate([r_i, v_i, r_c, v_c, R_it.ravel(), R_ic.ravel(), pair.target_rate])

    def derivative(t: float, y: Array) -> Array:
        r_t, r_c, w = y[0:3], y[6:9], y[30:33]
        g_t, g_c = (-pair.mu * r / (r @ r) ** 1.5 for r in (r_t, r_c))
        turned_t = y[12:21].reshape(3, 3) @ skew(w)
        turned_c = y[21:30].reshape(3, 3) @ skew(pair.chaser_rate)
        w_dot = -(skew(w) @ (J * w)) / J
        parts = [y[3:6], g_t, y[9:12], g_c, turned_t.ravel(), turned_c.ravel(), w_dot]
        return np.concatenate(parts)

    span = (0.0, times[-1])
    y = solve_ivp(derivative, span, y0, "DOP853", times, rtol=2.3e-14, atol=1e-14).y.T
    frames = [rtn(row[0:3], row[3:6]) for row in y]
    R_oi = np.array([R_io.T for R_io, _ in frames])
    w = np.array([w_oi_o for _, w_oi_o in frames])
    position = np.einsum("nij,nj->ni", R_oi, y[:, 6:9] - y[:, 0:3])
    velocity = np.einsum("nij,nj->ni", R_oi, y[:, 9:12] - y[:, 3:6])
    return {
        "relative_position": position,
        "relative_velocity": velocity - np.cross(w, position),
        "target_attitude": R_oi @ y[:, 12:21].reshape(-1, 3, 3),
        "chaser_attitude": R_oi @ y[:, 21:30].reshape(-1, 3, 3),
        "target_rate": y[:, 30:33],
    }


def scipy_truth_apart(seconds: float = 6000.0) -> dict[str, float]:
    """Of the simulated truth, without noise, from that integration: m, m/s, rad/s, rad."""
    times = np.linspace(0, seconds, 61)
    values, want = run(PAIR, times).values, reference(PAIR, times)
    found = {
        name: float(np.abs(values[name] - want[name]).max())
        for name in ("relative_position", "relative_velocity", "target_rate")
    }
    for name in ("target_attitude", "chaser_attitude"):
        found[name] = float(angles(values[name], want[name]).max())
    return found
