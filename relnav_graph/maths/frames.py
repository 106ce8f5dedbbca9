"""Frames: between an inertial frame and the orbital frame o = RTN of the target."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError

__all__ = ["from_rtn", "rtn_axes", "rtn_from_inertial", "to_rtn", "xiong_from_rtn"]


def rtn_from_inertial(r_i: Array, v_i: Array) -> Array:
    """``R_oi``, which takes components in the inertial frame i to components in o.

    r_i: (3,), m; v_i: (3,), m/s. Returns (3, 3), whose rows are the axes of o in i: x radial
    outward, y transverse, z along the orbit normal. Raises InputError on a rectilinear orbit.
    """
    normal = np.cross(r_i, v_i)
    if not np.linalg.norm(normal) > 1e-12 * np.linalg.norm(r_i) * np.linalg.norm(v_i):
        raise InputError("the orbital frame is undefined: position and velocity are parallel")
    x = r_i / np.linalg.norm(r_i)
    z = normal / np.linalg.norm(normal)
    return np.array([x, np.cross(z, x), z])


def rtn_axes(state: Array) -> tuple[Array, Array]:
    """``R_oi`` (N, 3, 3) and the rate of o, w_oi_o (N, 3), rad/s, of an orbit's states.

    state: (N, 6 or more), position, m, and velocity, m/s, in i. The rate is that of an unperturbed
    orbit, about the normal alone; a pull across the orbit tilts that, in a low polar orbit by 1e-7
    rad/s: 0.1 mm/s per km between two craft.
    """
    r_i, v_i = state[:, 0:3], state[:, 3:6]
    x_i = r_i / np.linalg.norm(r_i, axis=1)[:, None]
    h_i = np.cross(r_i, v_i)
    momentum = np.linalg.norm(h_i, axis=1)
    z_i = h_i / momentum[:, None]
    w_oi_o = np.zeros_like(r_i)
    w_oi_o[:, 2] = momentum / (r_i**2).sum(axis=1)
    return np.stack([x_i, np.cross(z_i, x_i), z_i], axis=1), w_oi_o


def to_rtn(chaser: Array, target: Array) -> Array:
    """r_tc_o, m, and v_tc_o, m/s, (N, 6), of states (N, 6), m and m/s, in i: the position of the
    chaser from the target, and its rate as seen in o, which turns."""
    R_oi, w_oi_o = rtn_axes(target)
    r_tc_o, v_o = (np.einsum("nij,nj->ni", R_oi, d) for d in np.split(chaser - target, 2, axis=1))
    return np.hstack([r_tc_o, v_o - np.cross(w_oi_o, r_tc_o)])


def from_rtn(relative: Array, target: Array) -> Array:
    """The chaser's states (N, 6), m and m/s, in i: the inverse of `to_rtn`."""
    R_oi, w_oi_o = rtn_axes(target)
    r_tc_o, v_tc_o = relative[:, :3], relative[:, 3:]
    v_o = v_tc_o + np.cross(w_oi_o, r_tc_o)
    out: Array = target + np.hstack([np.einsum("nji,nj->ni", R_oi, d) for d in (r_tc_o, v_o)])
    return out


#: (3, 3): takes components in o to components in the frame that Xiong et al. 2013 call LVLH
#: (x along track, y against the orbit normal, z to nadir). Others call o itself LVLH.
xiong_from_rtn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
