"""Measurements given in another unit than the one in the name of their column.

A wrong unit is wrong from the first measurement on, by a familiar factor (deg for rad, km for
m). So a sensor's first measurement is compared with its prediction, and where it fits only
after such a factor, the error says which.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Sensor
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Layout
from relnav_graph.units import unit_scale

__all__ = ["wrong_unit"]

#: The SI unit, and others given for it by mistake, by the end of a column's name.
_MEANT = {
    "_rad_s": ("rad/s", ("deg/s", "deg/h")),
    "_m_s": ("m/s", ("km/s", "mm/s")),
    "_rad": ("rad", ("deg", "arcsec", "mrad")),
    "_m": ("m", ("km", "mm")),
}
#: Chi-square tail probabilities: below the first, a measurement does not fit as it is; above
#: the second, it fits in another unit.
_MISFIT, _FIT = 1e-9, 1e-3


def _misfit(
    sensor: Sensor, m: Measurement, layout: Layout, x: Array, P: Array
) -> tuple[float, int]:
    """r^T S^-1 r with S = H P H^T + R at the state x (size,) of covariance P (n, n); rows of r."""
    values = layout.values(x)
    r, jacobians = sensor.residual(m, *(values[b.name] for b in sensor.reads))
    _, columns = layout.gather(sensor.reads)
    H = np.hstack(jacobians)
    S = H @ P[np.ix_(columns, columns)] @ H.T
    for k, R in enumerate(sensor.noise(m)):
        rows = slice(k * sensor.rows, (k + 1) * sensor.rows)
        S[rows, rows] += R
    return float(r @ np.linalg.solve(S, r)), len(r)


def wrong_unit(sensor: Sensor, m: Measurement, layout: Layout, x: Array, P: Array) -> str | None:
    """A message when a measurement fits in another unit only; None when it fits as it is, or in
    no unit. x (size,), P (n, n): predicted state and covariance."""
    fitting = None
    try:
        misfit, rows = _misfit(sensor, m, layout, x, P)
        if misfit <= chdtri(rows, _MISFIT):
            return None
        for end, (si, meant) in _MEANT.items():
            chosen = np.array([c.endswith(end) for c in sensor.columns])
            for unit in meant if chosen.any() else ():
                scale = np.where(chosen, unit_scale(unit, si), 1.0)
                misfit, _ = _misfit(sensor, replace(m, z=m.z * scale), layout, x, P)
                if misfit <= chdtri(rows, _FIT) and fitting is None:
                    fitting = f"{unit} given for {si}"
    except Exception:  # what a model has against it is for the estimator to say
        return None
    if fitting is None:
        return None
    return f"{fitting}? its squared misfit is far from chance as it is, and not in that unit"
