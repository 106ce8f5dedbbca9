"""The manual of the extension point: new models, written as a third party would.

A laser ranger measures how far the chaser is from reflectors on a target that does not
rotate. Its electronics warm and cool, and its readings drift with them. Neither the
ranger nor the drift is known to the package; this file is all that it takes:

    processes.electronics = { kind = "toy_model:ThermalDrift", ... }
    sensors.ranger        = { kind = "toy_model:DriftingRange", ... }

``module:Class`` names a class in any module that can be imported. A package that wants
its models to be found by their bare `kind` names itself in the entry-point group
``relnav_graph.models``. With that, simulator, filters and graphs run them, and nothing
anywhere else changes: `test_extension.py` proves it.

    one pass as a factor graph (p: position and velocity, d: drift)

    prior - p0 --- motion --- p1 --- motion --- p2
             |                 |                 |
           ranges            ranges            ranges
             |                 |                 |
    prior - d0 --- drift ---- d1 --- drift ---- d2
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import DynamicsModel, SensorModel
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity

# 1. A state of its own. Blocks that many models share stand in `relnav_graph.core.state`; any
# other is declared where it is used. The name is what scenarios ([prior]) and tables say.
RANGE_DRIFT = Block("range_drift", "d_s", "vector", 1, "m", "s", "m")


# 2. A process. Its formula stands once, in a compiled kernel with a fixed signature. The
# kernel must fill all of x_next, F and Q, which come filled with NaN: an entry that is
# forgotten is reported, not used. It returns 0, or a number that `failures` explains.
@jit
def drift_kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """p = (time constant, density), x = (drift); exact for any interval."""
    dt = u[:, 0].sum()  # one row per sub-interval: its length, then the inputs in it
    decay = np.exp(-dt / p[0])
    x_next[0] = decay * x[0]
    F[0, 0] = decay
    Q[0, 0] = -(p[1] ** 2) * p[0] / 2 * np.expm1(-2 * dt / p[0])
    return 0


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(DynamicsModel):
    """A drift that is damped and driven by white noise, d' = -d / time_constant + white.

    The first-order Gauss-Markov process: Bar-Shalom, Li, Kirubarajan 2001, section 8.2.
    time_constant: s; density: m/sqrt(s).
    """

    kind: ClassVar[str] = "toy_thermal_drift"
    kernel = staticmethod(drift_kernel)

    # A scenario may give "20 min" or "3 mm/sqrt(s)"; a wrong unit, sign or shape is
    # reported with the path in the file.
    time_constant: Annotated[float, Quantity("s", positive=True)]
    density: Annotated[float, Quantity("m/sqrt(s)", positive=True)]

    @property
    def advances(self) -> tuple[Block, ...]:
        return (RANGE_DRIFT,)

    def constants(self) -> Array:
        """p of the kernel."""
        return np.array([self.time_constant, self.density])


# 3. The simplest sensor: linear, one observation at a time, no data of its own.
@jit
def fix_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """r (3,): predicted minus measured position."""
    H[:, :] = 0.0
    for i in range(3):
        r[i] = x[i] - z[i]
        H[i, i] = 1.0
    return 0


@dataclass(frozen=True, kw_only=True)
class PositionFix(SensorModel):
    """The relative position itself, z = r_tc_o; covariance: of its noise, m^2."""

    kind: ClassVar[str] = "toy_position_fix"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    rows: ClassVar[int] = 3
    kernel = staticmethod(fix_kernel)

    covariance: Annotated[Array, Quantity("m^2", (3, 3))]

    @property
    def reads(self) -> tuple[Block, ...]:
        return (RELATIVE_POSITION,)

    def observation_data(self, ids: Indices) -> Array:
        """None: several receivers may see the same at one time, whatever their ids."""
        return np.zeros((len(ids), 0))

    def noise(self, m: Measurement) -> Array:
        """R (k, 3, 3)."""
        return np.tile(self.covariance, (len(m.z), 1, 1))


# 4. A sensor that sees several things at once, each with data of its own (here: where the
# reflector is), and that can be impossible. The simulator, too, measures with the kernel: its
# residual at z = 0 is the prediction.
@jit
def distance(point_o: Array, r_tc_o: Array) -> tuple[float, Array]:
    """Distance from a reflector, m, and the vector from it, (3,)."""
    line = r_tc_o - point_o
    return np.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2), line


@jit
def range_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """q: the reflector (3,); x: the blocks of `reads`, one after the other."""
    length, line = distance(q, x[:3])
    if length < 1e-6:  # the direction is not defined there; the estimator skips and counts
        return 1
    r[0] = length + x[3] - z[0]  # predicted minus measured
    for i in range(3):
        H[0, i] = line[i] / length
    H[0, 3] = 1.0
    return 0


@dataclass(frozen=True, kw_only=True)
class DriftingRange(SensorModel):
    """Distances from reflectors at known places, with a common drift: z = |r - X| + d.

    points: X (n, 3), m, in o; an observation's id is its row. sigma: m.
    """

    kind: ClassVar[str] = "toy_drifting_range"
    columns: ClassVar[tuple[str, ...]] = ("range_m",)
    rows: ClassVar[int] = 1
    kernel = staticmethod(range_kernel)
    failures = {1: "the chaser stands on the reflector"}

    points: Annotated[Array, Quantity("m", (None, 3))]
    sigma: Annotated[float, Quantity("m", positive=True)]

    @property
    def reads(self) -> tuple[Block, ...]:
        return RELATIVE_POSITION, RANGE_DRIFT

    def observables(self) -> Indices:
        """A simulated ranger looks for every reflector."""
        return np.arange(len(self.points))

    def observation_data(self, ids: Indices) -> Array:
        """q of the kernel for each observation (k, 3)."""
        bad = (ids < 0) | (ids >= len(self.points))
        if bad.any():
            last = len(self.points) - 1
            raise InputError(f"{self.kind}: found id {ids[bad][0]}, expected 0 to {last}")
        return np.ascontiguousarray(self.points[ids])

    def noise(self, m: Measurement) -> Array:
        """R (k, 1, 1)."""
        return np.full((len(m.z), 1, 1), self.sigma**2)
