"""Frames: between an inertial frame and the orbital frame o = RTN of the target."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError

__all__ = ["rtn_from_inertial", "xiong_from_rtn"]


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


#: (3, 3): takes components in o to components in the frame that Xiong et al. 2013 call LVLH
#: (x along track, y against the orbit normal, z to nadir). Others call o itself LVLH.
xiong_from_rtn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
