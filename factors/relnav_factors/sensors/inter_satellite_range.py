"""Distance between target and chaser, and its rate: a microwave or laser link, a radio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from relnav_factors.shared.ranging import Ranging, add_biases, line_to_chaser
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.catalogue import (
    RANGE_BIAS,
    RANGE_DRIFT,
    RANGE_RATE_BIAS,
    RANGE_RATE_DRIFT,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    RELATIVE_VELOCITY,
    RELATIVE_VELOCITY_T,
)
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity


@jit
def range_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = |r_tc| + b + d - z``.

    p (0,). q (0,). z (1,): m. x (3 + n,): r_tc, then those of bias b and drift d that there are,
    m. r (1,), m. H (1, 3 + n), m/m. Status: that of `length_status` for the distance.
    """
    line, distance, status = line_to_chaser(x)
    if status != 0:
        return status
    r[0] = distance - z[0]
    for j in range(3):
        H[0, j] = line[j]
    add_biases(x, 3, r, H)
    return 0


@jit
def rate_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = r_tc . v_tc / |r_tc| + b + d - z``.

    p (0,). q (0,). z (1,): m/s. x (6 + n,): r_tc (m), v_tc, then those of bias b and drift d that
    there are (m/s). r (1,), m/s. H (1, 6 + n), 1/s and without unit. Status: that of
    `length_status` for the distance.
    """
    line, distance, status = line_to_chaser(x)
    if status != 0:
        return status
    rate = line[0] * x[3] + line[1] * x[4] + line[2] * x[5]
    r[0] = rate - z[0]
    for j in range(3):
        H[0, j] = (x[3 + j] - rate * line[j]) / distance
        H[0, 3 + j] = line[j]
    add_biases(x, 6, r, H)
    return 0


@dataclass(frozen=True, kw_only=True)
class Range(Ranging):
    """Distance of the chaser from the target, z = |r_tc| + b + d.

    Such as the K-band range between the GRACE satellites, which is integrated from its rate: a
    constant that nobody knows, and a slow wander (Kim and Lee 2009).

    sigma: m, white. bias: b, `range_bias`; drift: d, `range_drift`, which the process `range_bias`
    advances with part = "drift".
    """

    kind: ClassVar[str] = "range"
    columns: ClassVar[tuple[str, ...]] = ("range_m",)
    kernel = staticmethod(range_kernel)

    sigma: Annotated[float, Quantity("m", positive=True)]

    @property
    def reads(self) -> tuple[Block, ...]:
        place = RELATIVE_POSITION if self.pose == "orbital" else RELATIVE_POSITION_T
        return place, *self.biases(RANGE_BIAS, RANGE_DRIFT)

    def accept(self, z: Array) -> Array:
        """z (k, 1), m. Raises InputError on a distance that is not positive, where it has no bias
        of any size."""
        z = super().accept(z)
        bad = ~(z[:, 0] > 0)
        if bad.any() and not self.bias:
            raise InputError(f"{self.kind}: found {z[bad][0, 0]} m, expected one above 0")
        return z


@dataclass(frozen=True, kw_only=True)
class RangeRate(Ranging):
    """Rate of the distance of the chaser from the target, z = r_tc . v_tc / |r_tc| + b + d.

    The same whether o turns or not, where v_tc is the rate of r_tc in o.

    sigma: m/s, white. bias: b, `range_rate_bias`; drift: d, `range_rate_drift`, which the process
    `range_rate_bias` advances with part = "drift".
    """

    kind: ClassVar[str] = "range_rate"
    columns: ClassVar[tuple[str, ...]] = ("range_rate_m_s",)
    kernel = staticmethod(rate_kernel)

    sigma: Annotated[float, Quantity("m/s", positive=True)]

    @property
    def reads(self) -> tuple[Block, ...]:
        own = self.biases(RANGE_RATE_BIAS, RANGE_RATE_DRIFT)
        if self.pose == "orbital":
            return RELATIVE_POSITION, RELATIVE_VELOCITY, *own
        return RELATIVE_POSITION_T, RELATIVE_VELOCITY_T, *own
