"""A linear pass whose position is compared between any two epochs: copies, and the copier."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from toy_model import PositionFix

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.copies import closure_name, with_copiers
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import SensorModel
from relnav_graph.core.problem import Prior, Problem, layout_of
from relnav_graph.core.state import Block
from relnav_graph.units import Quantity


@jit
def difference(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """r = x[3:] - x[:3] - z, both positions in o."""
    for i in range(3):
        r[i] = x[3 + i] - x[i] - z[i]
        for j in range(6):
            H[i, j] = 1.0 if j == 3 + i else -1.0 if j == i else 0.0
    return 0


@dataclass(frozen=True, kw_only=True)
class PositionChange(SensorModel):
    """z = r - r(keyframe), m, in o; sigma: m; keyframe: s."""

    kind: ClassVar[str] = "toy_position_change"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    rows: ClassVar[int] = 3
    kernel = staticmethod(difference)

    sigma: Annotated[float, Quantity("m", positive=True)]
    keyframe: Annotated[float, Quantity("s")]

    @property
    def copy(self) -> Block:
        return replace(RELATIVE_POSITION, name=f"{RELATIVE_POSITION.name}.{self.keyframe:.15g}")

    @property
    def reads(self) -> tuple[Block, ...]:
        return self.copy, RELATIVE_POSITION

    def copier(self) -> PositionCopy:
        return PositionCopy(sigma=1e-8, keyframe=self.keyframe)

    def noise(self, m: Measurement) -> Array:
        return np.tile(self.sigma**2 * np.eye(3), (len(m.z), 1, 1))


@dataclass(frozen=True, kw_only=True)
class PositionCopy(PositionChange):
    """0 = r - r_copy at the keyframe."""

    kind: ClassVar[str] = "toy_position_copy"

    copier = None  # type: ignore[assignment]

    @property
    def copies(self) -> Mapping[str, Block]:
        return {self.copy.name: RELATIVE_POSITION}


#: Pairs of epochs that are compared, s.
PAIRS = ((0.0, 12.0), (5.0, 12.0), (5.0, 29.0), (17.0, 23.0))
DENSITY, SIGMA_FIX, SIGMA_CHANGE = 0.05, 0.5, 0.01


def looped_problem(pairs: tuple[tuple[float, float], ...] = PAIRS, seed: int = 3) -> Problem:
    """Thirty epochs with a fix each, and differences of the position between pairs of them."""
    rng = np.random.default_rng(seed)
    processes: dict[str, Any] = {"motion": WhiteNoiseAcceleration(acceleration_density=DENSITY)}
    fix: Any = PositionFix(covariance=SIGMA_FIX**2 * np.eye(3))
    sensors: dict[str, Any] = {"fix": fix}
    times, one = np.arange(30.0), np.zeros(1, np.int64)
    r = np.array([10.0, -4.0, 2.0]) + np.cumsum(rng.normal(size=(30, 3)), axis=0)
    measurements = [
        Measurement("fix", t, (r[k] + SIGMA_FIX * rng.normal(size=3))[None], one)
        for k, t in enumerate(times.tolist())
    ]
    for a, b in pairs:
        name = closure_name("loop", a)
        sensors[name] = PositionChange(sigma=SIGMA_CHANGE, keyframe=a)
        z = r[int(b)] - r[int(a)] + SIGMA_CHANGE * rng.normal(size=3)
        measurements.append(Measurement(name, b, z[None], one))
    sensors = with_copiers(sensors)
    layout = layout_of(processes, sensors)
    x = layout.identity.copy()
    x[:6] = [9.0, -5.0, 3.0, 0.0, 0.0, 0.0]
    sigma = np.full(layout.dim, 1e5)
    sigma[:6] = 1.0
    epochs = make_epochs(processes, measurements, {}, times)
    return Problem(processes, sensors, Prior(x, np.diag(sigma**2)), epochs)


def direct_solution(problem: Problem) -> tuple[Array, Array]:
    """Estimates (N, 6) and covariances (N, 6, 6) of the epochs from all rows at once, those of
    closures between the epochs themselves, without any copy: dense least squares."""
    count = len(problem.epochs)
    rows, right = [np.eye(6 * count)[:6]], [problem.prior.x[:6]]
    for k in range(1, count):
        F, h = np.eye(6), problem.epochs[k].t - problem.epochs[k - 1].t
        F[:3, 3:] = h * np.eye(3)
        Q = np.kron([[h**3 / 3, h**2 / 2], [h**2 / 2, h]], DENSITY**2 * np.eye(3))
        W = np.linalg.inv(np.linalg.cholesky(Q))
        row = np.zeros((6, 6 * count))
        row[:, 6 * k : 6 * k + 6], row[:, 6 * k - 6 : 6 * k] = W, -W @ F
        rows.append(row)
        right.append(np.zeros(6))
    for k, epoch in enumerate(problem.epochs):
        for m in epoch.measurements:
            sensor = problem.sensors[m.sensor]
            if isinstance(sensor, PositionCopy):
                continue
            row = np.zeros((3, 6 * count))
            row[:, 6 * k : 6 * k + 3] = np.eye(3)
            sigma = SIGMA_FIX
            if isinstance(sensor, PositionChange):
                i = int(sensor.keyframe)
                row[:, 6 * i : 6 * i + 3] = -np.eye(3)
                sigma = SIGMA_CHANGE
            rows.append(row / sigma)
            right.append(m.z[0] / sigma)
    A, b = np.vstack(rows), np.concatenate(right)
    Q, R = np.linalg.qr(A)
    x = np.linalg.solve(R, Q.T @ b)
    half = np.linalg.inv(R)
    P = half @ half.T
    blocks = np.array([P[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(count)])
    return x.reshape(count, 6), blocks
