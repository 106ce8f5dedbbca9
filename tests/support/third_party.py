"""A third party's bearing to the chaser, right and wrong, for `relnav check`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import CHASER_ATTITUDE, RELATIVE_POSITION
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import DynamicsModel, SensorModel
from relnav_graph.core.numerical import NumericalSensor
from relnav_graph.core.state import Block
from relnav_graph.maths import dense
from relnav_graph.units import Quantity

DRIFT = Block("offset", "d_s", "vector", 1, "m", "s", "m")


@jit
def bearing(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """r = R_oc^T r_tc_o - z: where the target is not, seen from the chaser."""
    R, place = dense.matrix_at(x, 0), dense.vector_at(x, 9)
    seen = dense.transposed_matvec(R, place)
    for i in range(3):
        r[i] = seen[i] - z[i]
        for j in range(3):
            H[i, 3 + j] = R[j, i]
    H[0, 0], H[0, 1], H[0, 2] = 0.0, -seen[2], seen[1]
    H[1, 0], H[1, 1], H[1, 2] = seen[2], 0.0, -seen[0]
    H[2, 0], H[2, 1], H[2, 2] = -seen[1], seen[0], 0.0
    return 0


@jit
def wrong_sign(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """One entry of H has the wrong sign."""
    status = bearing(p, q, z, x, r, H)
    H[1, 5] = -H[1, 5]
    return status


@jit
def one_missing(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """One entry of H is not written."""
    held = H[2, 0]
    status = bearing(p, q, z, x, r, H)
    H[2, 0] = held
    return status


@jit
def one_added(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """One entry of H depends on what it held before, where that is a number."""
    held = H[0, 4]
    status = bearing(p, q, z, x, r, H)
    if held < 0:
        H[0, 4] = H[0, 4] + 1.0
    return status


@jit
def past_the_end(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """Writes a row too many."""
    status = bearing(p, q, z, x, r, H)
    H[3, 0] = 1.0
    return status


@dataclass(frozen=True)
class Bearing(SensorModel):
    """z = R_oc^T r_tc_o, sigma: m."""

    kind: ClassVar[str] = "third_party_bearing"
    columns: ClassVar[tuple[str, ...]] = ("x_m", "y_m", "z_m")
    rows: ClassVar[int] = 3
    kernel = staticmethod(bearing)

    sigma: Annotated[float, Quantity("m", positive=True)]

    @classmethod
    def example(cls) -> Any:
        return cls(sigma=0.1)

    @property
    def reads(self) -> tuple[Block, ...]:
        return CHASER_ATTITUDE, RELATIVE_POSITION

    def noise(self, m: Measurement) -> Array:
        return np.tile(self.sigma**2 * np.eye(3), (len(m.z), 1, 1))


class WrongSign(Bearing):
    kind = "third_party_wrong_sign"
    kernel = staticmethod(wrong_sign)


class OneMissing(Bearing):
    kind = "third_party_one_missing"
    kernel = staticmethod(one_missing)


class OneAdded(Bearing):
    kind = "third_party_one_added"
    kernel = staticmethod(one_added)


class PastTheEnd(Bearing):
    kind = "third_party_past_the_end"
    kernel = staticmethod(past_the_end)


class NoNoise(Bearing):
    kind = "third_party_no_noise"

    def noise(self, m: Measurement) -> Array:
        R: Array = super().noise(m)
        R[:, 2, 2] = 0.0
        return R


class Raises(Bearing):
    kind = "third_party_raises"

    def noise(self, m: Measurement) -> Array:
        raise ZeroDivisionError("no such thing")


class LittleNoise(Bearing):
    kind = "third_party_little_noise"

    def perturb(self, z: Array, e: Array) -> Array:
        return z + 0.5 * e


@jit
def forgetful(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """x' = -x: exact, but for F."""
    dt = u[:, 0].sum()
    x_next[0] = np.exp(-dt) * x[0]
    F[0, 0] = 1.0 - dt
    Q[0, 0] = 0.5 * (1 - np.exp(-2 * dt))
    return 0


@dataclass(frozen=True)
class Forgetful(DynamicsModel):
    """x' = -x + white; F is Euler's."""

    kind: ClassVar[str] = "third_party_forgetful"
    kernel = staticmethod(forgetful)

    @property
    def advances(self) -> tuple[Block, ...]:
        return (DRIFT,)


@dataclass(frozen=True, kw_only=True)
class ReadsNothing(SensorModel):
    """`reads` was forgotten."""

    kind: ClassVar[str] = "reads_nothing"
    columns: ClassVar[tuple[str, ...]] = ("x_m",)
    rows: ClassVar[int] = 1


@dataclass(frozen=True, kw_only=True)
class Distance(NumericalSensor):
    """A distance in plain Python."""

    kind: ClassVar[str] = "plain_distance"
    columns: ClassVar[tuple[str, ...]] = ("range_m",)
    blocks: ClassVar[tuple[Block, ...]] = (RELATIVE_POSITION,)
    sigma: Annotated[float, Quantity("m", positive=True)] = 0.1

    def h(self, r_tc_o: Array) -> float:
        return float(np.linalg.norm(r_tc_o))


@dataclass(frozen=True, kw_only=True)
class LongSteps(Distance):
    """One whose steps are far too long."""

    kind: ClassVar[str] = "long_steps"
    steps: ClassVar[dict[str, float]] = {"relative_position": 0.3}
