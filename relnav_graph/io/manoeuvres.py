"""Tables of manoeuvres: a row for each, between which there is no thrust.

t_start_s, t_end_s       or t_s, of a step of the velocity
dvx_m_s, dvy_m_s, dvz_m_s                                 in the axes of the velocity
pxx_m2_s2, pxy_m2_s2, pxz_m2_s2, pyy_m2_s2, pyz_m2_s2, pzz_m2_s2     covariance,
or sigma_x_m_s, sigma_y_m_s, sigma_z_m_s
"""

from __future__ import annotations

import numpy as np

from relnav_graph.core.manoeuvres import COVARIANCE, IMPULSE, thrust_series
from relnav_graph.core.measurement import InputSeries
from relnav_graph.io.tabular import Table

__all__ = ["read_manoeuvres"]

_DELTA = tuple(f"dv{axis}_m_s" for axis in "xyz")
_SIGMA = tuple(f"sigma_{axis}_m_s" for axis in "xyz")
_COVARIANCE = tuple(f"p{pair}_m2_s2" for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))
#: There is no thrust so long before the first manoeuvre and after the last one, s.
_FAR = 1e9


def read_manoeuvres(table: Table, name: str) -> InputSeries:
    """The input that a table of manoeuvres is. Raises InputError, naming file and line."""
    steps = "t_s" in table.columns
    times = ("t_s",) if steps else ("t_start_s", "t_end_s")
    spread = _SIGMA if _SIGMA[0] in table.columns else _COVARIANCE
    table.require((*times, *_DELTA, *spread))
    t_start = table[times[0]]
    table.increasing(times[0])
    t_end = t_start + IMPULSE if steps else table["t_end_s"]
    if spread == _SIGMA:
        for column in _SIGMA:
            table.refuse(table[column] < 0, column, "zero or more")
        covariance = table.stack(_SIGMA)[:, None, :] ** 2 * np.eye(3)
    else:
        covariance = table.stack(_COVARIANCE)[:, COVARIANCE]
    first, last = (t_start[0], t_end[-1]) if len(t_start) else (0.0, 0.0)
    where = [f"{table.path}, line {line}" for line in table.lines]
    far = first - _FAR, last + _FAR
    return thrust_series(name, t_start, t_end, table.stack(_DELTA), covariance, *far, where)
